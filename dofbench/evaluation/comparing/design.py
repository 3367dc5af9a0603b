"""What a design can decide before anything is run: how many views and scenes, and which differences they find."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from statistics import median

SIGNIFICANT = 0.05
FEWEST = 6  # fewest views of one scene for which p can be below `SIGNIFICANT`: 2 ** (1 - 6) = 0.031
FEWEST_SCENES = 3  # with two, the scatter of scenes is a guess from a single difference
POWER = 0.8  # how often a difference is to be found
_WORTH = 0.5  # dB: a difference that readers ask about
_MOST = 10_000  # units


def undecided(views: int, scenes: int) -> str:
    """Why no test can tell two methods apart on so many views in all of so many scenes; "" where one can, or there is
    nothing to compare."""
    if views == 0:
        return ""
    if scenes == 1 and views < FEWEST:
        least = 2.0 ** (1 - views)
        return (
            f"{views} test view{'s' if views > 1 else ''} of one scene can't decide (p ≥ {least:.2g} whatever happens)"
            f": {FEWEST} would, or {FEWEST_SCENES} scenes"
        )
    if 1 < scenes < FEWEST_SCENES:
        return f"{scenes} scenes can't decide, as their scatter is unknown: {FEWEST_SCENES} would"
    return ""


@lru_cache(maxsize=1024)
def smallest_found(scatter: float, units: int) -> float:
    """The smallest true difference that a t-test finds in `POWER` of all cases. scatter: standard deviation of the
    units, of which there are at least two; in its unit."""
    low, high = 0.0, 100.0 * scatter
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _power(middle / scatter, units) < POWER else (low, middle)
    return high


def units_for(scatter: float, difference: float) -> int | None:
    """How many units find a true difference in `POWER` of all cases; None above ten thousand."""
    low, high = 2, _MOST
    if _power(difference / scatter, high) < POWER:
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (middle + 1, high) if _power(difference / scatter, middle) < POWER else (low, middle)
    return high


def design_words(views: int, scenes: int, scatters: Sequence[float]) -> str:
    """What comparisons of PSNR in one table can decide, as a sentence; "" where nothing differs.

    views: in all scenes. scatters: of every pair, the standard deviation of its differences over the scenes, or over
    the views of one, dB.
    """
    if nothing := undecided(views, scenes):
        return f"{nothing}."
    if not any(scatters):
        return ""
    scatter, units, what = median(scatters), scenes if scenes > 1 else views, "scenes" if scenes > 1 else "views"
    more = units_for(scatter, _WORTH)
    enough = f"{_WORTH:g} dB would take {'more than 10 000' if more is None else more} {what}"
    return (
        f"{units} {what}, over which the difference of two methods scatters by {scatter:.2f} dB (median of the pairs): "
        f"{smallest_found(scatter, units):.2f} dB are found four times of five by a single test; {enough}."
    )


def _power(effect: float, units: int) -> float:
    """How often a two-sided t-test at `SIGNIFICANT` finds a mean of `effect` standard deviations."""
    from scipy import stats

    limit = float(stats.t.ppf(1 - SIGNIFICANT / 2, units - 1))
    centre = effect * math.sqrt(units)
    # Far out scipy's noncentral t is NaN, where the answer is all but certain.
    return float(stats.nct.sf(limit, units - 1, centre)) if centre < 30 else 1.0
