"""One view: its lens in every unit, and its shallow photograph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dofbench.core.images import encode, from_8bit
from dofbench.core.lens import LAYERS, ApertureShape, DisparityRange, Energy, Lens, SceneRenderer
from dofbench.dataset.schema import DealtRecord, ThinLensRecord, ViewRecord
from dofbench.dataset.sensor import Sensor
from dofbench.depth.disparity import disparity_of, view_range
from dofbench.optics.defocus import defocus_numpy
from dofbench.synthesis.lens_plan import PlannedView


@dataclass(frozen=True)
class Blur:
    """What all views of a dataset share: the scene's disparity range, encoding, edge, shape, renderer, sensor."""

    disparity_range: DisparityRange
    per_view: bool
    gamma: float
    alpha: float
    shape: ApertureShape
    energy: Energy
    renderer: SceneRenderer = "scatter"
    layers: int = LAYERS
    thinlens: ThinLensRecord | None = None
    sensor: Sensor = Sensor()
    bits: int = 8


def view_record(planned: PlannedView, depth: np.ndarray, blur: Blur) -> ViewRecord:
    """The planned view's lens in normalised, pixel and scene units.

    depth: (H, W) float32, scene units, 0 where unknown. A lens dealt in the view's own units
    (`blur.per_view`) is converted to the scene's, and kept beside. Raises ValueError when it has to
    be converted and no depth is known.
    """
    width = depth.shape[1]
    lens, dealt = planned.lens, None
    if blur.per_view:
        own = view_range(depth)
        lens = Lens.from_physical(planned.lens.physical(own, width), blur.disparity_range)
        dealt = DealtRecord(
            disparity_range=(own.q_min, own.q_max), aperture=planned.lens.aperture, focus=planned.lens.focus
        )
    physical = lens.physical(blur.disparity_range, width)
    radii = np.abs(physical.signed_radius(disparity_of(depth), width))
    return ViewRecord(
        name=planned.name,
        split=planned.split,
        aperture=lens.aperture,
        focus=lens.focus,
        k_px=lens.radius_per_disparity(width),
        aperture_scene=physical.aperture,
        focus_scene=physical.focus_depth,
        max_coc_px=float(radii.max()),
        dealt=dealt,
    )


def shallow_image(
    sharp: np.ndarray, depth: np.ndarray, record: ViewRecord, blur: Blur
) -> tuple[np.ndarray, np.ndarray]:
    """Blur one view by its lens, in linear light, and add the sensor's noise.

    sharp: (H, W, 3) uint8, encoded, exactly what the dataset keeps as all_in_focus, so that anyone
    can recompute the result. depth: (H, W) float32, scene units. Returns (encoded, linear), both
    (H, W, 3) float32.
    """
    physical = record.lens.physical(blur.disparity_range, sharp.shape[1])
    encoded, linear = defocus_numpy(
        from_8bit(sharp),
        depth,
        physical,
        gamma=blur.gamma,
        alpha=blur.alpha,
        shape=blur.shape,
        energy=blur.energy,
        renderer="layered" if blur.renderer == "layered" else "scatter",
        layers=blur.layers,
    )
    if not blur.sensor.is_noisy:
        return encoded, linear
    linear = blur.sensor.expose(linear, blur.sensor.standard_noise(record.name, linear.shape))
    return encode(linear, blur.gamma), linear
