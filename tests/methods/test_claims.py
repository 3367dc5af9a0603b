"""Methods that learn a blur beat their own plain version on a scene of that blur, at the size of a stamp."""

from __future__ import annotations

from functools import cache

import pytest
from blurred_tabletop import CLAIMS, Claim, sharp_psnr, tabletop, trained
from tolerances import CLAIMED_GAIN


@cache
def plain_psnr(method: str, blur: str, steps: int) -> float:
    """What the plain version reaches."""
    return sharp_psnr(trained(method, tabletop(blur), steps), tabletop(blur))


@pytest.mark.slow
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.method}, {claim.blur}")
def test_it_beats_its_plain_version(claim: Claim) -> None:
    table = tabletop(claim.blur)
    found = sharp_psnr(trained(claim.method, table, claim.steps, 0, **claim.options), table)
    assert found > plain_psnr(claim.plain, claim.blur, claim.steps) + CLAIMED_GAIN
