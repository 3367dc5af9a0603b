"""Comparisons shared by groups of cases: the scatter with its formula, the rasteriser with its float64 reference."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.evaluation.stability.case import DOUBLE, Found, Setting
from dofbench.evaluation.stability.deviation import not_finite, off, values
from dofbench.evaluation.stability.oracle import ROUNDINGS, dense_scatter, left_out, sensitivity
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, straight
from dofbench.optics.layered import layered_blur
from dofbench.runtime.raster import Raster

GEOMETRY = "full"

Scene = dict[str, np.ndarray]


def summed(setting: Setting, count: int = HEIGHT * WIDTH) -> float:
    """Relative error bound of a sum of `count` numbers: 16 roundings and half an eps a number."""
    return (ROUNDINGS + count / 2) * setting.eps


def scatter_bound(setting: Setting, image: np.ndarray, radius: np.ndarray, **options: Any) -> tuple[float, str]:
    """The error bound of a scatter, as a share of the brightest pixel, and the condition number as a note.

    Rounding image and radii is an error of half an eps. Each addition rounds once; equal summands give equal signs.
    """
    largest = float(np.abs(image).max())
    kind = np.longdouble if setting.precision == "float64" else np.float64
    exact = partial(dense_scatter, kind=kind, **options)
    moved = sensitivity(exact, (image.astype(kind), radius.astype(kind)), setting.eps / 2) / largest
    beyond = 0.0 if setting.backend == "reference" else left_out(radius, **options)
    bound = 8 * moved + summed(setting, radius.size) + beyond
    return bound, f"condition {2 * moved / setting.eps:.3g}"


def against_formula(
    setting: Setting, image: np.ndarray, radius: np.ndarray, *, energy: str = "area", form: str = "auto", **options: Any
) -> Found:
    """The scatter's error against the formula in long double, as a share of the brightest pixel."""
    image, radius = image.astype(np.float32), radius.astype(np.float32)
    given, area = (setting.tensor(image), setting.tensor(radius)), energy == "area"
    found = setting.kernel("scatter")(*given, energy=energy, form=form, **options)
    kind = np.longdouble if setting.precision == "float64" else np.float64
    bound, note = scatter_bound(setting, image, radius, area=area, **options)
    return Found(off(found, dense_scatter(image, radius, area=area, kind=kind, **options)), bound, note)


def within_the_image(setting: Setting, image: np.ndarray, radius: np.ndarray) -> Found:
    """How far the layered blur leaves the image's range."""
    found = values(layered_blur(setting.tensor(image), setting.tensor(radius), setting.kernel("scatter")))
    if found.shape != image.shape or not_finite(found):
        return Found(math.inf, 0.0, "not finite, or of another size")
    return Found(max(0.0, float(image.min() - found.min()), float(found.max() - image.max())), 64 * setting.eps)


def l1_ssim(setting: Setting, image: Tensor, target: Tensor, edge_weight: float = 0.0) -> Tensor:
    """3DGS' loss, plus `edge_weight` times the error of edges."""
    return setting.kernel("ssim", "l1_ssim")(image, target, ssim_weight=0.2, edge_weight=edge_weight)


def sweep(
    setting: Setting, reference: np.ndarray, source: np.ndarray, shift: tuple[float, float], planes: np.ndarray
) -> np.ndarray:
    """Stereo scores, (H, W, D), of a source, (H, W), shifted by `shift` (x, y) pixels per unit of disparity."""
    maps = np.array([[[1.0, 0, 0, shift[0]], [0, 1, 0, shift[1]], [0, 0, 1, 0]]], np.float32)
    given = (setting.tensor(value) for value in (reference, source[None], maps, planes))
    return values(setting.kernel("stereo")(*given, radius=2, best=1))


def render(setting: Setting, scene: Scene, **options: Any) -> Raster:
    """The raster of a scene, without gradient."""
    given = {name: setting.tensor(value) for name, value in scene.items()}
    with torch.no_grad():
        raster: Raster = setting.kernel("rasterize")(**given, **options)
    return raster


def outputs(raster: Raster, count: int) -> list[torch.Tensor]:
    """The first `count` outputs of a raster. Raises ValueError if one of them is None."""
    found = [output for output in raster[:count] if output is not None]
    if len(found) < count:
        raise ValueError(f"raster: expected {count} outputs, found {len(found)}")
    return found


def against_reference(setting: Setting, scene: Scene, filter_3d: float = 0.0, **options: Any) -> Found:
    """The rendering's error against the float64 reference, each output as a share of its largest magnitude.

    filter_3d: the 3D filter of every Gaussian, scene units.
    """
    options = {"camera": straight(), "geometry": GEOMETRY, **options}
    names, size = tuple(scene), np.full(len(scene["means"]), filter_3d)

    def exact(*parameters: np.ndarray) -> np.ndarray:
        given = dict(zip(names, parameters, strict=True))
        return _stacked(render(DOUBLE, given, filter_3d=DOUBLE.tensor(size), **options))

    given = tuple(scene[name].astype(np.float64) for name in names)
    expected = exact(*given)
    scale = np.maximum(np.abs(expected).max(axis=(0, 1)), 1e-30)

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float((np.abs(a - b) / scale).max())

    moved = sensitivity(exact, given, setting.eps / 2, measure=apart)
    raster = render(setting, scene, filter_3d=setting.tensor(size), **options)
    error = math.inf if not_finite(*outputs(raster, 5)) else apart(_stacked(raster), expected)
    drawn = float((expected[..., 3] > 0).mean())
    note = f"condition {2 * moved / setting.eps:.3g}, drawn {drawn:.0%} of the pixels"
    return Found(error, 8 * moved + 64 * setting.eps, note)


def _stacked(raster: Raster) -> np.ndarray:
    """Colour, alpha, and depth times alpha, (H, W, 5). Depth itself jumps to 0 where alpha vanishes."""
    assert raster.depth is not None
    alpha = values(raster.alpha)
    return np.dstack([values(raster.color), alpha, values(raster.depth) * alpha])
