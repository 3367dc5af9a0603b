"""Which pixels of a blurred view masked ones reach."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange, Lens
from dofbench.datasets.synthesis.lens_plan import PlannedView
from dofbench.datasets.synthesis.masked_views import REACHED, unreached
from dofbench.datasets.synthesis.render_views import Photography, shallow_image, view_record

SHARED = Photography(DisparityRange(0.1, 0.6), per_view=False)


def test_what_is_left_depends_on_masked_pixels_by_no_more_than_their_share() -> None:
    random = np.random.default_rng(0)
    mask = np.ones((48, 200), bool)
    mask[15:30, 60:90] = False
    depth = np.where(mask, np.float32(2.0), np.float32(0))
    record = view_record(PlannedView("v", "train", Lens(1.0, 0.5)), depth, SHARED)
    left = unreached(mask, depth, record, SHARED)
    assert not (left & ~mask).any() and 0.5 < left.mean() < mask.mean()
    image = random.integers(100, 150, (48, 200, 3), dtype=np.uint8)
    light = [
        shallow_image(np.where(mask[..., None], image, np.uint8(colour)), depth, record, SHARED)[1]
        for colour in (0, 255)
    ]
    differs = np.abs(light[1] - light[0]).max(axis=2)
    assert differs[left].max() <= REACHED + FLOAT32_VALUE < differs[mask & ~left].max()
    sharp = view_record(PlannedView("v", "train", Lens(0.0, 0.5)), depth, SHARED)
    assert np.array_equal(unreached(mask, depth, sharp, SHARED), mask)


def test_a_view_without_a_pixel_left_is_named() -> None:
    mask = np.zeros((48, 200), bool)
    mask[24, 100] = True
    depth = np.where(mask, np.float32(2.0), np.float32(0))
    record = view_record(PlannedView("v7", "train", Lens(1.0, 0.9)), depth, SHARED)
    with pytest.raises(InputError, match="view v7: found every pixel masked"):
        unreached(mask, depth, record, SHARED)
