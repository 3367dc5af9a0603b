"""How many of torch's own operations a training step calls, for the model of GPU kernels: torch_calls.csv.

    python benchmarks/gpu_torch_calls.py --out reports/gpu

Each is a launch on a GPU. They are counted in short trainings on the built-in scene on the CPU, whose kernels call
hardly any operations of torch, SSIM's some ten, but for Adam's, which are left out: a GPU's has none. A step takes as
many as the difference of two lengths of training, over the difference in steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import tyro
from torch.utils._python_dispatch import TorchDispatchMode
from unobserved import Unobserved

from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.fields.field_options import FieldOptions
from dofbench.fields.field_trainer import FieldTrainer
from dofbench.fields.forward.pinhole_rays import PinholeRays
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.reporting.csv_writer import write_csv
from dofbench.running.method_cards import find_method
from dofbench.scenes import load_scene

SCENE = "tabletop"
# What the preset `gpu` does in all steps but a few at the beginning, in trials, and when it adds Gaussians.
USUAL = {"lens_trials": "", "lens_from": 0.0, "coarse_until": 0.0, "densify_until": 0.0}


@dataclass(frozen=True)
class Settings:
    """Where the table goes, and at which size trainings are."""

    out: Path
    """Folder for torch_calls.csv."""
    width: int = 128
    """Of the pictures, pixels."""
    steps: tuple[int, int] = (16, 48)
    """Lengths of the two trainings. A field smooths its grid every fourth step and looks at its cells every 32nd."""


class Calls(TorchDispatchMode):
    """Counts the calls of torch's operations that would be launches on a GPU.

    Views, and constants made on the host, are none. A sum that the host reads at once says whether values are finite: a
    GPU's checks are told apart in the model, and so is Adam with its count of steps, so that such a sum doesn't count.
    Nor does what the op `adam` calls.
    """

    FREE = (
        "view", "detach", "alias", "unbind", "empty", "t.", "transpose", "unsqueeze", "select", "slice", "expand",
        "permute", "lift_fresh", "scalar_tensor", "profiler", "_fused_adam_", "_foreach_add_",
    )  # fmt: skip
    READ = "_local_scalar_dense"

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        self._before = ""
        self._in_adam = False

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = str(function).removeprefix("aten.")
        if name.startswith(self.READ):
            self.count -= self._before.startswith("sum")
        elif not name.startswith(self.FREE) and not self._in_adam:
            self.count, self._before = self.count + 1, name
        return function(*args, **(kwargs or {}))

    @contextmanager
    def without_adam(self) -> Iterator[None]:
        """A block in which nothing counts that the CPU's op `adam` calls."""
        backend = import_module("dofbench.kernels.adam.cpu")
        called = backend.adam

        def uncounted(*args: Any, **kwargs: Any) -> None:
            self._in_adam = True
            called(*args, **kwargs)
            self._in_adam = False

        backend.adam = uncounted
        try:
            yield
        finally:
            backend.adam = called


def main(settings: Settings) -> None:
    """Count and write."""
    data = training_set(settings.width)
    trainings = {
        "scatter": lambda: Trainer(data, gaussian_options(**USUAL), 0),
        "points": lambda: Trainer(data, gaussian_options(**USUAL, **points_of_the_lens()), 0),
        "field": lambda: FieldTrainer(data, field_options(), PinholeRays(), 0),
    }
    rows = [{"training": name, "calls": calls(make, settings.steps)} for name, make in trainings.items()]
    write_csv(settings.out / "torch_calls.csv", ("training", "calls"), rows)


def training_set(width: int) -> TrainingSet:
    """The built-in scene's photographs, and its points."""
    scene = load_scene(content_folder("datasets") / SCENE, width=width)
    return TrainingSet(tuple(TrainingView(one.name, one.camera, one.image()) for one in scene.views), scene.points)


def gaussian_options(**changes: Any) -> GaussianOptions:
    """The preset that DoF-Gaussian has for a GPU, and some options changed."""
    return GaussianOptions.of(**{**find_method("dofgaussian").preset("gpu")[1], **changes})


def points_of_the_lens() -> dict[str, Any]:
    """What the preset `thinlens` has besides those of a CPU's, with the points from the first step on."""
    usual, thin = (find_method("dofgaussian").preset(name)[1] for name in ("cpu", "thinlens"))
    changed = {name: value for name, value in thin.items() if usual.get(name) != value}
    return {**changed, "lens_samples_from": 0.0, "lens_rings_from": 0.0}


def field_options(**changes: Any) -> FieldOptions:
    """The preset that all methods of fields share, and some options changed."""
    return FieldOptions.of(**{**find_method("nerf").preset("cpu")[1], **changes})


def calls(make: Callable[[], Any], steps: tuple[int, int]) -> int:
    """Of a training step."""
    counts = []
    for length in steps:
        trainer = make()
        with Calls() as counted, counted.without_adam():
            trainer.fit(Budget(steps=length), Unobserved())
        counts.append(counted.count)
    return round((counts[1] - counts[0]) / (steps[1] - steps[0]))


if __name__ == "__main__":
    main(tyro.cli(Settings))
