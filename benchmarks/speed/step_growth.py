"""Time of a training step by the number of Gaussians and of pixels, and of its parts: step-growth.csv.

    python -m benchmarks.speed.step_growth --out reports/speed

A method trains on one view of N random Gaussians: wavy surfaces at several depths, a sixth of them beside the view,
each as large as its neighbours are far. OMP_NUM_THREADS sets the cores. Columns, medians over the steps:

- wall_ms, processor_ms: the step; processor time is the sum over the threads
- project_ms … rest_ms: wall time of the parts. tiles_ms: sorting, and filling the tiles' lists. check_ms: whether
  values are finite. loss_ms: loss and lens with their gradients. rest_ms: all else
- floor_ms: reading and writing the Gaussians' parameters once
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch is imported

import numpy as np  # noqa: E402
import torch  # noqa: E402

from dofbench.core.cameras import Camera  # noqa: E402
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView  # noqa: E402
from dofbench.core.files import write_csv  # noqa: E402
from dofbench.methods.cards import find_method  # noqa: E402
from dofbench.runtime.freed_memory import keep_freed_memory  # noqa: E402
from dofbench.training.common.monitor import Place, StageClock  # noqa: E402
from dofbench.training.common.views import ScaledViews  # noqa: E402
from dofbench.training.gaussians.gaussian_method import GaussianMethod  # noqa: E402
from dofbench.training.gaussians.trainer import Trainer  # noqa: E402
from dofbench.training.gaussians.training_step import take_step  # noqa: E402

PARTS = ("project", "tiles", "blend", "blend_backward", "project_backward", "adam", "check", "loss", "rest")
FIELDS = (
    "method",
    "gaussians",
    "megapixels",
    "threads",
    "wall_ms",
    "processor_ms",
    *(f"{part}_ms" for part in PARTS),
    "floor_ms",
)
# The compiled stages of the CPU's `rasterize`, by the part that they belong to.
STAGES = {
    "project": "project",
    "fill_tiles": "tiles",
    "blend": "blend",
    "blend_backward": "blend_backward",
    "project_backward": "project_backward",
}


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder for step-growth.csv."""
    gaussians: tuple[int, ...] = (10_000, 100_000, 1_000_000, 3_000_000)
    """Numbers of Gaussians, each in a view of the first width."""
    widths: tuple[int, ...] = (504, 252, 1008, 2016, 4032)
    """Widths of a view, pixels, each with the second number of Gaussians. Its height is three quarters."""
    methods: tuple[str, ...] = ("mipsplatting",)
    """Methods, with their default presets."""
    steps: int = 15
    """Steps whose medians are taken, after three others."""
    progress: float = 0.6
    """Where in the training the steps are, 0 to 1."""


def scene(n: int, width: int, height: int, seed: int = 0) -> TrainingSet:
    """Two views of n points on wavy surfaces at depths 2 to 8; the second is the first from nearby."""
    random = np.random.default_rng(seed)
    u, v = random.uniform(-0.1, 1.1, n), random.uniform(-0.1, 1.1, n)
    layer = random.choice([2.0, 3.0, 4.5, 8.0], n, p=[0.15, 0.2, 0.25, 0.4])
    z = layer * (1 + 0.1 * np.sin(9 * u + layer) * np.cos(7 * v)) + 0.01 * random.standard_normal(n)
    focal = 0.9 * width
    x, y = (u - 0.5) * width / focal * z, (v - 0.5) * height / focal * z
    # Nearer surfaces cover a part of the view each.
    covers = (layer == 8.0) | (np.sin(5 * u + 3 * layer) + np.cos(6 * v - layer) > 0)
    z[~covers] = 8.0 + 0.05 * random.standard_normal((~covers).sum())
    points = PointCloud(np.stack([x, y, z], 1), random.random((n, 3), np.float32), np.zeros(n, np.float32))
    views = []
    for number in range(2):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * number
        camera = Camera(width, height, focal, focal, width / 2, height / 2, pose)
        views.append(TrainingView(f"{number}", camera, random.random((height, width, 3), np.float32)))
    return TrainingSet(tuple(views), points)


