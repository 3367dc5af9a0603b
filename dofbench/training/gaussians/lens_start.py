"""Where lenses start: measured on the photographs, once the scene stands."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np
import torch

from dofbench.core.contracts import TrainingView
from dofbench.training.common.blur_pairs import NEIGHBOURS, Surface, blur_pairs, luma
from dofbench.training.common.lens_profile import MeasuredLenses, measure_lenses
from dofbench.training.common.lenses import foci_by_exif, lens_ties
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.training_state import TrainingState

_LIGHTS = 2 * NEIGHBOURS
_OPAQUE = 0.8  # a pixel with less accumulated opacity shows no surface


@torch.no_grad()
def measured_lenses(
    gaussians: Gaussians, state: TrainingState, views: Sequence[TrainingView], options: GaussianOptions, seed: int
) -> MeasuredLenses | None:
    """The lenses that `lens_profile` finds on the surfaces of the Gaussians; None where too few patches show one."""
    # Luma is made anew where it isn't among the last few: that of all photographs at once takes 4 bytes a pixel.
    light = lru_cache(_LIGHTS)(lambda index: luma(views[index].image, options.blur.lens_gamma))
    surfaces = []
    for index, view in enumerate(views):
        raster = rasterise(gaussians, view.camera, options.appearance, sh_degree=0)
        assert raster.depth is not None
        depth = torch.where(raster.alpha > _OPAQUE, raster.depth, 0.0).numpy(force=True)
        depth = depth if view.mask is None else np.where(view.mask, depth, 0.0)
        surfaces.append(Surface(view.camera, partial(light, index), depth))
    widths = np.array([view.camera.width for view in views])
    pairs = blur_pairs(surfaces, state.range.extent)
    foci = None
    if options.lens.lens_focus_from == "exif":
        foci = np.array(foci_by_exif(views, state.range, options.lens.lens_init_focus))
    return measure_lenses(pairs, state.range, lens_ties(views, options.lens.lens_per), widths, seed, foci)
