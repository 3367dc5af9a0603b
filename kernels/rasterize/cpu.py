"""`rasterize` on the CPU: numba kernels behind one autograd function; float32.

Stages: project (cpu_project), sort and assign to tiles (cpu_bin), blend (cpu_blend). The backward pass blends front to
back a second time, writes one small record per intersection of a Gaussian with a tile, and sums these records in a
fixed order (cpu_project_backward). It uses no atomics, so every run gives the same bits with any number of threads.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.backend import Backend
from dofbench.runtime.kernel_cache import is_compiled
from dofbench.runtime.raster import GEOMETRIES, Geometry, Raster, ViewStatistics

from . import cpu_layout as layout
from .cpu_bin import depth_order, fill_tiles
from .cpu_blend import blend, blend_backward
from .cpu_inputs import NOTHING, Settings, check, describe
from .cpu_points import rasterize_from_points
from .cpu_project import project
from .cpu_project_backward import project_backward

# The level of geometry that each output belongs to.
_LEVELS = (0, 0, 1, 2, 2, 3)
_EMPTY2 = np.empty((0, 0), np.float32)
_EMPTY3 = np.empty((0, 0, 3), np.float32)


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
    """Render N Gaussians from `camera`; all outputs are differentiable with respect to the first six arguments and
    `blur`.

    means: (N, 3), world, scene units. log_scales: (N, 3), natural logarithm of scene units. quaternions: (N, 4),
    w first, any length; zero means no rotation. opacity_logits: (N,). sh_dc: (N, 3) and sh_rest: (N, K, 3),
    K = 0, 3, 8 or 15: spherical harmonics in 3DGS' basis; colour is 1/2 + their sum, clamped at 0 from below.
    All are contiguous float32 on the CPU.

    filter_3d: (N,), scene units, or None: Mip-Splatting's 3D filter, added to the scales in quadrature, the
    opacity lowered to match; it gets no gradient. sh_degree: highest degree used (or that of K, if it is lower).
    background: (3,), None for black; it gets no gradient. filter_2d: px**2, added to the footprint's covariance, 0 for
    none. filter_2d_fades: whether that lowers the opacity, as Mip-Splatting's filter does; 3DGS's dilation doesn't.
    near: scene units; Gaussians whose centre isn't farther than this are left out. statistics: filled in if given.

    blur: (N,), px**2, at least 0, or None: an isotropic variance for each Gaussian, added to its footprint's covariance
    after the 2D filter, while its opacity is multiplied by sqrt(det before / det after). This keeps the Gaussian's
    integral over the image, as if a lens had spread it (even the part below 1/255 of its peak: see below). Depth and
    normals are those of the Gaussian without blur, whose plane is continued over the wider footprint.

    geometry: "none" gives colour and alpha, "depth" adds depth, "full" adds median depth and normals, "distortion"
    adds the spread of disparity along the ray. These are RaDe-GS': a Gaussian's ray length at a pixel is that of its
    plane of largest density, affine in the pixel, at least `near` (a ray length clamped there passes no gradient on);
    ray lengths are blended, then converted to z by the pixel's cosine. A Gaussian seen exactly edge-on has no such
    plane: its ray length is that of its centre, its normal zero. The median depth is that of the last Gaussian in front
    of which the transmittance is above one half. In float32 distortion has a relative error of about 1e-4, plus the
    rounding of disparity.

    A Gaussian counts at a pixel where its alpha, at most 0.99, is at least 1/255, and the transmittance in front of it
    is at least 1e-4; a Gaussian whose footprint has a determinant of at most 1e-6 px**4 is left out: without the 2D
    filter if that lowers opacities, else with it. With
    blur, the threshold 1/255 is lowered by the same factor as the opacity, because otherwise most widely blurred
    Gaussians would be lost, even where many faint ones overlap.

    Raises ValueError for arguments of the wrong shape or type, FloatingPointError, which names the argument and the
    Gaussian, if a Gaussian in front of the camera has a NaN or an infinity.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    check(parameters, filter_3d, background, blur, None, geometry, sh_degree, filter_2d, near)
    degree = min(sh_degree, math.isqrt(sh_rest.shape[1] + 1) - 1)
    settings = Settings(
        camera, degree, filter_2d, filter_2d_fades, near, GEOMETRIES.index(geometry), filter_3d, background
    )
    return Raster(*_Rasterize.apply(settings, statistics, blur, *parameters))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, settings, statistics, blur, *parameters):
        n = parameters[0].shape[0]
        rest = parameters[5].shape[1]
        flat = [parameter.detach().numpy().reshape(-1) for parameter in parameters]
        variance = NOTHING if blur is None else blur.detach().numpy()
        padded = -(-n // 8) * 8
        records = np.empty(padded * layout.RECORD, np.float32)
        depths, radii = np.empty(padded, np.float32), np.empty(padded, np.float32)
        visible, counts = np.empty(padded, np.bool_), np.empty(padded, np.int32)
        threads = numba.get_num_threads()
        bad = project(
            *flat,
            rest,
            settings.filter_3d,
            variance,
            NOTHING,
            settings.degree,
            settings.geometry,
            settings.view,
            records,
            depths,
            radii,
            visible,
            counts,
        )
        if bad >= 0:
            raise FloatingPointError(describe(bad, parameters, settings.filter_3d, variance))
        order = depth_order(depths, counts, n)
        starts, ids, spans, offsets, places = fill_tiles(
            records, counts, n, order, settings.view, settings.columns, settings.rows, threads
        )
        height, width, geometry = settings.height, settings.width, settings.geometry
        color, alpha = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
        depth = np.empty((height, width), np.float32) if geometry > 0 else _EMPTY2
        median, at = (np.empty((height, width), np.float32) if geometry > 1 else _EMPTY2 for _ in range(2))
        normal = np.empty((height, width, 3), np.float32) if geometry > 1 else _EMPTY3
        distortion, mean_inverse = (
            np.empty((height, width), np.float32) if geometry > 2 else _EMPTY2 for _ in range(2)
        )
        looked_at = np.empty(settings.columns * settings.rows, np.int32)
        blend(
            settings.features,
            records,
            starts,
            ids,
            spans,
            settings.view,
            settings.columns,
            settings.background,
            *(image.reshape(-1) for image in (color, alpha, depth, median, at, normal, distortion, mean_inverse)),
            looked_at,
            4 * threads,
        )
        if statistics is not None:
            statistics.visible = torch.from_numpy(visible[:n])
            statistics.radii = torch.from_numpy(radii[:n])
        outputs = [torch.from_numpy(image) for image in (color, alpha, depth, median, normal, distortion)]
        ctx.settings, ctx.statistics = settings, statistics
        ctx.tiles = (records, starts, ids, spans, offsets, places, looked_at, at.reshape(-1), mean_inverse.reshape(-1))
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*parameters, torch.from_numpy(variance) if blur is None else blur, *outputs)
        return tuple(output if geometry >= level else None for output, level in zip(outputs, _LEVELS, strict=True))

    @staticmethod
    def backward(ctx, *output_gradients):
        settings, statistics = ctx.settings, ctx.statistics
        saved = [tensor.detach().numpy().reshape(-1) for tensor in ctx.saved_tensors]
        parameters, blur, (color, alpha, depth, _, normal, distortion) = saved[:6], saved[6], saved[7:]
        records, starts, ids, spans, offsets, places, looked_at, at, mean_inverse = ctx.tiles
        arrays = [NOTHING if g is None else g.contiguous().numpy().reshape(-1) for g in output_gradients]
        # Gradients are computed only for the outputs that the loss uses.
        used = [level for array, level in zip(arrays, _LEVELS, strict=True) if array.size]
        features = settings.features[: max(used, default=0)]
        want_abs = statistics is not None and statistics.want_abs
        width = 24 if len(features) > 1 else 16
        gradients = np.empty(ids.size * width, np.float32)
        threads = numba.get_num_threads()
        blend_backward(
            features,
            (0,) * want_abs,
            records,
            starts,
            ids,
            spans,
            settings.view,
            settings.columns,
            looked_at,
            color,
            alpha,
            depth,
            normal,
            at,
            distortion,
            mean_inverse,
            *arrays,
            gradients,
            4 * threads,
        )
        n, rest = parameters[3].size, ctx.saved_tensors[5].shape[1]
        # Allocated by numpy, which requests huge pages and torch doesn't: this makes the last stage a third faster at
        # 100 000 Gaussians.
        results = [np.empty(parameter.shape, np.float32) for parameter in ctx.saved_tensors[:7]]
        grad_2d = np.empty((n, 2) if statistics is not None else (0, 2), np.float32)
        abs_grad_2d = np.empty((n, 2) if want_abs else (0, 2), np.float32)
        outputs = (*(result.reshape(-1) for result in results), NOTHING, grad_2d.reshape(-1), abs_grad_2d.reshape(-1))
        project_backward(
            *parameters,
            rest,
            settings.filter_3d,
            blur,
            settings.degree,
            len(features),
            settings.view,
            records,
            gradients,
            width,
            offsets,
            places,
            outputs,
        )
        if statistics is not None:
            statistics.grad_2d = torch.from_numpy(grad_2d)
            if want_abs:
                statistics.abs_grad_2d = torch.from_numpy(abs_grad_2d)
        *by_parameters, by_blur = (torch.from_numpy(result) for result in results)
        return None, None, by_blur if ctx.needs_input_grad[2] else None, *by_parameters


def _warm_up(**options) -> None:
    """Compile the stages for these options of `rasterize` (geometry, statistics)."""
    parameters = [torch.zeros(shape) for shape in ((8, 3), (8, 3), (8, 4), (8,), (8, 3), (8, 15, 3))]
    camera = Camera(16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4))
    parameters[0][:, 2] = 2.0
    parameters = [parameter.requires_grad_() for parameter in parameters]
    raster = rasterize(*parameters, camera=camera, **options)
    torch.stack([output.sum() for output in raster if output is not None]).sum().backward()


__all__ = ["BACKEND", "rasterize", "rasterize_from_points"]

BACKEND = Backend(
    devices=("cpu",),
    dtypes=("float32",),
    bits_repeat=True,
    warm_up=_warm_up,
    is_warm=lambda: is_compiled(project_backward),
)
