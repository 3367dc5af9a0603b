"""Test views of one aperture predicted from training views of another: controllable depth of field on real lenses.

The opening is the focal length over the f-number, so the aperture learned at f/N, times N / M, is that at f/M. Focus
and colours are unknown: they are fitted on one half, and the other half is scored.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles
from dofbench.evaluation.scoring.photographs.predict import (
    LensSearch,
    Prediction,
    assembled,
    frame_of,
    median_lens,
    refusal,
    sharp_rendering,
)
from dofbench.evaluation.scoring.photographs.search import Effort, Frame

FOCUSES, BEYOND = 7, 0.25  # of the grid, over the view's disparity range, extended at both ends
FOCUS_EFFORT = Effort(apertures=1, focuses=FOCUSES, coarse=6, fine=4)
QUICK_FOCUS_EFFORT = Effort(apertures=1, focuses=FOCUSES, coarse=4, fine=1)


@dataclass(frozen=True, eq=False)
class AcrossPrediction:
    """Three predictions of one view. scaled: by the learned aperture (median of the training views) times the ratio of
    the f-numbers, or by the best Gaussian blur without a lens. unscaled: without that factor; None without a lens.
    in_focus: (H, W, 3), rendered without a lens, colours fitted; None for a non-finite rendering."""

    scaled: Prediction
    unscaled: Prediction | None
    in_focus: np.ndarray | None


def predict_across(
    method: Method,
    camera: Camera,
    photograph: np.ndarray,
    learned: Mapping[str, PhysicalLens] | None,
    ratio: float,
    effort: Effort = FOCUS_EFFORT,
    *,
    cameras: Mapping[str, Camera] | None = None,
    no_lens: str = "",
    unscaled: bool = True,
    mask: np.ndarray | None = None,
) -> AcrossPrediction:
    """Predict a view whose f-number is 1 / `ratio` times that of the training views.

    photograph: (H, W, 3) float32, encoded. learned, cameras, no_lens, mask: as in `predict`. unscaled: also predict by
    the unscaled aperture.
    """
    start = time.perf_counter()
    tiles = Tiles.of(camera.height, camera.width, mask)
    image, depth, bad = sharp_rendering(method, camera)
    if bad:
        nothing = Prediction(None, None, (), tiles, no_lens, bad, time.perf_counter() - start)
        return AcrossPrediction(nothing, None, None)
    in_focus = assembled([image, image], photograph, tiles)
    lens, frame = median_lens(learned, cameras, camera), frame_of(depth, camera, learned)
    refused = no_lens or (
        "no learned aperture to be scaled" if lens is None or frame is None else refusal(method, camera, frame)
    )
    if lens is None or frame is None or refused:
        return AcrossPrediction(Prediction.by_blur(image, photograph, tiles, refused, start), None, in_focus)
    apertures = [lens.aperture_at(camera.width) * factor for factor in (ratio, *([1.0] * unscaled))]
    search = partial(_by_focus, method, camera, photograph, tiles, frame)
    scaled, *other = (search(aperture, effort).prediction(effort, start) for aperture in apertures)
    return AcrossPrediction(scaled, other[0] if other else None, in_focus)


def _by_focus(
    method: Method, camera: Camera, photograph: np.ndarray, tiles: Tiles, frame: Frame, aperture: float, effort: Effort
) -> LensSearch:
    """A search for the focus only, in normalised disparity of the view."""
    disparities = frame.disparities

    def lens(at: np.ndarray) -> PhysicalLens:
        return PhysicalLens(aperture, disparities.q_min + float(at[0]) * disparities.extent, camera.width)

    starts = [np.array([focus]) for focus in np.linspace(-BEYOND, 1 + BEYOND, effort.focuses)]
    step = (1 + 2 * BEYOND) / (effort.focuses - 1)
    return LensSearch(method, camera, photograph, tiles, starts, lens, lambda at: (step / 2, step / 8))
