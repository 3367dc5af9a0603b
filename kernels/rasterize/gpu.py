"""`rasterize` on a GPU: Triton kernels behind one autograd function; float32.

Stages: project (gpu_project, gpu_color), list each tile's Gaussians (gpu_lists, gpu_tiles), blend (gpu_blend). The
backward pass blends front to back a second time, writes one small record for each intersection of a Gaussian with a
tile, and sums these records in a fixed order (gpu_gradient). It uses no atomics, so every run gives the same bits.
Several aperture samples are images next to each other with more tiles; projection and its gradient are shared.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

from .gpu_gradient import gradients
from .gpu_inputs import CHUNK, KEPT, TILE, Settings
from .gpu_lists import project_and_list

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
# The level of geometry that each output belongs to.
_LEVELS = (0, 0, 1, 2, 2, 3)
_WARPS = 4


def rasterize(parameters, blur, view, statistics):
    settings = Settings(view, None, parameters[0].device)
    return _Rasterize.apply(settings, statistics, _learns(blur, *parameters), blur, None, *parameters)


def rasterize_from_points(parameters, blur, radius, points, view, statistics):
    """The intersections of all points are kept at once."""
    settings = Settings(view, points, parameters[0].device)
    return _Rasterize.apply(settings, statistics, _learns(blur, radius, *parameters), blur, radius, *parameters)[0]


def _learns(*inputs: Tensor | None) -> bool:
    """Whether a gradient may be asked for, which is unknown inside an autograd function."""
    return torch.is_grad_enabled() and any(each is not None and each.requires_grad for each in inputs)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(context, settings, statistics, keep, blur, radius, *parameters):
        lists = project_and_list(settings, blur, radius, parameters)
        views = (settings.views,) if settings.moved else ()
        size = (*views, settings.height, settings.width)

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
            kernels("rasterize.gpu_blend").blend, (tiles * settings.views,), lists.records, *settings.given(radius),
            settings.view, settings.background, lists.starts, lists.ids, *settings.given(*images), looked_at,
            *settings.given(kept), settings.width, settings.height, tiles, warps=_WARPS,
            GEOMETRY=settings.geometry, MOVED=settings.moved, EACH=numbers,
        )  # fmt: skip
        if statistics is not None:
            statistics.visible, statistics.radii = lists.visible, lists.radii
        context.settings, context.statistics = settings, statistics
        context.lists, context.blended = lists, (looked_at, kept, median_at, mean_inverse)
        context.set_materialize_grads(False)
        context.save_for_backward(*parameters, blur, radius, *outputs)
        return tuple(outputs)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, *by_outputs):
        saved = context.saved_tensors
        by_blur, by_radius, *by_parameters = gradients(
            context.settings, context.statistics, context.lists, saved[:6], saved[6], saved[7], saved[8:],
            context.blended, by_outputs, _LEVELS,
        )  # fmt: skip
        return None, None, None, by_blur, by_radius, *by_parameters
