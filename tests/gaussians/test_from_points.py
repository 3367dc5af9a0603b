"""The Gaussians that training starts from."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import cloud
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.training.gaussians.model import Gaussians

SPREAD = np.random.default_rng(5).uniform(size=(40, 3))


def _scales(xyz: np.ndarray) -> np.ndarray:
    """(N, 3) deviations, scene units."""
    started = Gaussians.from_points(cloud(xyz, rgb=np.full((len(xyz), 3), 0.5)), 0)
    return np.exp(started.parameters["log_scales"].detach().double().numpy())


def test_a_point_is_as_large_as_the_root_mean_square_distance_to_its_three_neighbours() -> None:
    distances = np.sort(np.linalg.norm(SPREAD[:, None] - SPREAD[None], axis=2), axis=1)[:, 1:4]
    expected = np.sqrt((distances**2).mean(axis=1))
    assert _scales(SPREAD) == pytest.approx(np.repeat(expected[:, None], 3, axis=1), rel=FLOAT32_SCALAR)


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_points_that_coincide_have_a_size_that_follows_the_scene_s_unit(unit: float) -> None:
    """Four at one place have neighbours at no distance at all."""
    xyz = np.concatenate([np.repeat(SPREAD[:1], 4, axis=0), SPREAD[1:]])
    scales = _scales(xyz)
    assert np.median(scales) / 200 < scales[:4].max() < np.median(scales) / 50
    assert _scales(xyz * unit) == pytest.approx(scales * unit, rel=FLOAT32_VALUE)


@pytest.mark.parametrize(
    ("xyz", "found"), [(SPREAD[:3], "3"), (np.repeat(SPREAD[:1], 9, axis=0), "all at the same place")]
)
def test_too_few_places_are_the_user_s_mistake(xyz: np.ndarray, found: str) -> None:
    with pytest.raises(InputError, match=found):
        _scales(xyz)
