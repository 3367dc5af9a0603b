"""Time of a training step of each method, and of its parts: method-steps.csv.

    python -m benchmarks.speed.method_steps DATASET --out reports/speed

Every method trains with its default preset on the dataset's training views, fields with `--rays` rays a step.
OMP_NUM_THREADS sets the cores. Columns:

- step_ms: mean of the last tenth of the steps but one, since a profiler makes steps longer; the last tenth is profiled
- kernels_ms: this project's ops and their gradients
- products_ms: matrix products and convolutions of the method's networks
- adam_ms: the optimiser
- rest_ms: all else, mostly element-wise operations, copies and Python
- ratio: the step over kernels, products and optimiser together
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch is imported

import torch  # noqa: E402
from torch.profiler import ProfilerActivity, profile  # noqa: E402

from dofbench.core.budget import Budget  # noqa: E402
from dofbench.core.files import write_csv  # noqa: E402
from dofbench.datasets.format.dataset import Dataset  # noqa: E402
from dofbench.methods.cards import find_method, method_files  # noqa: E402
from dofbench.runtime.freed_memory import keep_freed_memory  # noqa: E402
from dofbench.training.fields.field_method import FieldMethod  # noqa: E402
from dofbench.training.fields.field_trainer import FieldTrainer  # noqa: E402
from dofbench.training.gaussians.gaussian_method import GaussianMethod  # noqa: E402
from dofbench.training.gaussians.trainer import Trainer  # noqa: E402

FIELDS = (
    "method",
    "threads",
    "gaussians",
    "rays",
    "step_ms",
    "kernels_ms",
    "products_ms",
    "adam_ms",
    "rest_ms",
    "ratio",
)
PRODUCTS = ("mm", "bmm", "convolution", "conv", "linear")  # parts of the names of torch's ops
ADAM = ("adam",)


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    data: tyro.conf.Positional[Path]
    """The dataset."""
    out: Path
    """Folder for method-steps.csv."""
    steps: int = 300
    """Length of the training, whose last tenth is profiled."""
    rays: int = 1024
    """Rays of a field's step."""
    methods: tuple[str, ...] = ()
    """Which methods; all if none is named."""


class Profiled:
    """An observer that times the last tenth but one of a training, and profiles the last."""

    def __init__(self, steps: int):
        self._first, self.count = steps - steps // 10, steps // 10
        self.profile = profile(activities=[ProfilerActivity.CPU])
        self.seconds_taken = 0.0
        self._began = 0.0

    def seconds(self) -> float:
        """No time limit."""
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        """Time from eight tenths of the steps on, profile from nine."""
        if step == self._first - self.count:
            self._began = time.perf_counter()
        if step == self._first:
            self.seconds_taken = time.perf_counter() - self._began
            self.profile.start()
        if step == self._first + self.count:
            self.profile.stop()
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""


def kind_of(name: str) -> str:
    """The column of a profile's event."""
    low = name.lower()
    if any(word in low for word in ADAM):
        return "adam_ms"
    if low.startswith("aten::"):
        return "products_ms" if any(word in low for word in PRODUCTS) else "rest_ms"
    return "kernels_ms" if name.startswith("_") else "rest_ms"


def row(method_id: str, dataset: Dataset, settings: Settings) -> dict[str, object]:
    """Measure a method."""
    entry, training_set = find_method(method_id), dataset.training_set("shallow")
    _, options, _ = entry.preset("cpu")
    options = {**options, "steps": settings.steps}
    if isinstance(entry.create(options, 0, "cpu"), FieldMethod):
        options["batch_pixels"] = settings.rays
    method = entry.create(options, 0, "cpu")
    trainer: Trainer | FieldTrainer
    if isinstance(method, FieldMethod):
        model = method.model(training_set, torch.Generator().manual_seed(0))
        trainer = FieldTrainer(training_set, method.options, model, 0)
    else:
        assert isinstance(method, GaussianMethod)
        trainer = Trainer(training_set, method.options, 0)
    observer = Profiled(settings.steps)
    outcome = trainer.fit(Budget(steps=settings.steps), observer)
    found = dict.fromkeys(FIELDS[5:9], 0.0)
    for event in observer.profile.key_averages():
        found[kind_of(event.key)] += event.self_cpu_time_total / 1e3 / observer.count
    step = 1e3 * observer.seconds_taken / observer.count
    needed = found["kernels_ms"] + found["products_ms"] + found["adam_ms"]
    print(f"{method_id}: {outcome.status}, {step:.1f} ms a step, {step / needed:.2f} times its parts", flush=True)
    return {
        "method": method_id,
        "threads": torch.get_num_threads(),
        "gaussians": "" if isinstance(trainer, FieldTrainer) else len(trainer.gaussians),
        "rays": settings.rays if isinstance(trainer, FieldTrainer) else "",
        "step_ms": step,
        **found,
        "rest_ms": step - needed,
        "ratio": step / needed,
    }


def main(settings: Settings) -> None:
    """Measure every method that is found or named."""
    keep_freed_memory()  # as a run does
    dataset = Dataset.load(settings.data)
    rows = [row(method_id, dataset, settings) for method_id in settings.methods or method_files()]
    write_csv(settings.out / "method-steps.csv", FIELDS, rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
