"""Masked pixels have no influence on a score, and no part in it."""

from __future__ import annotations

import numpy as np
import pytest

from dofbench.evaluation.metrics import METRICS, metric, score_image

IMAGES = [entry.id for entry in METRICS.values() if entry.needs == "images"]


def pair(seed: int = 0, height: int = 60, width: int = 70) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(prediction, truth, mask with a large and some small holes)."""
    random = np.random.default_rng(seed)
    truth = random.uniform(size=(height, width, 3)).astype(np.float32)
    prediction = np.clip(truth + random.normal(size=truth.shape) * 0.1, 0, 1).astype(np.float32)
    mask = random.uniform(size=(height, width)) > 0.02
    mask[10:35, 20:50] = False
    return prediction, truth, mask


def changed(image: np.ndarray, mask: np.ndarray, seed: int) -> np.ndarray:
    """The image with noise under the mask."""
    noise = np.random.default_rng(seed).uniform(size=image.shape).astype(np.float32)
    return np.where(mask[..., None], image, noise)


@pytest.mark.parametrize("name", IMAGES)
def test_what_is_under_a_mask_changes_no_bit_of_a_score(name: str) -> None:
    prediction, truth, mask = pair()
    score = score_image(prediction, truth, [name], mask)[name]
    again = score_image(changed(prediction, mask, 1), changed(truth, mask, 2), [name], mask)[name]
    assert np.isfinite(score) and score == again
    assert score != score_image(prediction, truth, [name])[name]


@pytest.mark.parametrize("name", IMAGES)
def test_errors_under_a_mask_are_none(name: str) -> None:
    _, truth, mask = pair()
    wrong = changed(truth, mask, 3)
    assert score_image(wrong, truth, [name])[name] != score_image(truth, truth, [name])[name]
    best = score_image(truth, truth, [name])[name]
    assert score_image(wrong, truth, [name], mask)[name] == best or metric(name).best == best


@pytest.mark.parametrize("name", IMAGES)
def test_one_valid_pixel_has_a_score(name: str) -> None:
    prediction, truth, _ = pair()
    mask = np.zeros(truth.shape[:2], bool)
    mask[0, 3] = True
    assert np.isfinite(score_image(prediction, truth, [name], mask)[name])


def test_a_mask_of_another_size_or_without_a_pixel_is_refused() -> None:
    prediction, truth, mask = pair()
    for wrong in (mask[1:], np.zeros_like(mask)):
        with pytest.raises(ValueError, match="mask"):
            score_image(prediction, truth, ["psnr"], wrong)
