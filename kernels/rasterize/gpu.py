"""`rasterize` on a GPU: Triton kernels behind one autograd function; float32.

Stages: project (gpu_project, gpu_color), list each tile's Gaussians (gpu_lists, gpu_tiles), blend (gpu_blend). The
backward pass blends front to back a second time, writes one small record for each intersection of a Gaussian with a
tile, and sums these records in a fixed order (gpu_gradient). It uses no atomics, so every run gives the same bits.
Several points of a lens are pictures beside each other with more tiles; projection and its gradient are shared.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, kernels_device, launch
from dofbench.runtime.raster import GEOMETRIES, Geometry, Raster, ViewStatistics

from .gpu_gradient import gradients
from .gpu_inputs import CHUNK, KEPT, TILE, Settings
from .gpu_lists import project_and_list
from .reference_arguments import check

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
# The level of geometry that each output belongs to.
_LEVELS = (0, 0, 1, 2, 2, 3)
_WARPS = 4


def rasterize(
    means: Tensor,
    log_scales: Tensor,
    quaternions: Tensor,
    opacity_logits: Tensor,
    sh_dc: Tensor,
    sh_rest: Tensor,
    *,
    camera: Camera,
    filter_3d: Tensor | None = None,
    sh_degree: int = 3,
    background: Tensor | None = None,
    filter_2d: float = 0.1,
    filter_2d_fades: bool = True,
    blur: Tensor | None = None,
    geometry: Geometry = "depth",
    near: float = 0.2,
    statistics: ViewStatistics | None = None,
) -> Raster:
    """Same arguments, results and errors as `cpu.rasterize`, which documents them; tensors are on a GPU.

    Waits for the GPU once, before blending. Raises InputError where Triton isn't installed.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    check(parameters, filter_3d, background, blur, None, geometry, sh_degree, filter_2d, near, kernels_device())
    degree = min(sh_degree, math.isqrt(sh_rest.shape[1] + 1) - 1)
    level = GEOMETRIES.index(geometry)
    settings = Settings(
        camera, degree, filter_2d, filter_2d_fades, near, level, filter_3d, background, None, means.device
    )
    keep = _learns(blur, *parameters)
    return Raster(*_Rasterize.apply(settings, statistics, keep, blur, None, *parameters))


def rasterize_from_points(
    means: Tensor,
    log_scales: Tensor,
    quaternions: Tensor,
    opacity_logits: Tensor,
    sh_dc: Tensor,
    sh_rest: Tensor,
    *,
    camera: Camera,
    points: np.ndarray,
    radius: Tensor,
    blur: Tensor | None = None,
    filter_3d: Tensor | None = None,
    sh_degree: int = 3,
    background: Tensor | None = None,
    filter_2d: float = 0.1,
    filter_2d_fades: bool = True,
    near: float = 0.2,
    statistics: ViewStatistics | None = None,
) -> Tensor:
    """Same arguments, results and errors as `cpu_points.rasterize_from_points`, which documents them; tensors are on a
    GPU.

    The intersections of all points are kept at once. Waits for the GPU once, before blending. Raises InputError where
    Triton isn't installed.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    check(parameters, filter_3d, background, blur, radius, "none", sh_degree, filter_2d, near, kernels_device())
    lens = np.ascontiguousarray(points, dtype=np.float32)
    if lens.ndim != 2 or lens.shape[1:] != (2,) or not len(lens):
        raise ValueError(f"points: expected shape (P, 2), P at least 1, found {lens.shape}")
    degree = min(sh_degree, math.isqrt(sh_rest.shape[1] + 1) - 1)
    settings = Settings(camera, degree, filter_2d, filter_2d_fades, near, 0, filter_3d, background, lens, means.device)
    keep = _learns(blur, radius, *parameters)
    images: Tensor = _Rasterize.apply(settings, statistics, keep, blur, radius, *parameters)[0]
    return images


def _learns(*inputs: Tensor | None) -> bool:
    """Whether a gradient may be asked for, which inside an autograd function nobody can tell."""
    return torch.is_grad_enabled() and any(each is not None and each.requires_grad for each in inputs)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, settings, statistics, keep, blur, radius, *parameters):
        lists = project_and_list(settings, blur, radius, parameters)
        pictures = (settings.views,) if settings.moved else ()
        size = (*pictures, settings.height, settings.width)

        def image(level, *channels, dtype=torch.float32):
            """Room for an output, None beyond the level of geometry asked for."""
            if settings.geometry < level:
                return None
            return torch.empty((*size, *channels), dtype=dtype, device=settings.view.device)

        outputs = [image(level, *(3,) * (k in (0, 4))) for k, level in enumerate(_LEVELS)]
        median_at, mean_inverse = image(2, dtype=torch.int32), image(3)
        tiles = settings.columns * settings.rows
        looked_at = lists.starts.new_empty(tiles * settings.views)
        numbers = KEPT[settings.geometry] if keep else 0
        kept = None
        if keep:
            kept = settings.view.new_empty(lists.ids.numel() // CHUNK + tiles * settings.views, numbers, TILE * TILE)
        color, alpha, depth, median, normal, distortion = outputs
        images = (color, alpha, depth, median, median_at, normal, distortion, mean_inverse)
        launch(
            kernels("rasterize.gpu_blend").blend,
            (tiles * settings.views,),
            lists.records,
            settings.view if radius is None else radius,
            settings.view,
            settings.background,
            lists.starts,
            lists.ids,
            *(settings.view if each is None else each for each in images),
            looked_at,
            settings.view if kept is None else kept,
            settings.width,
            settings.height,
            tiles,
            warps=_WARPS,
            GEOMETRY=settings.geometry,
            MOVED=settings.moved,
            EACH=numbers,
        )
        if statistics is not None:
            statistics.visible, statistics.radii = lists.visible, lists.radii
        ctx.settings, ctx.statistics = settings, statistics
        ctx.lists, ctx.blended = lists, (looked_at, kept, median_at, mean_inverse)
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*parameters, blur, radius, *outputs)
        return tuple(outputs)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *by_outputs):
        saved = ctx.saved_tensors
        by_blur, by_radius, *by_parameters = gradients(
            ctx.settings,
            ctx.statistics,
            ctx.lists,
            saved[:6],
            saved[6],
            saved[7],
            saved[8:],
            ctx.blended,
            by_outputs,
            _LEVELS,
        )
        return None, None, None, by_blur, by_radius, *by_parameters
