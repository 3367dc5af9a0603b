"""The lens that a trained scene is shown through where nobody chose one: focus range and aperture."""

from __future__ import annotations

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange, Lens
from dofbench.datasets.format.dataset import Dataset


def focus_range(method: Method, dataset: Dataset, camera: Camera) -> DisparityRange:
    """The dataset's disparity range; where it states none, that of the depth rendered at the camera.

    Raises InputError where none is rendered.
    """
    if dataset.disparity_range is not None:
        return dataset.disparity_range
    try:
        return DisparityRange.of(method.render(camera, None).depth)
    except ValueError:
        raise InputError("depth", "none rendered", "a method that renders depth, to focus by") from None


def learned_openings(method: Method, dataset: Dataset) -> dict[str, float]:
    """Half the width of the learned lens's opening, scene units, by training view; empty without lenses."""
    cameras = {view.name: view.camera for view in dataset.training_views()}
    learned = method.lens_estimates() or {}
    return {name: lens.half_opening(cameras[name]) for name, lens in learned.items() if name in cameras}


def opening_of(aperture: float, bounds: DisparityRange, camera: Camera) -> float:
    """Half the width of the opening, scene units, of a normalised aperture on this camera."""
    return Lens(aperture, 0.0).physical(bounds, camera.width).half_opening(camera)


def usual_opening(method: Method, dataset: Dataset, bounds: DisparityRange) -> float:
    """The median learned opening; without any, that of aperture 1 on the first training camera."""
    openings = list(learned_openings(method, dataset).values())
    return float(np.median(openings)) if openings else opening_of(1.0, bounds, dataset.training_views()[0].camera)
