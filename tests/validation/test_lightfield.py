"""Light fields made of planes of known disparity: the disparity found, and the synthesised photographs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tolerances import SWEPT_DISPARITY

from dofbench.core.errors import InputError
from dofbench.evaluation.renderer.lightfield import lightfield_cases, read_lightfield, swept
from dofbench.scenes.light_field.grid import GRID


def test_the_sweep_finds_the_disparity(lightfield):
    found, truth = swept(read_lightfield(lightfield)), np.load(lightfield / "disparity.npy")
    error = np.abs(found - truth)[6:-6, 6:-6]
    assert np.median(error) < SWEPT_DISPARITY
    # Smoothing over 11 pixels widens what is in front.
    assert np.mean(error > 0.1) < 0.2


def test_photographs_know_which_side_is_near(lightfield):
    cases = lightfield_cases(lightfield)
    assert len(cases) == len({case.key for case in cases}) == 3
    truth = np.load(lightfield / "disparity.npy")
    for photograph in (case.make() for case in cases):
        signed = photograph.signed_radius
        assert np.median(signed[truth < 0]) > np.median(signed[truth > 0])
        # Thirteen views within two steps: a disc of radius sqrt(13 / pi).
        expected = math.sqrt(13 / math.pi) * 0.8
        assert np.median(signed[truth < 0]) - np.median(signed[truth > 0]) == pytest.approx(
            expected, abs=2 * SWEPT_DISPARITY * math.sqrt(13 / math.pi)
        )


def test_another_view_is_another_truth(lightfield):
    before = [case.key for case in lightfield_cases(lightfield)]
    (lightfield / "views" / "05_06.png").write_bytes((lightfield / "views" / "05_05.png").read_bytes())
    assert not set(before) & {case.key for case in lightfield_cases(lightfield)}


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda path: (path / GRID).unlink(), "no grid.json"),
        (lambda path: (path / GRID).write_text("{}"), "no centre"),
        (lambda path: (path / "views" / "05_05.png").unlink(), "no view 05_05"),
        (lambda path: (path / "views" / "03_04.png").unlink(), "gaps"),
    ],
)
def test_a_folder_that_is_no_light_field(lightfield, damage, word):
    damage(lightfield)
    with pytest.raises(InputError, match=word) as caught:
        read_lightfield(lightfield)
    assert "\n" not in str(caught.value)
