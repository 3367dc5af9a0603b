"""Which view gets which lens: plain data, decided before anything is rendered."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from dofbench.files import canonical_json, sha256_text
from dofbench.lens import Lens
from dofbench.scenes.types import Split


@dataclass(frozen=True)
class PlannedView:
    """A view and the lens that it will be blurred with, in the units of the chosen normaliser."""

    name: str
    split: Split
    lens: Lens


@dataclass(frozen=True)
class Plan:
    """The lens of every view, in the scene's order (by name)."""

    views: tuple[PlannedView, ...]

    @property
    def hash(self) -> str:
        """sha256 of the plan as canonical JSON."""
        return sha256_text(canonical_json(asdict(self)))


def make_plan(
    views: Sequence[tuple[str, Split]], *, focus: Sequence[float], aperture: Sequence[float], seed: int
) -> Plan:
    """Deal the focus x aperture grid over the views, training views and test views each for themselves.

    views: (name, split) in name order. The cells are dealt in name order, round after round, so that
    within a split the cells' counts differ by at most one, and so do the focus values' counts even
    where there are fewer views than cells. The test views' deal goes on where the training views'
    stopped. The same arguments give the same plan on every machine.
    """
    cells = _shuffled_grid(focus, aperture, seed)
    names = {split: [name for name, belongs in views if belongs == split] for split in ("train", "test")}
    start = {"train": 0, "test": len(names["train"])}
    lens_of = {
        name: cells[(start[split] + index) % len(cells)] for split in names for index, name in enumerate(names[split])
    }
    return Plan(tuple(PlannedView(name, split, lens_of[name]) for name, split in views))


def _shuffled_grid(focus: Sequence[float], aperture: Sequence[float], seed: int) -> list[Lens]:
    """All cells in an order whose every stretch of len(focus) cells has each focus once.

    Rounds over the shuffled focus values; the aperture moves on by one from cell to cell and from
    round to round (a Latin square), so that the apertures spread too.
    """
    generator = random.Random(seed)
    focus, aperture = list(focus), list(aperture)
    generator.shuffle(focus)
    generator.shuffle(aperture)
    return [
        Lens(aperture=aperture[(turn + index) % len(aperture)], focus=value)
        for turn in range(len(aperture))
        for index, value in enumerate(focus)
    ]
