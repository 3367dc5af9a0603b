"""Masks of a dataset's views: those of the scene, and after blurring the pixels that masked ones reach as well."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.masks import write_mask
from dofbench.datasets.format import layout
from dofbench.datasets.format.schema import ViewRecord
from dofbench.datasets.format.sensor import Sensor
from dofbench.datasets.synthesis.render_views import Photography, shallow_image
from dofbench.scenes.scene import Scene

# Share of a blurred pixel's light that may come from masked pixels, whose colour is unknown: with more it is masked.
REACHED = 0.01


def read_masks(scene: Scene) -> dict[str, np.ndarray]:
    """The mask of every view that has masked pixels, by name."""
    found = {view.name: view.mask() for view in scene.views if view.mask is not None}
    return {name: mask for name, mask in found.items() if not mask.all()}


def write_view_mask(out: Path, name: str, mask: np.ndarray) -> None:
    """Write a view's mask, (H, W) bool, unless it is there."""
    path = layout.mask_path(out, name)
    if not path.is_file():
        write_mask(path, mask)


def unreached(mask: np.ndarray, depth: np.ndarray, record: ViewRecord, shared: Photography) -> np.ndarray:
    """The mask of a blurred view: valid pixels of which at most `REACHED` of the light comes from masked pixels.

    mask: (H, W) bool, of the all-in-focus image. The masked pixels are spread by the view's own lens. Raises
    InputError if no pixel is left.
    """
    if record.aperture == 0:
        return mask
    blur = shared.blur
    if blur.renderer == "thinlens":
        blur = replace(blur, renderer="scatter")
    spread = np.repeat(np.where(mask, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    _, share = shallow_image(spread, depth, record, replace(shared, blur=blur, sensor=Sensor()))
    clear = mask & (share[..., 0] <= REACHED)
    if not clear.any():
        found = f"every pixel masked, or reached by masked ones through a blur of up to {record.max_coc_px:.1f} px"
        raise InputError(f"view {record.name}", found, "some pixels to train on: a smaller mask or aperture")
    return clear
