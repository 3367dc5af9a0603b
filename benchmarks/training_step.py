"""Time of a whole training step, and the share of kernels in it.

    python benchmarks/training_step.py SCENE [--width 504] [--steps 60]

SCENE is an all-in-focus scene with sparse points. Training uses its photographs directly (their content doesn't affect
the time), starts from the sparse points, and has a lens, so the time includes everything that a step does. For circles
of confusion of realistic size the aperture is fixed to `--aperture`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.scenes import load_scene

# The parts of a step that run in our kernels; the lens and loss stages are scatter and SSIM plus
# the few element-wise tensor operations around them, which the profile below keeps apart.
KERNEL_STAGES = ("rasterise", "rasterise, backward", "lens", "loss", "loss and lens, backward")


class Clock:
    """Records the time of every step."""

    def __init__(self):
        self.times, self._last = [], time.perf_counter()

    def seconds(self) -> float:
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        now = time.perf_counter()
        self.times.append(now - self._last)
        self._last = now
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--width", type=int, default=504)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--aperture", type=float, default=0.75)
    parser.add_argument("--normals", action="store_true")
    arguments = parser.parse_args()
    scene = load_scene(arguments.scene, width=arguments.width)
    views = tuple(TrainingView(v.name, v.camera, v.image()) for v in scene.views)
    options = GaussianOptions().with_overrides(
        {
            "densify_until": 0.0,
            "reset_every": 0.0,
            "lens_init_aperture": arguments.aperture,
            "lens_lr": 1e-12,
            "lens_lr_final": 1e-12,
            "sh_every": 0.0,
            "adaptation": "off",
            "normal_weight": 0.05 if arguments.normals else 0.0,
        }
    )
    trainer = Trainer(TrainingSet(views, scene.points), options, 0)
    trainer.fit(Budget(steps=5), Clock())  # compiles the kernels
    trainer.stages.clear()
    clock = Clock()
    outcome = trainer.fit(Budget(steps=arguments.steps), clock)
    times = sorted(clock.times[1:])
    total = sum(clock.times)
    median, least, most = (1e3 * value for value in (statistics.median(times), times[0], times[-1]))
    print(
        f"{len(trainer.gaussians)} Gaussians, {views[0].camera.width}x{views[0].camera.height}: "
        f"median {median:.1f} ms a step (min {least:.1f}, max {most:.1f})"
    )
    print("| stage | ms a step | share |\n| --- | --- | --- |")
    for stage, seconds in outcome.stages.items():
        print(f"| {stage} | {1e3 * seconds / arguments.steps:.2f} | {seconds / total:.0%} |")
    kernels = sum(outcome.stages.get(stage, 0.0) for stage in KERNEL_STAGES)
    print(f"| stages that are kernels | {1e3 * kernels / arguments.steps:.2f} | {kernels / total:.0%} |")


if __name__ == "__main__":
    main()
