"""What a call of `dofbench run` says: one run, or every combination of what is listed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.dataset.inputs import Inputs
from dofbench.results.run_spec import Run, format_budget, parse_budget


@dataclass(frozen=True)
class Runs:
    """Train methods on datasets, score them and write a result for every run. Several methods, datasets, presets,
    budgets or seeds make a matrix: every combination is a run of its own, in a process of its own."""

    method: str
    """Ids of methods, comma-separated: folders in methods/ or in a folder that DOFBENCH_METHODS lists."""
    data: str | None = None
    """Dataset folders, comma-separated. Default: the built-in dataset, made first if it isn't there."""
    photographs: Path | None = None
    """In place of --data: a folder of your own photographs, or a video. Camera poses are found, a dataset is made, and
    after the runs a page is written, all below OUT."""
    width: int | None = None
    """Width to train at with --photographs, pixels. Default: 504, or that of the photographs where it is less."""
    preset: str | None = None
    """Presets of the methods' method.toml, comma-separated. Default: the one that the file calls default_preset, or
    builtin_preset on the built-in dataset."""
    set: tuple[str, ...] = ()
    """Options that replace the preset's, as key=value with a TOML value: --set sh_degree=1 lens_lr=1e-3."""
    budget: tuple[str, ...] | None = None
    """When training stops: 300s, 5min, 7000it, or both (300s,7000it), whichever comes first. Several, with spaces
    between, are runs of their own: --budget 60s 300s. Default: the preset's."""
    seed: int = 0
    """Seed of everything random in the method; with --seeds the first of them."""
    seeds: int = 1
    """How many seeds: --seed, --seed + 1, ..."""
    jobs: int = 1
    """Runs of a matrix at the same time, each with its share of the threads."""
    device: str = "auto"
    """cpu, cuda, or auto: cuda where there is one."""
    out: Path = Path("results")
    """Folder of results; a run writes to OUT/DATASET/METHOD-PRESET-seedN-KEY/, alone or in a matrix."""
    inputs: Inputs = "shallow"
    """Train on the shallow photographs, or on the sharp originals: that is a protocol of its own."""
    dry_run: bool = False
    """Print what would be done and left out, which runs are finished, and an estimate of the time; stop there."""
    force_all: bool = False
    """Do also what the plan would leave out because the dataset doesn't need it."""
    rerun: bool = False
    """Run again although a finished result of the same key is there."""

    def __post_init__(self) -> None:
        for option, value in (("--seeds", self.seeds), ("--jobs", self.jobs)):
            if value < 1:
                raise InputError(option, str(value), "at least 1")
        if self.photographs is not None and self.data is not None:
            raise InputError("--photographs", "--data too", "one of them")
        if self.width is not None and (self.photographs is None or self.width < 8):
            found = str(self.width) if self.photographs is not None else "the option without --photographs"
            raise InputError("--width", found, "at least 8 pixels, with --photographs")
        if self.budget == ():
            raise InputError("--budget", "nothing", "time, steps or both: 300s, 5min, 7000it or 300s,7000it")

    def cells(self) -> tuple[Run, ...]:
        """Every run, the first seed's first: then all of them have something to show early.

        Raises InputError for an empty list, something listed twice, or a budget that is none.
        """
        methods = _listed("--method", self.method)
        presets = (None,) if self.preset is None else _listed("--preset", self.preset)
        return tuple(
            Run(
                method=method,
                data=data,
                preset=preset,
                set=self.set,
                budget=budget,
                seed=seed,
                device=self.device,
                out=self.out,
                inputs=self.inputs,
                dry_run=self.dry_run,
                force_all=self.force_all,
                rerun=self.rerun,
            )
            for seed in range(self.seed, self.seed + self.seeds)
            for data in self._folders()
            for method in methods
            for preset in presets
            for budget in self._budgets()
        )

    def _folders(self) -> tuple[Path | None, ...]:
        if self.data is None:
            return (None,)
        if Path(self.data).is_dir():  # one folder, whose name may hold a comma
            return (Path(self.data),)
        return tuple(map(Path, _listed("--data", self.data)))

    def _budgets(self) -> tuple[str | None, ...]:
        if self.budget is None:
            return (None,)
        _once("--budget", [format_budget(parse_budget(text)) for text in self.budget])
        return self.budget


def _listed(option: str, text: str) -> tuple[str, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise InputError(option, repr(text), "names with commas between them")
    _once(option, parts)
    return tuple(parts)


def _once(option: str, values: Sequence[str]) -> None:
    for value, times in Counter(values).items():
        if times > 1:
            raise InputError(option, f"{value} {times} times", "each once")
