"""The lenses of a dataset's views as text."""

from __future__ import annotations

from typing import Any

HELD_OUT = "held-out"
_LISTED = 6  # largest number of values that are listed; more are given as a range


def lens_words(lenses: dict[str, Any]) -> str:
    """A text such as "trained on F 0.2, 0.8 and A 0.5, 1; the test views ask for F 0.5 and A 0".

    lenses: of a run's plan; None for a view of unknown lens.
    """
    asked = "no test views"
    if lenses["test"]:
        known = any(lens is not None for lens in lenses["test"].values())
        asked = f"the test views ask for {_values(lenses['test'])}" if known else "no test lens"
    return f"trained on {_values(lenses['train'])}; {asked}"


def _values(views: dict[str, list[float] | None]) -> str:
    known = [lens for lens in views.values() if lens is not None]
    if not known:
        return "unknown lenses"
    apertures, focuses = zip(*known, strict=True)
    others = len(views) - len(known)
    return f"F {_listed(set(focuses))} and A {_listed(set(apertures))}" + (
        f" ({others} of {len(views)} lenses unknown)" if others else ""
    )


def _listed(values: set[float]) -> str:
    ordered = sorted(values)
    if len(ordered) > _LISTED:
        return f"{ordered[0]:g} to {ordered[-1]:g}"
    return ", ".join(f"{value:g}" for value in ordered)
