"""The options of `dofbench run`: one run, or a matrix of runs."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import SeveralBudgets, options
from dofbench.evaluation.results.run_spec import RunOptions, RunSpec, SeveralOptions

HELD_OUT = 0.05  # share of the pixels that --converge holds out
OWN_PHOTOGRAPHS = "lensselect"  # the method that photographs are trained by where the call names none


@options(kw_only=True)
class Runs(SeveralOptions, RunOptions):
    """Train methods on datasets and score them on the test views. Several methods, datasets, presets, budgets or seeds
    make a matrix: every combination is a run in a process of its own."""

    method: Annotated[str, tyro.conf.arg(help_behavior_hint="")] = ""
    """Ids of methods, comma-separated: folders in methods/ or in a folder that DOFBENCH_METHODS lists. Default with
    --photographs: lensselect; else required."""
    data: str | None = None
    """Dataset folders, comma-separated. Default: the built-in dataset, made first if it isn't there."""
    photographs: Path | None = None
    """Instead of --data: a folder of your own photographs, or a video. Camera poses, dataset, training and report are
    made below OUT."""
    width: int | None = None
    """Width to train at with --photographs, pixels. Default: 504, or that of the photographs where it is less."""
    budget: SeveralBudgets = None
    """When training stops: 300s, 5min, 60cpu (processor seconds), 7000it, or both (300s,7000it), whichever comes first.
    Time alone is all used, however many steps the preset has. Several, with spaces between, are runs of their own:
    --budget 60s 300s.
    Default: the preset's steps."""
    seeds: Annotated[int, Field(ge=1)] = 1
    """How many seeds: --seed, --seed + 1, ..."""
    shard: Annotated[str, Field(pattern=r"^[1-9]\d*/[1-9]\d*$")] | None = None
    """Only a share of the runs: 1/4 makes a quarter of them, 2/4 another one, for machines without a common disk or
    queue. `dofbench report --merge` reads their results together. With --converge, a share of methods and seeds."""
    converge: bool = False
    """Train at the preset's length, or --budget in steps, then twice as long, and so on, each time from the start. A
    method and seed stop where PSNR on held-out pixels of the training views rises by less than 0.1 dB, or where the
    next training would exceed 30000 steps or 40 minutes. Holds 5 % of the pixels out unless --held-out says
    otherwise."""

    def __post_init__(self) -> None:
        if not self.method:
            if self.photographs is None:
                raise InputError("--method", "nothing", "ids of methods; `dofbench methods` lists them")
            object.__setattr__(self, "method", OWN_PHOTOGRAPHS)
        if self.photographs is not None and self.data is not None:
            raise InputError("--photographs", "--data too", "one of them")
        if self.width is not None and (self.photographs is None or self.width < 8):
            found = str(self.width) if self.photographs is not None else "the option without --photographs"
            raise InputError("--width", found, "at least 8 pixels, with --photographs")
        if self.shard is not None and int(self.shard.partition("/")[0]) > int(self.shard.partition("/")[2]):
            raise InputError("--shard", self.shard, "one of so many, as 2/4")
        if self.converge:
            _check_converge(self)
            object.__setattr__(self, "held_out", self.held_out or HELD_OUT)
        if self.budget == ():
            raise InputError("--budget", "nothing", "time, steps or both: 300s, 5min, 7000it or 300s,7000it")

    def cells(self) -> tuple[RunSpec, ...]:
        """Every run, the first seed's first: then all of them have something to show early.

        Raises InputError for an empty list, or something listed twice.
        """
        cells = self._all_cells()
        if self.shard is None:
            return cells
        # Drawn, as runs next to each other cost alike: the same draw on every machine.
        number, shards = map(int, self.shard.split("/"))
        drawn = set(random.Random(shards).sample(range(len(cells)), len(cells))[number - 1 :: shards])
        if not drawn:
            raise InputError("--shard", f"{self.shard} of {len(cells)} runs", "a share with a run in it")
        return tuple(cell for place, cell in enumerate(cells) if place in drawn)

    def _all_cells(self) -> tuple[RunSpec, ...]:
        methods = _listed("--method", self.method)
        presets = (None,) if self.preset is None else _listed("--preset", self.preset)
        _once("--budget", [str(budget) for budget in self.budget or ()])
        shared = {field.name: getattr(self, field.name) for field in fields(RunOptions)}
        return tuple(
            RunSpec(**{**shared, "method": method, "preset": preset, "seed": seed}, data=data, budget=budget)
            for seed in range(self.seed, self.seed + self.seeds)
            for data in self._folders()
            for method in methods
            for preset in presets
            for budget in self.budget or (None,)
        )

    def _folders(self) -> tuple[Path | None, ...]:
        if self.data is None:
            return (None,)
        if Path(self.data).is_dir():  # one folder, whose name may hold a comma
            return (Path(self.data),)
        return tuple(map(Path, _listed("--data", self.data)))


def _check_converge(settings: Runs) -> None:
    """Raise InputError for what has no length to double."""
    if settings.photographs is not None:
        raise InputError("--converge", "--photographs too", "the dataset that --photographs made, by --data")
    for budget in settings.budget or ():
        if budget.seconds is not None or len(settings.budget or ()) > 1:
            found = f"{', '.join(map(str, settings.budget or ()))} with --converge"
            raise InputError("--budget", found, "one budget in steps, the length of the first training")


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