def vary(trainer: Trainer, seed: int = 1) -> None:
    """Give the Gaussians the shapes, opacities and colours of a trained scene."""
    random = torch.Generator().manual_seed(seed)
    parameters = trainer.gaussians.parameters
    with torch.no_grad():
        parameters["log_scales"] += 0.6 * torch.randn(parameters["log_scales"].shape, generator=random) - 0.2
        parameters["quaternions"].copy_(torch.randn(parameters["quaternions"].shape, generator=random))
        parameters["opacity_logits"].copy_(2 * torch.randn(parameters["opacity_logits"].shape, generator=random) - 1)
        parameters["sh_rest"].copy_(0.05 * torch.randn(parameters["sh_rest"].shape, generator=random))


@contextmanager
def timed_stages(spent: dict[str, float]) -> Iterator[None]:
    """Add the wall seconds of each compiled stage, Adam and the checks to `spent`."""
    from dofbench.runtime.ops.adam import cpu as adam
    from dofbench.runtime.ops.rasterize import cpu

    def timed(call: Callable[..., Any], part: str) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            start = time.perf_counter()
            found = call(*arguments, **options)
            spent[part] = spent.get(part, 0.0) + time.perf_counter() - start
            return found

        return run

    places: list[tuple[Any, str, str]] = [(cpu, name, part) for name, part in STAGES.items()]
    places += [(adam, "adam", "adam"), (Place, "check", "check")]
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in places]
    for owner, name, part in places:
        setattr(owner, name, timed(getattr(owner, name), part))
    try:
        yield
    finally:
        for owner, name, call in before:
            setattr(owner, name, call)


def floor(trainer: Trainer) -> float:
    """Median seconds of reading and writing the parameters once."""
    times = []
    with torch.no_grad():
        for _ in range(5):
            start = time.perf_counter()
            for parameter in trainer.gaussians.parameters.values():
                parameter.mul_(1.0)
            times.append(time.perf_counter() - start)
    return median(times)


def row(method_id: str, n: int, width: int, settings: Settings) -> dict[str, object]:
    """Measure a method with n Gaussians in a view of this width."""
    entry = find_method(method_id)
    _, options, _ = entry.preset("cpu")
    method = entry.create({**options, "max_gaussians": max(n, 1)}, 0, "cpu")
    assert isinstance(method, GaussianMethod)
    trainer = Trainer(scene(n, width, width * 3 // 4), method.options, 0)
    vary(trainer)
    view = ScaledViews(trainer.views, 1, None, 0.0, 0, "cpu")[0]
    steps: list[dict[str, float]] = []
    with trainer.state.density.pace.rest():
        for step in range(1, 4 + settings.steps):
            spent: dict[str, float] = {}
            clock = StageClock()
            with timed_stages(spent):
                wall, processor = time.perf_counter(), time.process_time()
                take_step(trainer.state, step, settings.progress, view, clock)
                wall, processor = time.perf_counter() - wall, time.process_time() - processor
            spent["loss"] = sum(
                clock.seconds.get(name, 0.0) for name in ("lens", "blur", "loss", "loss and lens, backward")
            )
            spent["rest"] = wall - sum(spent.values())
            steps.append({"wall": wall, "processor": processor, **spent})
    found = {name: 1e3 * median(step.get(name, 0.0) for step in steps[3:]) for name in ("wall", "processor", *PARTS)}
    found["floor"] = 1e3 * floor(trainer)
    print(method_id, n, width, ", ".join(f"{name} {value:.1f}" for name, value in found.items()), flush=True)
    return {
        "method": method_id,
        "gaussians": n,
        "megapixels": width * (width * 3 // 4) / 1e6,
        "threads": torch.get_num_threads(),
        **{f"{name}_ms": value for name, value in found.items()},
    }


def main(settings: Settings) -> None:
    """Measure every method with each number of Gaussians."""
    keep_freed_memory()  # as a run does
    cases = [(n, settings.widths[0]) for n in settings.gaussians]
    cases += [(settings.gaussians[1], width) for width in settings.widths[1:]]
    rows = [row(method, n, width, settings) for method in settings.methods for n, width in cases]
    write_csv(settings.out / "step-growth.csv", FIELDS, rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
