"""Methods that learn a blur beat their own plain version on a scene of that blur, at the size of a stamp.

Those of a rate that is chosen for thousands of steps get one for hundreds. What isn't here hasn't been shown to win at
this size: Deblurring-3DGS, gsplat's masks, CoCoGaussian, and the fields but LensNeRF, which need more steps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from blurred_tabletop import Tabletop, blurred_evenly, out_of_focus, sharp_psnr, tabletop, trained
from tolerances import CLAIMED_GAIN

STEPS = 500
BLURS: dict[str, Callable[[int, np.ndarray, np.ndarray], np.ndarray]] = {
    "evenly": blurred_evenly,
    "out of focus": out_of_focus(2.0),
}


@cache
def photographed(blur: str) -> Tabletop:
    """The scene, blurred so."""
    return tabletop(BLURS[blur])


@cache
def plain_psnr(method: str, blur: str) -> float:
    """What the plain version reaches."""
    return sharp_psnr(trained(method, photographed(blur), STEPS), photographed(blur))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "plain", "blur", "options"),
    [
        ("rgs", "mipsplatting", "evenly", {"view_blur_lr": 1.0}),
        ("bags", "mipsplatting", "evenly", {}),
        ("bags", "mipsplatting", "out of focus", {}),
        ("dofgs", "mipsplatting", "out of focus", {}),
        ("dofgaussian", "mipsplatting", "out of focus", {}),
    ],
)
def test_it_beats_its_plain_version(method: str, plain: str, blur: str, options: dict[str, Any]) -> None:
    table = photographed(blur)
    found = sharp_psnr(trained(method, table, STEPS, **options), table)
    assert found > plain_psnr(plain, blur) + CLAIMED_GAIN
