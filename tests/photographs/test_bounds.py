"""The fit ceiling, and the energies of blur and error, of a method that knows its scene."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from known_scene import CAMERA, TRUE, Known

from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.results.protocol import ACROSS_COLUMNS, PHOTOGRAPH_COLUMNS
from dofbench.evaluation.scoring.photograph_scores import FIT_VIEWS, fit_ceiling, fit_views, scored_photographs

SHARP, BLURRED = Known().render(CAMERA, None).image, Known().render(CAMERA, TRUE).image


class Learned(Known):
    """It has learned the true lens of all training views."""

    def lens_estimates(self) -> dict[str, PhysicalLens]:
        return {f"t{index}": TRUE for index in range(3)}


def dataset(test: np.ndarray, train: np.ndarray = BLURRED, f_number: float = 2.0) -> SimpleNamespace:
    """Three training photographs at f/2, and one test photograph."""
    views = [SimpleNamespace(name=f"t{index}", camera=CAMERA, exif=Exif(f_number=2.0)) for index in range(3)]
    tested = [SimpleNamespace(name="u", camera=CAMERA, exif=Exif(f_number=f_number), has_mask=False)]
    return SimpleNamespace(
        training_views=lambda: views,
        test_views=lambda: tested,
        image=lambda view: test if view.name == "u" else train,
        mask=lambda view: None,
        points=None,
    )


def energies_of(test: np.ndarray, columns: tuple[str, ...], f_number: float = 2.0) -> tuple[float, float] | None:
    (scored,) = scored_photographs(Learned(), dataset(test, f_number=f_number), columns, no_lens="", quick=False)
    return scored.energies


def test_the_lens_explains_the_blur_of_a_known_scene_and_nothing_of_a_sharp_photograph() -> None:
    blur, error = energies_of(BLURRED, PHOTOGRAPH_COLUMNS)
    assert blur / error == pytest.approx(1, abs=0.1)
    assert energies_of(SHARP, PHOTOGRAPH_COLUMNS)[0] == 0


def test_of_another_aperture_the_blur_of_the_training_views_counts() -> None:
    """The test photograph at f/32 is sharp: its own lens would explain nothing."""
    across, of_training = energies_of(SHARP, ACROSS_COLUMNS, 32.0), energies_of(BLURRED, PHOTOGRAPH_COLUMNS)
    assert across[0] == pytest.approx(of_training[0], rel=0.5), "but for the colours, fitted to another picture"


def test_without_a_lens_there_are_no_energies() -> None:
    class Lensless(Learned):
        def lens_estimates(self) -> None:
            return None

    (scored,) = scored_photographs(Lensless(), dataset(BLURRED), PHOTOGRAPH_COLUMNS, no_lens="", quick=False)
    assert scored.energies is None and scored.prediction.refused


def test_the_fit_ceiling_is_the_score_of_training_photographs() -> None:
    for train, least in ((BLURRED, 38), (SHARP, 38)):
        held = dataset(np.zeros_like(SHARP), train)
        assert fit_ceiling(Learned(), held, fit_views(held), no_lens="") > least
    noise = np.random.default_rng(0).normal(0, 0.1, SHARP.shape).astype(np.float32)
    worse = dataset(BLURRED, np.clip(BLURRED + noise, 0, 1))
    assert fit_ceiling(Learned(), worse, fit_views(worse), no_lens="") == pytest.approx(-20 * math.log10(0.1), abs=1.5)
    assert fit_ceiling(Learned(nan=True), worse, fit_views(worse), no_lens="") is None


@pytest.mark.parametrize(
    ("train", "test", "expected"), [(1, 9, [0]), (15, 99, list(range(0, 15, 2))), (9, 3, [0, 4, 8]), (9, 1, [0])]
)
def test_the_views_of_the_ceiling_are_evenly_spaced(train: int, test: int, expected: list[int]) -> None:
    views = {"training_views": lambda: list(range(train)), "test_views": lambda: list(range(test))}
    assert fit_views(SimpleNamespace(**views)) == expected and len(expected) <= FIT_VIEWS
