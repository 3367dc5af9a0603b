"""Where lenses start: measured on the photographs, once the scene stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from dofbench.core.contracts import TrainingView
from dofbench.training.common.blur_pairs import Surface, blur_pairs
from dofbench.training.common.lens_profile import MeasuredLenses, measure_lenses
from dofbench.training.common.lenses import foci_by_exif, lens_ties
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.training_state import TrainingState

_OPAQUE = 0.8  # a pixel with less accumulated opacity shows no surface


@torch.no_grad()
def measured_lenses(
    gaussians: Gaussians, state: TrainingState, views: Sequence[TrainingView], options: GaussianOptions, seed: int
) -> MeasuredLenses | None:
    """The lenses that `lens_profile` finds on the surfaces of the Gaussians; None where too few patches show one."""
    surfaces = []
    for view in views:
        raster = rasterise(gaussians, view.camera, options.appearance, sh_degree=0)
        assert raster.depth is not None
        depth = torch.where(raster.alpha > _OPAQUE, raster.depth, 0.0).numpy(force=True)
        surfaces.append(Surface.of(view.camera, view.image, depth, view.mask, options.blur.lens_gamma))
    widths = np.array([view.camera.width for view in views])
    pairs = blur_pairs(surfaces, state.range.extent)
    foci = None
    if options.lens.lens_focus_from == "exif":
        foci = np.array(foci_by_exif(views, state.range, options.lens.lens_init_focus))
    return measure_lenses(pairs, state.range, lens_ties(views, options.lens.lens_per), widths, seed, foci)
