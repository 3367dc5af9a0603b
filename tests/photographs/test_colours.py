"""The affine map of colours: it undoes a known map, and ignores clipped pixels; contrast that it lowers."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from tolerances import COLOUR_UNDONE

from dofbench.evaluation.scoring.photographs.colour_fit import colour_map, recoloured, with_contrast

MATRIX = np.array([[0.8, 0.05, 0.0], [0.1, 0.7, 0.02], [0.0, 0.1, 0.75], [0.05, 0.02, 0.1]])


def pixels(count: int = 500) -> np.ndarray:
    return np.random.default_rng(0).random((count, 3))


def test_an_affine_change_is_undone() -> None:
    prediction = pixels()
    photograph = prediction @ MATRIX[:3] + MATRIX[3]
    assert np.abs(colour_map(prediction, photograph) - MATRIX).max() < COLOUR_UNDONE
    assert np.abs(recoloured(prediction, colour_map(prediction, photograph)) - photograph).max() < COLOUR_UNDONE


def test_what_the_sensor_clipped_says_nothing() -> None:
    prediction = pixels()
    photograph = np.clip((prediction @ MATRIX[:3] + MATRIX[3]) * 1.6, 0, 1)
    assert (photograph == 1).any(axis=1).mean() > 0.1
    assert np.abs(colour_map(prediction, photograph) - 1.6 * MATRIX).max() < COLOUR_UNDONE
    assert np.abs(recoloured(prediction, colour_map(prediction, photograph)) - photograph).max() < COLOUR_UNDONE


def test_colours_that_nothing_decides_stay() -> None:
    grey = np.full((500, 3), 0.5)
    assert np.abs(recoloured(grey, colour_map(grey, grey)) - 0.5).max() < COLOUR_UNDONE
    # A single colour determines only one value per channel; other colours must not change much.
    moved = recoloured(np.array([[0.4, 0.5, 0.6]]), colour_map(grey, grey + 0.02))
    assert np.abs(moved - [0.4, 0.5, 0.6]).max() < 0.05
    assert np.array_equal(colour_map(pixels(10), pixels(10)), np.eye(4, 3))
    assert np.array_equal(colour_map(pixels(), np.ones((500, 3))), np.eye(4, 3))


def test_contrast_lowered_by_a_fit_is_restored() -> None:
    """A fit to texture that is displaced lowers its contrast."""
    texture = gaussian_filter(np.random.default_rng(1).normal(size=(60, 80)), 1.0, mode="wrap")
    photograph = np.repeat((0.5 + 0.1 * texture / texture.std())[..., None], 3, axis=2)
    displaced, fitted = np.roll(photograph, 2, axis=1), np.arange(60)[:, None] + np.arange(80) > 30
    lowered = recoloured(displaced, colour_map(displaced[fitted], photograph[fitted]))
    contrast = photograph[fitted].std()
    assert lowered[fitted].std() < 0.5 * contrast
    assert 0.8 * contrast < with_contrast(lowered, photograph, fitted)[fitted].std() < 1.01 * contrast


def test_equal_contrast_stays() -> None:
    photograph = np.random.default_rng(1).random((40, 50, 3))
    everywhere = np.ones((40, 50), dtype=bool)
    assert np.abs(with_contrast(photograph, photograph, everywhere) - photograph).max() < COLOUR_UNDONE
    grey = np.full((40, 50, 3), 0.5)
    assert np.isfinite(with_contrast(grey, photograph, everywhere)).all()
