"""Rules declared beside an option: each refuses exactly the values that it describes, naming options as they are
typed."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from dofbench.core.errors import InputError
from dofbench.core.option_rules import (
    NOT_NEGATIVE,
    POSITIVE,
    AtMostWith,
    DefaultWith,
    EachFrom,
    NeededWith,
    Needs,
    NotBeside,
    OnlyWith,
    at_least,
    check,
    option,
)


@dataclass(frozen=True)
class Trip:
    """Options of a trip, with a rule of each kind."""

    by: str = "foot"
    days: int | None = option(None, at_least(2))
    cost: float = option(0.0, NOT_NEGATIVE)
    pace: float = option(1.0, POSITIVE)
    gear: str | None = option(None, OnlyWith("by", "bike"))
    ticket: str | None = option(None, NeededWith("by", "train", "where from and where to"))
    meet_at: str | None = option(None, Needs("meet_by", "both: a place and a time"))
    meet_by: str | None = option(None, Needs("meet_at", "both: a place and a time"))
    end: str | None = option(None, NotBeside("days", "one of them: either says how long"))
    speed: float = option(4.5, DefaultWith("by", "foot", "4.5, as people walk", unless=lambda trip: trip.pace > 2))
    stops: tuple[float, ...] = option((1.0,), EachFrom(0, 10), AtMostWith("by", "plane", 2, "start and end"))

    def __post_init__(self) -> None:
        check(self)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"days": 1}, "--days: found 1, expected at least 2"),
        ({"cost": -1.0}, "--cost: found -1.0, expected 0 or a positive number"),
        ({"pace": 0.0}, "--pace: found 0.0, expected a positive number"),
        ({"pace": float("inf")}, "--pace: found inf, expected a positive number"),
        ({"gear": "3"}, "--gear: found --by foot, expected --by bike, the only one that uses it"),
        ({"by": "train"}, "--by train: found no --ticket, expected where from and where to"),
        ({"meet_at": "home"}, "--meet-at: found no --meet-by, expected both: a place and a time"),
        ({"meet_by": "noon"}, "--meet-by: found no --meet-at, expected both: a place and a time"),
        ({"end": "May", "days": 3}, "--end: found --days 3 too, expected one of them: either says how long"),
        ({"speed": 9.0}, "--by foot: found --speed 9, expected 4.5, as people walk"),
        ({"stops": (1.0, 11.0)}, "--stops: found 11, expected numbers from 0 to 10"),
        ({"stops": (float("nan"),)}, "--stops: found nan, expected numbers from 0 to 10"),
        ({"stops": (2.0, 2.0)}, "--stops: found 2,2, expected every value once"),
        (
            {"by": "plane", "stops": (1.0, 2.0, 3.0)},
            "--stops with --by plane: found 3 values, expected start and end",
        ),
    ],
)
def test_what_breaks_a_rule_is_one_line_by_the_names_that_are_typed(options, line):
    with pytest.raises(InputError) as caught:
        Trip(**options)
    assert str(caught.value) == line


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"days": 2, "cost": 0.0},
        {"by": "bike", "gear": "3", "speed": 20.0},
        {"by": "train", "ticket": "here to there"},
        {"meet_at": "home", "meet_by": "noon"},
        {"end": "May"},
        {"speed": 9.0, "pace": 2.5},
        {"by": "plane", "stops": (0.0, 10.0)},
    ],
)
def test_what_breaks_none_is_taken(options):
    assert Trip(**options)
