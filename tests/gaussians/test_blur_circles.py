"""The widest circles of confusion and the spread of foci, against the thin lens' formula on surfaces of known depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up import frontal
from tolerances import FLOAT32_VALUE, PLANE_DEPTH

from dofbench.core.cameras import Camera
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.training.gaussians.forward_model import Shot
from dofbench.training.gaussians.lens_renderer import foci_apart, widest_circle
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions

CAMERA = frontal(40, 30, 4000.0)  # so narrow that a disc as wide as the view has one depth
OPTIONS = AppearanceOptions(filter_2d=0.0, filter_3d=False)


def _walls(*walls: tuple[float, float]) -> Gaussians:
    """Opaque upright discs, (x, z): one before the camera fills the image; z, scene units."""
    count = len(walls)
    return Gaussians(
        {
            "means": torch.tensor([[x, 0.0, z] for x, z in walls]),
            "log_scales": torch.log(torch.tensor([[40.0, 40.0, 1e-3]])).repeat(count, 1),
            "quaternions": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
            "opacity_logits": torch.full((count,), 20.0),
            "sh_dc": torch.zeros(count, 3),
            "sh_rest": torch.zeros(count, 0, 3),
        }
    )


def _shot(aperture: float, focus_disparity: float, camera: Camera = CAMERA) -> Shot:
    return Shot.through(PhysicalLens(aperture, focus_disparity, camera.width), camera)


def test_the_widest_circle_is_that_of_nine_views_in_ten() -> None:
    """A wall at 4: its circles have the radius |1/4 - focus| x aperture in every pixel."""
    apertures = np.arange(1.0, 12.0)  # of eleven views the tenth in order is the 0.9 quantile
    shots = [_shot(aperture, 0.5) for aperture in apertures]
    found = widest_circle(_walls((0.0, 4.0)), shots, OPTIONS)
    assert found == pytest.approx(10 * (0.5 - 0.25), rel=PLANE_DEPTH)


@pytest.mark.parametrize(("columns", "near"), [(0.03, False), (0.08, True)])
def test_of_a_view_it_is_that_of_95_pixels_in_100(columns: float, near: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A far wall with a near strip, over a share of the pixels: counted from a twentieth on."""
    depth = torch.full((10, 100), 4.0)
    depth[:, : round(100 * columns)] = 1.0

    class Flat:
        alpha = torch.ones(10, 100)

        def __init__(self) -> None:
            self.depth = depth

    monkeypatch.setattr("dofbench.training.gaussians.lens_renderer.rasterise", lambda *_, **__: Flat())
    found = widest_circle(_walls((0.0, 4.0)), [_shot(3.0, 0.2)], OPTIONS)
    assert found == pytest.approx(3.0 * abs((1.0 if near else 0.25) - 0.2), rel=FLOAT32_VALUE)


def test_the_foci_are_as_far_apart_as_the_circles_of_one_point_in_the_middle_half_of_the_lenses() -> None:
    """Five lenses of one aperture: a point's signed circles differ by aperture x difference of the foci, and of five
    the second and the fourth are the quartiles."""
    bounds = DisparityRange(0.1, 0.6)
    foci = [0.5, 0.1, 0.3, 0.2, 0.9]
    assert foci_apart([_shot(8.0, focus) for focus in foci], bounds) == pytest.approx(8 * 0.3, rel=FLOAT32_VALUE)
    assert foci_apart([_shot(8.0, 0.3)] * 5, bounds) == 0.0


def test_one_lens_on_two_cameras_is_not_apart() -> None:
    """Its circles are in proportion to the focal length in pixels."""
    longer = replace(CAMERA, width=30, height=40, fx=2 * CAMERA.fx, fy=2 * CAMERA.fy)
    shots = [_shot(8.0, 0.3), _shot(16.0, 0.3, longer)] * 3
    assert foci_apart(shots, DisparityRange(0.1, 0.6)) == pytest.approx(0, abs=FLOAT32_VALUE)


def test_it_is_the_end_of_the_range_that_counts_at_which_they_differ_more() -> None:
    """Lenses of one focus and five apertures: circles at the focus are 0, at the other end they differ."""
    bounds, apertures = DisparityRange(0.1, 0.6), (1.0, 2.0, 3.0, 4.0, 5.0)
    for focus in (0.1, 0.6):
        shots = [_shot(aperture, focus) for aperture in apertures]
        assert foci_apart(shots, bounds) == pytest.approx((4 - 2) * 0.5, rel=FLOAT32_VALUE)
