"""Learned lenses compared with EXIF over photographs of different cameras."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.metrics.exif_errors import exif_errors
from dofbench.evaluation.scoring.exif_scores import exif_scores, learned_apertures

OPENING = 0.05  # scene units: half the opening's width at f/2.8
NOISE = np.random.default_rng(0).normal(1, 0.01, 12)  # of the apertures, as any estimate has; without, they look tied


def photographs(cameras: list[Camera]) -> SimpleNamespace:
    """One photograph for each camera, at f/2.8 and f/5.6."""
    return SimpleNamespace(
        views=[
            SimpleNamespace(name=f"v{i:02}", split="train", camera=camera, exif=Exif(f_number=(2.8, 5.6)[i // 2 % 2]))
            for i, camera in enumerate(cameras)
        ]
    )


def lenses(dataset: SimpleNamespace) -> dict[str, PhysicalLens]:
    """The true lens of every photograph but for the noise: radius = focal length in pixels x half the opening."""
    return {
        view.name: PhysicalLens(view.camera.fx * OPENING * 2.8 / view.exif.f_number * noise, 0.2, view.camera.width)
        for view, noise in zip(dataset.views, NOISE, strict=True)
    }


LANDSCAPE = Camera(320, 240, 280.0, 280.0, 160.0, 120.0, np.eye(4))
PORTRAIT = Camera(240, 320, 280.0, 280.0, 120.0, 160.0, np.eye(4))
LONGER = replace(PORTRAIT, fx=431.0, fy=433.0)
EXPECTED = exif_errors(
    [(noise / number, number) for noise, number in zip(NOISE, [2.8, 2.8, 5.6, 5.6] * 3, strict=True)]
)


@pytest.mark.parametrize("others", [[LANDSCAPE], [PORTRAIT], [PORTRAIT, LONGER], [LANDSCAPE.resized(640, 480)]])
def test_only_the_noise_is_scored_whatever_the_cameras(others: list[Camera]) -> None:
    kinds = [LANDSCAPE, *others]
    dataset = photographs([kinds[index % len(kinds)] for index in range(12)])
    scores, reasons = exif_scores(learned_apertures(dataset, lenses(dataset)))
    assert not reasons
    assert scores["exif_spread"] == pytest.approx(EXPECTED.spread, rel=FLOAT64_VALUE)
    assert scores["exif_ratio"] == pytest.approx(EXPECTED.ratio, rel=FLOAT64_VALUE, abs=FLOAT64_VALUE)


@given(st.lists(st.tuples(st.integers(16, 4096), st.floats(0.3, 10.0)), min_size=12, max_size=12))
def test_only_the_noise_is_scored_with_random_cameras(drawn: list[tuple[int, float]]) -> None:
    dataset = photographs([replace(LANDSCAPE, width=width, fx=width * focal) for width, focal in drawn])
    scores, _ = exif_scores(learned_apertures(dataset, lenses(dataset)))
    assert scores["exif_spread"] == pytest.approx(EXPECTED.spread, rel=FLOAT64_VALUE)
