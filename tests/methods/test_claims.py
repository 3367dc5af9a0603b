"""Methods that learn a blur beat their own plain version on a scene of that blur, at the size of a stamp.

Fields aren't here: at this size they need more steps.
"""

from __future__ import annotations

from functools import cache

import pytest
from blurred_tabletop import CLAIMS, STEPS, sharp_psnr, tabletop, trained
from tolerances import CLAIMED_GAIN


@cache
def plain_psnr(method: str, blur: str) -> float:
    """What the plain version reaches."""
    return sharp_psnr(trained(method, tabletop(blur), STEPS), tabletop(blur))


@pytest.mark.slow
@pytest.mark.parametrize(("method", "plain", "blur", "options"), CLAIMS)
def test_it_beats_its_plain_version(method: str, plain: str, blur: str, options: dict[str, float]) -> None:
    found = sharp_psnr(trained(method, tabletop(blur), STEPS, 0, **options), tabletop(blur))
    assert found > plain_psnr(plain, blur) + CLAIMED_GAIN
