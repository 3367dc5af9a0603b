"""Rasterising 3D Gaussians: colour, opacity, depth and normals of one view, with gradients.

Gaussians are splatted with the EWA projection and Mip-Splatting's two filters; depth and normals follow the current
version of RaDe-GS (docs/published-methods.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import AUTO, implementation
from dofbench.runtime.raster import GEOMETRIES, Geometry, Raster, ViewStatistics

__all__ = ["rasterize", "rasterize_from_points"]

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
MAX_ALPHA = 0.99
MIN_ALPHA = 1 / 255
MIN_TRANSMITTANCE = 1e-4
MIN_DETERMINANT = 1e-6
EDGE_ON = 1e-7


class View(NamedTuple):
    """The arguments of a call that are the same for all Gaussians, and the 3D filter. degree: of harmonics that are
    used. fades: whether the 2D filter lowers opacities. geometry: index in `GEOMETRIES`."""

    camera: Camera
    filter_3d: Tensor | None
    degree: int
    background: Tensor | None
    filter_2d: float
    fades: bool
    geometry: int
    near: float

    def constants(self) -> np.ndarray:
        """(27,) float32: rotation (9) and translation (3) from world to camera, the camera's centre (3), fx, fy, cx,
        cy, width, height, near, filter_2d, and bounds of x / z and of y / z: 15 % of the image beyond its border, where
        the projection's Jacobian is held, as in 3DGS."""
        camera, world_to_camera = self.camera, self.camera.world_to_camera
        margin_x, margin_y = 0.15 * camera.width, 0.15 * camera.height
        numbers = (
            camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, self.near, self.filter_2d,
            (-camera.cx - margin_x) / camera.fx, (camera.width - camera.cx + margin_x) / camera.fx,
            (-camera.cy - margin_y) / camera.fy, (camera.height - camera.cy + margin_y) / camera.fy,
        )  # fmt: skip
        parts = world_to_camera[:3, :3].ravel(), world_to_camera[:3, 3], camera.centre, numbers
        return np.concatenate([np.asarray(part, np.float32) for part in parts])


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
    backend: str = AUTO,
) -> Raster:
    """Render N Gaussians from `camera`; all outputs are differentiable with respect to the first six arguments and
    `blur`.

    means: (N, 3), world, scene units. log_scales: (N, 3), natural logarithm of scene units. quaternions: (N, 4), w
    first, any length; zero means no rotation. opacity_logits: (N,). sh_dc: (N, 3) and sh_rest: (N, K, 3), K = 0, 3, 8
    or 15: spherical harmonics in 3DGS' basis; colour is 1/2 + their sum, clamped at 0 from below. All are contiguous.

    filter_3d: (N,), scene units, or None: Mip-Splatting's 3D filter, added to the scales in quadrature, the opacity
    lowered to match; no gradient. sh_degree: highest degree used (or that of K, if it is lower). background: (3,), None
    for black; no gradient. filter_2d: px**2, added to the footprint's covariance, 0 for none. filter_2d_fades: whether
    that lowers the opacity, as Mip-Splatting's filter does; 3DGS's dilation doesn't. near: scene units; Gaussians whose
    centre isn't farther than this are skipped. statistics: filled in if given.

    blur: (N,), px**2, at least 0, or None: an isotropic variance for each Gaussian, added to its footprint's covariance
    after the 2D filter, while its opacity is multiplied by sqrt(det before / det after). This keeps the Gaussian's
    integral over the image, as if a lens had spread it. Depth and normals are those of the Gaussian without blur, whose
    plane is continued over the wider footprint.

    geometry: "none" gives colour and alpha, "depth" adds depth, "full" adds median depth and normals, "distortion" adds
    the spread of disparity along the ray. These are RaDe-GS': a Gaussian's ray length at a pixel is that of its plane
    of largest density, affine in the pixel, at least `near` (a ray length clamped there has no gradient); ray lengths
    are blended, then converted to z by the pixel's cosine. A Gaussian seen exactly edge-on has no such plane: its ray
    length is that of its centre, its normal zero. The median depth is that of the last Gaussian in front of which the
    transmittance is above one half. In float32 distortion has a relative error of about 1e-4, plus the rounding of
    disparity.

    A Gaussian counts at a pixel where its alpha, at most 0.99, is at least 1/255, and the transmittance in front of it
    is at least 1e-4. A Gaussian whose footprint has a determinant of at most 1e-6 px**4 is skipped: without the 2D
    filter if that lowers opacities, else with it. With blur, the threshold 1/255 is lowered by the same factor as the
    opacity, because otherwise most widely blurred Gaussians would be lost, even where many faint ones overlap.

    On a GPU the host waits once, for the number of places where Gaussians meet tiles. Raises ValueError for arguments
    of the wrong shape, type or range; FloatingPointError, which names the argument and the Gaussian, if a Gaussian in
    front of the camera has a NaN or an infinity.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    view = _view(parameters, camera, filter_3d, sh_degree, background, filter_2d, filter_2d_fades, geometry, near)
    found = _implementation(backend, parameters, filter_3d, background, blur=blur)
    return Raster(*found.rasterize(parameters, blur, view, statistics))


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
    backend: str = AUTO,
) -> Tensor:
    """(P, H, W, 3): N Gaussians as `camera` sees them from P points of its lens, composited over the background.

    points: (P, 2) on the unit lens, x right and y down. radius: (N,), pixels, the signed circle of confusion of each
    Gaussian: from point p its mean lies at its projection + radius * p, while its footprint, opacity and colour are
    those seen from the lens's centre. Differentiable with respect to the first six arguments, blur and radius. The
    other arguments and errors are those of `rasterize`. statistics: of all points together: `visible` is whether it is
    drawn from any of them, gradients are summed over them; the reference has none.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1:] != (2,) or not len(points):
        raise ValueError(f"points: expected shape (P, 2), P at least 1, found {points.shape}")
    view = _view(parameters, camera, filter_3d, sh_degree, background, filter_2d, filter_2d_fades, "none", near)
    found = _implementation(backend, parameters, filter_3d, background, blur=blur, radius=radius)
    images: Tensor = found.rasterize_from_points(parameters, blur, radius, points, view, statistics)
    return images


