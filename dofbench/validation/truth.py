"""A photograph with a known lens, and what a renderer is given to make the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Truth:
    """One photograph with optical blur.

    source, name: where it is from, and what tells it from its like. aperture: largest |signed_radius|, pixels.
    focus: in the source's own unit. sharp, photograph: (H, W, 3) float32, encoded by `gamma`, [0, 1].
    signed_radius: (H, W) float32, pixels, positive nearer than the focus. border: pixels along
    the image's edges that aren't scored. own_error_db: PSNR between the photograph and one made
    with half of the samples.
    """

    source: str
    name: str
    aperture: float
    focus: float
    sharp: np.ndarray
    signed_radius: np.ndarray
    photograph: np.ndarray
    gamma: float
    border: int
    own_error_db: float
