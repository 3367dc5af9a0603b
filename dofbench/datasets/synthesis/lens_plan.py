"""The lens of every view, planned as plain data before anything is rendered."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from dofbench.core.files import canonical_json, sha256_text
from dofbench.core.lens import Lens
from dofbench.scenes.scene import Split


@dataclass(frozen=True)
class PlannedView:
    """A view, and the lens of its photograph in the units of the chosen normaliser."""

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


@dataclass(frozen=True)
class Values:
    """Focus and aperture values of a grid; in `draw_plan`, two values of each are the ends of a range."""

    focus: tuple[float, ...]
    aperture: tuple[float, ...]


def deal_plan(views: Sequence[tuple[str, Split]], values: Values, *, seed: int, held_out: Values | None = None) -> Plan:
    """Distribute the focus x aperture grid over the views, separately for training and test views.

    views: (name, split) in name order. The cells of the grid are assigned in this order, in rounds, so within a split
    the cells' counts differ by at most one, and so do the focus values' counts even with fewer views than cells. The
    test views continue where the training views stopped; with `held_out` they get that grid instead, from its start.
    The same arguments give
    the same plan on every machine.
    """
    names = _by_split(views)
    train = test = _shuffled_grid(values, seed)
    first_test = len(names["train"])
    if held_out is not None:
        test, first_test = _shuffled_grid(held_out, seed), 0
    lens_of = {name: train[index % len(train)] for index, name in enumerate(names["train"])}
    lens_of |= {name: test[(first_test + index) % len(test)] for index, name in enumerate(names["test"])}
    return _plan(views, lens_of)


def draw_plan(views: Sequence[tuple[str, Split]], values: Values, *, seed: int) -> Plan:
    """Draw every view's focus and aperture from the ranges that the least and the largest value span.

    A range is divided into as many parts as the split has views, and each part gets exactly one value (a Latin
    hypercube), so that even few views cover the range. Rounded to four decimals. The same arguments give the same plan
    on every machine.
    """
    generator = random.Random(seed)
    lens_of: dict[str, Lens] = {}
    for names in _by_split(views).values():
        focus, aperture = (_stratified(generator, len(names), min(v), max(v)) for v in (values.focus, values.aperture))
        lens_of |= {name: Lens(aperture=a, focus=f) for name, f, a in zip(names, focus, aperture, strict=True)}
    return _plan(views, lens_of)


def _by_split(views: Sequence[tuple[str, Split]]) -> dict[Split, list[str]]:
    return {split: [name for name, belongs in views if belongs == split] for split in ("train", "test")}


def _plan(views: Sequence[tuple[str, Split]], lens_of: dict[str, Lens]) -> Plan:
    return Plan(tuple(PlannedView(name, split, lens_of[name]) for name, split in views))


def _stratified(generator: random.Random, count: int, low: float, high: float) -> list[float]:
    strata = list(range(count))
    generator.shuffle(strata)
    return [round(low + (high - low) * (stratum + generator.random()) / count, 4) for stratum in strata]


def _shuffled_grid(values: Values, seed: int) -> list[Lens]:
    """All cells of the grid, in rounds in which every focus value occurs once.

    A round goes through the shuffled focus values; the aperture advances by one from cell to cell and from round to
    round (a Latin square), so that the apertures are spread too.
    """
    generator = random.Random(seed)
    focus, aperture = list(values.focus), list(values.aperture)
    generator.shuffle(focus)
    generator.shuffle(aperture)
    return [
        Lens(aperture=aperture[(turn + index) % len(aperture)], focus=value)
        for turn in range(len(aperture))
        for index, value in enumerate(focus)
    ]
