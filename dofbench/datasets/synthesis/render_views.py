"""One view of a dataset: its lens in all units, and its shallow photograph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.images import from_8bit
from dofbench.core.lens import DisparityRange, Lens
from dofbench.datasets.format.schema import AssignedLensRecord, LightFieldRecord, ThinLensRecord, ViewRecord
from dofbench.datasets.format.sensor import Sensor
from dofbench.datasets.synthesis.lens_plan import PlannedView
from dofbench.optics.defocus import defocus_light, defocus_numpy
from dofbench.optics.tone import TOE, encode
from dofbench.scenes.depth.disparity import disparity_of, view_range


@dataclass(frozen=True)
class Photography:
    """Settings that all photographs of a dataset share.

    disparity_range: the range that focus and aperture refer to; per_view: whether they were assigned in each view's own
    range instead. thinlens: the geometry for the renderer "thinlens"; light_field: the grid for "light-field". bits:
    of a channel of the photographs that methods train on.
    """

    disparity_range: DisparityRange
    per_view: bool
    blur: Blur = Blur()
    thinlens: ThinLensRecord | None = None
    light_field: LightFieldRecord | None = None
    sensor: Sensor = Sensor()
    bits: Literal[8, 16] = 8


def view_record(planned: PlannedView, depth: np.ndarray, shared: Photography) -> ViewRecord:
    """The planned view's lens in normalised, pixel and scene units.

    depth: (H, W) float32, scene units, 0 where unknown. A lens assigned in the view's own units (`shared.per_view`) is
    converted to the scene's units, and the original is recorded too. Raises ValueError for such a view without known
    depth.
    """
    width = depth.shape[1]
    lens, dealt = planned.lens, None
    if shared.per_view:
        own = view_range(depth)
        lens = Lens.from_physical(planned.lens.physical(own, width), shared.disparity_range)
        dealt = AssignedLensRecord(
            disparity_range=(own.q_min, own.q_max), aperture=planned.lens.aperture, focus=planned.lens.focus
        )
    physical = lens.physical(shared.disparity_range, width)
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
    sharp: np.ndarray, depth: np.ndarray, record: ViewRecord, shared: Photography
) -> tuple[np.ndarray, np.ndarray]:
    """Blur one view by its lens, in linear light, and add the sensor's noise.

    sharp: (H, W, 3) uint8, encoded, exactly the image that the dataset stores as all_in_focus, so that anyone can
    recompute the result. depth: (H, W) float32, scene units. Returns (encoded, linear), both (H, W, 3) float32.
    """
    physical = record.lens.physical(shared.disparity_range, sharp.shape[1])
    encoded, linear = defocus_numpy(from_8bit(sharp), depth, physical, shared.blur)
    return _with_noise(linear, record, shared) if shared.sensor.is_noisy else (encoded, linear)


def shallow_light(
    light: np.ndarray, depth: np.ndarray, record: ViewRecord, shared: Photography
) -> tuple[np.ndarray, np.ndarray]:
    """`shallow_image` of a view whose source is linear light, so that what is brighter than white stays so.

    light: (H, W, 3) float32, exactly what the dataset stores as all_in_focus_linear. Returns (encoded, linear), both
    (H, W, 3) float32, not clipped.
    """
    linear = defocus_light(light, depth, record.lens.physical(shared.disparity_range, light.shape[1]), shared.blur)
    if shared.sensor.is_noisy:
        return _with_noise(linear, record, shared)
    return encode(linear, shared.blur.gamma, toe=TOE).astype(np.float32), linear


def _with_noise(linear: np.ndarray, record: ViewRecord, shared: Photography) -> tuple[np.ndarray, np.ndarray]:
    linear = shared.sensor.expose(linear, shared.sensor.standard_noise(record.name, linear.shape))
    return encode(linear, shared.blur.gamma), linear
