"""What reports ask of the installed methods: each card is read once a report, however many rows ask for it."""

from __future__ import annotations

from functools import cache

from dofbench.evaluation.results.collecting import Entry
from dofbench.methods.cards import MethodEntry, find_method, method_files
from dofbench.methods.frozen_presets import PresetStanding, State, standing


@cache
def installed(method: str) -> MethodEntry | None:
    """The method of this id; None if it isn't installed here."""
    return find_method(method) if method in method_files() else None


@cache
def _standing(method: str, preset: str) -> PresetStanding:
    return standing(method, preset)


def frozen_state(entry: Entry) -> State:
    """Whether the run was made with a fixed preset."""
    return _standing(entry.spec.method, entry.spec.preset).state(entry.choices, entry.spec.budget)


def read_again() -> None:
    """Forget what was read: a card may have changed since the last report."""
    installed.cache_clear()
    _standing.cache_clear()
