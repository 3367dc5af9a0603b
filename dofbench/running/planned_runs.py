"""A run that is to be made: all that is decided before it begins, as plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.result import Spec
from dofbench.evaluation.results.run_spec import Run
from dofbench.running.plan import RunPlan


@dataclass(frozen=True)
class PlannedRun:
    """settings: what says the same run alone, as `dofbench run` takes it. data: the dataset's folder. spec: what
    decides its result. plan: what it does and leaves out. folder: where its result goes. options: all that the method
    runs with, its defaults too, where it says so (as its `options`, a dataclass); else those of the spec. view_pixels:
    of a training view, on average. choices: digest of all that preset and call chose, before the dataset changed
    anything (`dofbench.methods.frozen_presets`)."""

    settings: Run
    data: Path
    spec: Spec
    budget: Budget
    plan: RunPlan
    folder: Path
    options: dict[str, Any]
    view_pixels: float
    choices: str

    @property
    def name(self) -> str:
        """Dataset, method, preset, seed and key, for a line of progress."""
        return str(self.spec.folder)

    def lines(self) -> list[str]:
        """What will be done and left out, one line a fact."""
        spec, (views, *rest) = self.spec, self.plan.lines()
        what = f"{spec.method} ({spec.preset}, seed {spec.seed}, {spec.device}) on {spec.dataset}, {spec.protocol}"
        return [what, f"budget {self.budget}; {views}", *rest]

    def with_seed(self, seed: int) -> PlannedRun:
        """The same run with another seed; nothing else depends on it."""
        spec = self.spec.model_copy(update={"seed": seed})
        return replace(
            self,
            settings=replace(self.settings, seed=seed),
            spec=spec,
            folder=self.settings.out / spec.folder,
        )


def different_datasets(folders: Sequence[Path]) -> list[Dataset]:
    """The datasets in these folders. Raises InputError for a folder that is none, or one dataset given twice."""
    datasets = [Dataset.load(folder) for folder in folders]
    for checksum, times in Counter(dataset.checksum for dataset in datasets).items():
        if times > 1:
            double = next(folder for folder, one in zip(folders, datasets, strict=True) if one.checksum == checksum)
            raise InputError("--data", f"{double} {times} times", "every dataset once")
    return datasets
