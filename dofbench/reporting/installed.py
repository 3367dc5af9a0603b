"""What reports ask of the installed methods. A report asks for every row, so it reads each card only once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from dofbench.evaluation.results.collecting import Entry
from dofbench.methods.cards import MethodEntry, find_method, method_files
from dofbench.methods.frozen_presets import State, standing

T = TypeVar("T")

_read: ContextVar[dict[Any, Any] | None] = ContextVar("read", default=None)


@contextmanager
def read_once() -> Iterator[None]:
    """Read each method once within the block; outside of one, whenever it is asked for."""
    token = _read.set({})
    try:
        yield
    finally:
        _read.reset(token)


def installed(method: str) -> MethodEntry | None:
    """The method of this id; None if it isn't installed here."""
    return _kept(("card", method), lambda: find_method(method) if method in method_files() else None)


def frozen_state(entry: Entry) -> State:
    """Whether the run was made with a fixed preset."""
    method, preset = entry.spec.method, entry.spec.preset
    found = _kept(("preset", method, preset), lambda: standing(method, preset))
    return found.state(entry.choices, entry.spec.budget)


def _kept(key: tuple[str, ...], read: Callable[[], T]) -> T:
    known = _read.get()
    if known is None:
        return read()
    if key not in known:
        known[key] = read()
    found: T = known[key]
    return found