def _view(
    parameters: tuple[Tensor, ...], camera: Camera, filter_3d: Tensor | None, sh_degree: int,
    background: Tensor | None, filter_2d: float, fades: bool, geometry: str, near: float,
) -> View:  # fmt: skip
    if not 0 <= sh_degree <= 3:
        raise ValueError(f"sh_degree: expected 0, 1, 2 or 3, found {sh_degree}")
    if not filter_2d >= 0:
        raise ValueError(f"filter_2d: expected at least 0, found {filter_2d}")
    if not near > 0:
        raise ValueError(f"near: expected more than 0, found {near}")
    if geometry not in GEOMETRIES:
        raise ValueError(f"geometry: expected one of {', '.join(GEOMETRIES)}, found {geometry!r}")
    rest = parameters[5].shape[1] if parameters[5].ndim == 3 else 0
    degree = min(sh_degree, math.isqrt(rest + 1) - 1)
    level = GEOMETRIES.index(geometry)
    return View(camera, filter_3d, degree, background, filter_2d, bool(fades and filter_2d > 0), level, near)


def _implementation(
    backend: str, parameters: tuple[Tensor, ...], filter_3d: Tensor | None, background: Tensor | None,
    **each: Tensor | None,
):  # fmt: skip
    """The backend for tensors that have the right shapes; each: more that have one number for each Gaussian."""
    n = parameters[0].shape[0] if parameters[0].ndim else 0
    rest = parameters[5].shape[1] if parameters[5].ndim == 3 and parameters[5].shape[1] in (0, 3, 8, 15) else "0|3|8|15"
    shapes = ((n, 3), (n, 3), (n, 4), (n,), (n, 3), (n, rest, 3), (n,), (3,), *[(n,)] * len(each))
    tensors = {**dict(zip(NAMES, parameters, strict=True)), "filter_3d": filter_3d, "background": background, **each}
    for (name, value), shape in zip(tensors.items(), shapes, strict=True):
        if value is None:
            continue
        if tuple(value.shape) != shape:
            raise ValueError(f"{name}: expected shape {shape}, found {tuple(value.shape)}")
        if not value.is_contiguous():
            raise ValueError(f"{name}: expected a contiguous tensor, found strides {value.stride()}")
        if name in ("filter_3d", "background") and value.requires_grad:
            raise ValueError(f"{name}: expected a tensor without gradient, found requires_grad=True")
    return implementation("rasterize", backend, **tensors)


def explain(
    index: int, parameters: tuple[Tensor, ...], filter_3d: Tensor | None, blur: Tensor | None, radius: Tensor | None
) -> Exception:
    """The error that says why Gaussian `index` can't be drawn."""
    if blur is not None and float(blur[index]) < 0:
        return ValueError(f"blur: expected at least 0, found {float(blur[index])}")
    each = zip(("filter_3d", "blur", "radius"), (filter_3d, blur, radius), strict=True)
    for name, values in (*zip(NAMES, parameters, strict=True), *each):
        if values is None or bool(values[index].isfinite().all()):
            continue
        found = values[index].detach().flatten().tolist()
        if values.ndim == 1 and name not in NAMES:
            return FloatingPointError(f"{name}[{index}]: found {found[0]}, expected a finite number")
        return FloatingPointError(f"{name}[{index}]: found {found}, expected finite numbers")
    return FloatingPointError(
        f"Gaussian {index}: its projection overflows float32; mean {parameters[0][index].tolist()}, "
        f"log_scales {parameters[1][index].tolist()}"
    )
