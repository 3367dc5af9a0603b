"""Every image metric keeps what the registry says of it: direction, ends of the range, failure cases."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from called import called, imported_by
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.errors import InputError
from dofbench.evaluation.metrics import METRICS, Metric, metric, score_image

IMAGE_METRICS = [entry for entry in METRICS.values() if entry.needs == "images"]
SYMMETRIC = ("psnr", "ssim", "ssim_uniform7", "ms_ssim", "flip", "gmsd", "delta_e")
each = pytest.mark.parametrize("entry", IMAGE_METRICS, ids=lambda entry: entry.id)


def picture(height: int = 64, width: int = 80, seed: int = 0) -> np.ndarray:
    """A smooth coloured image with edges, float64, [0.1, 0.9]."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = np.sin(x[..., None] / rng.uniform(4, 9, 3)) * np.cos(y[..., None] / rng.uniform(4, 9, 3))
    return 0.5 + 0.2 * waves + 0.2 * np.sign(np.sin((x + 2 * y)[..., None] / 11))


def noisy(image: np.ndarray, amount: float, seed: int = 1) -> np.ndarray:
    return np.clip(image + amount * np.random.default_rng(seed).standard_normal(image.shape), 0, 1)


def test_ids() -> None:
    lens = "delta_a delta_f delta_r disparity_error depth_rel exif_spread exif_ratio exif_focus exif_focus_scatter"
    assert list(METRICS) == [*SYMMETRIC, *lens.split(), "lpips_alex", "lpips_vgg"]
    for key, entry in METRICS.items():
        assert entry.id == key
        assert entry.label and entry.note
        assert (entry.function is None) == (entry.needs != "images")


@each
def test_equal_images_score_best(entry: Metric) -> None:
    for dtype in (np.float32, np.float64):
        image = picture().astype(dtype)
        assert entry.function(image, image.copy()) == pytest.approx(entry.best, abs=FLOAT64_VALUE)


@each
@pytest.mark.parametrize("seed", [0, 1])
def test_more_noise_scores_worse(entry: Metric, seed: int) -> None:
    truth = picture(seed=seed)
    scores = [entry.function(noisy(truth, amount), truth) for amount in (0.01, 0.03, 0.1, 0.3)]
    assert scores == sorted(scores, reverse=entry.higher_is_better)
    assert len(set(scores)) == len(scores)
    low, high = sorted((entry.best, entry.worst))
    assert all(low <= score <= high for score in scores)


@each
def test_opposite_images_stay_in_range(entry: Metric) -> None:
    truth = picture()
    low, high = sorted((entry.best, entry.worst))
    for prediction in (1 - truth, np.zeros_like(truth), np.ones_like(truth)):
        assert low <= entry.function(prediction, truth) <= high


@each
def test_result_is_a_plain_number_and_repeats(entry: Metric) -> None:
    truth = picture()
    prediction = noisy(truth, 0.1)
    before = prediction.copy(), truth.copy()
    first = entry.function(prediction, truth)
    assert type(first) is float
    assert entry.function(prediction, truth) == first
    assert np.array_equal(prediction, before[0]) and np.array_equal(truth, before[1])
    if entry.id in SYMMETRIC:
        assert entry.function(truth, prediction) == pytest.approx(first, rel=FLOAT32_VALUE)


@each
def test_memory_layout_does_not_matter(entry: Metric) -> None:
    truth = picture()
    prediction = noisy(truth, 0.1)
    wide = [np.repeat(image, 2, axis=1)[:, ::2] for image in (prediction, truth)]
    assert entry.function(*wide) == entry.function(prediction, truth)


@each
def test_nan_gives_nan(entry: Metric) -> None:
    truth, broken = picture(), picture()
    broken[3, 5, 1] = math.nan
    assert math.isnan(entry.function(broken, truth))
    assert math.isnan(entry.function(truth, broken))


@each
def test_images_that_do_not_fit_are_refused(entry: Metric) -> None:
    image = picture()
    for prediction, truth in (
        (image[1:], image),
        (image[..., :1], image[..., :1]),
        (image[..., 0], image[..., 0]),
        (image, image[None]),
    ):
        with pytest.raises(ValueError, match="expected"):
            entry.function(prediction, truth)
    integers = (255 * image).astype(np.uint8)
    with pytest.raises(ValueError, match=r"^prediction: found uint8, expected floats"):
        entry.function(integers, image)
    with pytest.raises(ValueError, match=r"^truth: found uint8, expected floats"):
        entry.function(image, integers)


@pytest.mark.parametrize(("metric_id", "smallest"), [("ssim", 11), ("ms_ssim", 11), ("gmsd", 3)])
def test_images_that_are_too_small_are_refused(metric_id: str, smallest: int) -> None:
    function = METRICS[metric_id].function
    image = picture(smallest, smallest)
    assert math.isfinite(function(noisy(image, 0.1), image))
    with pytest.raises(ValueError, match=f"at least {smallest} x {smallest} pixels"):
        function(image[1:], image[1:])


def test_score_image() -> None:
    truth = picture()
    prediction = noisy(truth, 0.1)
    scores = score_image(prediction, truth, ["gmsd", "psnr"])
    assert list(scores) == ["gmsd", "psnr"]
    assert scores["psnr"] == METRICS["psnr"].function(prediction, truth)


def test_unknown_metrics_are_refused() -> None:
    with pytest.raises(InputError, match="'lpips', expected one of delta_a, delta_e"):
        metric("lpips")
    for metric_id in ("delta_a", "lpips_alex"):
        with pytest.raises(InputError, match="needs lenses, depth or weights"):
            score_image(picture(), picture(), [metric_id])


def test_importing_the_registry_loads_nothing_heavy() -> None:
    heavy = {"torch", "numba", "cv2", "OpenImageIO", "scipy", "skimage", "colour", "matplotlib", "flip_evaluator"}
    assert not heavy & imported_by("import dofbench.evaluation.metrics")


@pytest.mark.slow
def test_metrics_print_nothing() -> None:
    script = (
        "import numpy as np; from dofbench.evaluation.metrics import METRICS, score_image\n"
        "a = np.full((32, 32, 3), 0.25); b = np.full((32, 32, 3), 0.5)\n"
        "score_image(a, b, [m.id for m in METRICS.values() if m.needs == 'images'])"
    )
    done = called([sys.executable, "-c", script])
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
