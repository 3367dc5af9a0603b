"""Extreme lenses: focus, aperture, alpha, invalid depths, and the kinks of the blur's formula."""

from __future__ import annotations

from typing import Any

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens
from dofbench.evaluation.stability.case import KERNELS, NUMPY64, SINGLE_ON_CPU, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import against_formula, scatter_bound, within_the_image
from dofbench.evaluation.stability.deviation import differing, gradient_at, off, refuses, values
from dofbench.evaluation.stability.lens_surfaces import surfaces
from dofbench.evaluation.stability.oracle import ROUNDINGS, dense_scatter
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, disparity, picture, radii, single, straight
from dofbench.optics.defocus import defocus_by_radius, defocus_numpy, scatter_defocus
from dofbench.optics.layered import layered_blur
from dofbench.training.common.depth import surface_disparity


def _formula(setting: Setting, radius: np.ndarray, **options: Any) -> Found:
    return against_formula(setting, picture(), radius, **options)


# ---- aperture ----


def _closed(setting: Setting) -> Found:
    image = setting.tensor(picture(), gradient=True)
    radius = setting.tensor(radii(0.5, 0.0), gradient=True)
    blurred = scatter_defocus(image, radius, backend=setting.backend)
    blurred.sum().backward()
    return Found(differing(blurred, image) + differing(gradient_at(image), np.ones(image.shape)), 0.0)


def _nearly_closed(setting: Setting) -> Found:
    image = setting.tensor(picture())
    blurred = scatter_defocus(image, setting.tensor(radii(0.5, 1e-6)), backend=setting.backend)
    return Found(off(blurred, image), 2 * 1e-6 * 4.0 + ROUNDINGS * setting.eps)


def _plane_in_focus(setting: Setting) -> Found:
    worst = 0.0
    for z in np.random.default_rng(0).uniform(0.5, 50, 40):
        depth = np.full((HEIGHT, WIDTH), z, np.float32)
        lens = Lens(1.0, 0.5).physical(DisparityRange.of_disparity(1.0 / depth), WIDTH)
        encoded, _ = defocus_numpy(picture(), depth, lens, backend=setting.backend)
        worst = max(worst, off(encoded, picture()))
    return Found(worst, ROUNDINGS * setting.eps, "40 planes")


def _closed_layered(setting: Setting) -> Found:
    encoded, _ = defocus_by_radius(picture(), radii(0.5, 0.0), Blur(renderer="layered"), backend=setting.backend)
    return Found(differing(encoded, picture()), 0.0)


# ---- invalid depths ----


def _unknown_depth(setting: Setting, value: float) -> Found:
    depth = (2.0 + 3.0 * disparity()).astype(np.float32)
    depth[3:7, 4:12], depth[14, 18] = value, value
    lens = PhysicalLens(aperture=40.0, focus_disparity=0.3, width=WIDTH)
    with np.errstate(divide="ignore"):
        far = np.where(np.isfinite(depth) & (depth > 0), 1 / depth.astype(np.float64), 0.0)
    radius = lens.signed_radius(far, WIDTH).astype(np.float32)
    _, linear = defocus_numpy(picture(), depth, lens, blur=Blur(gamma=1.0), backend=setting.backend)
    bound, note = scatter_bound(setting, picture(), radius)
    return Found(off(linear, dense_scatter(picture(), radius, kind=np.float64)), bound, note)


def _outlier_range(setting: Setting, factor: float) -> Found:
    depth = np.random.default_rng(0).uniform(2, 5, (60, 80))
    usual = DisparityRange.of_disparity(1 / depth)
    depth[30, 40] *= factor
    found = DisparityRange.of_disparity(1 / depth)
    # One more pixel above a percentile moves the percentile by at most one rank.
    ordered = np.sort(1 / depth.ravel())
    step = max(float(np.diff(ordered[40:56]).max()), float(np.diff(ordered[-56:-40]).max()))
    moved = max(abs(found.q_min - usual.q_min), abs(found.q_max - usual.q_max))
    return Found(moved / usual.extent, 2 * step / usual.extent)


def _degenerate_ranges(setting: Setting) -> Found:
    wrong = refuses(ValueError, lambda: DisparityRange.of_disparity(np.array([0.0, np.nan, -1.0])), "disparity range")
    ranges = [
        DisparityRange.of_disparity(some)
        for some in (np.full(9, 0.25), np.array([0.25]), np.array([np.nan, np.inf, 0.0, -3.0, 0.25]))
    ]
    right = sum(found.extent > 0 and found.q_min <= 0.25 <= found.q_max for found in ranges)
    return Found(wrong.error + len(ranges) - right, 0.0)


def _units(setting: Setting) -> Found:
    worst = 0.0
    for low, extent in ((0.0, 1.0), (1e-8, 1e-8), (1e6, 1.0), (0.3, 1e-6), (0.0, 1e8)):
        for aperture, focus in ((0.5, 0.2), (1e-6, -3.0), (1e6, 7.0)):
            span = DisparityRange(low, low + extent)
            back = Lens.from_physical(Lens(aperture, focus).physical(span, 504), span)
            # Subtracting q_min again loses as many digits as q_min is larger than the extent.
            condition = 1 + (abs(low) + extent) / span.extent * (1 + 1 / abs(focus))
            worst = max(worst, abs(back.aperture / aperture - 1) / 4, abs(back.focus / focus - 1) / condition)
    return Found(worst, 4 * setting.eps, "error as a share of the condition number")


def _no_gaussians(setting: Setting) -> Found:
    behind = {name: setting.tensor(value) for name, value in single(mean=(0.0, 0.0, -4.0)).items()}
    background = setting.tensor(np.array([0.2, 0.4, 0.6]))
    raster = setting.kernel("rasterize")(**behind, camera=straight(), background=background, geometry="distortion")
    blank = np.broadcast_to(values(background), (*raster.alpha.shape, 3))
    wrong = differing(raster.color, blank) + sum(differing(part, np.zeros(part.shape)) for part in raster[1:])
    far = surface_disparity(raster.depth, raster.alpha)
    blurred = scatter_defocus(raster.color, 10.0 * (far - 0.5), backend=setting.backend)
    return Found(wrong + max(0.0, off(blurred, blank) - 2 * ROUNDINGS * setting.eps), 0.0)


# ---- kinks ----


def _sign(setting: Setting) -> Found:
    scatter, image, radius = setting.kernel("scatter"), setting.tensor(picture()), setting.tensor(radii(0.5))
    return Found(differing(scatter(image, radius), scatter(image, -radius)), 0.0)


def _through_focus(setting: Setting) -> Found:
    scatter, image, small = setting.kernel("scatter"), setting.tensor(picture()), 1e-5
    before, focused, behind = (
        scatter(image, setting.tensor(np.full((HEIGHT, WIDTH), s, np.float32))) for s in (-small, 0.0, small)
    )
    # |dw/dR| <= 2 alpha w: a change of R by 1e-5 moves weights by 2 alpha 1e-5 of themselves, the mean by twice that.
    return Found(max(off(before, focused), off(behind, focused)), 4 * 4.0 * small + ROUNDINGS * setting.eps)


def _distances_of_pixels() -> np.ndarray:
    cycle = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 10.0], np.float32)  # 5 and 10 are also hypot(3, 4) and hypot(6, 8)
    return cycle[np.random.default_rng(3).integers(0, len(cycle), (HEIGHT, WIDTH))]


def _scatter_refused(setting: Setting, radius: np.ndarray) -> Found:
    """A GPU, which the host doesn't wait for to raise an error, reports NaN in the pixel of that radius instead."""

    def scattered() -> np.ndarray:
        return values(setting.kernel("scatter")(setting.tensor(picture()), setting.tensor(radius)))

    if setting.backend != "gpu":
        return refuses(FloatingPointError, scattered, "signed_radius")
    worst = np.unravel_index(int(np.argmax(np.where(np.isnan(radius), np.inf, np.abs(radius)))), radius.shape)
    return Found(float(np.count_nonzero(~np.isnan(scattered()[worst]))), 0.0, "NaN instead of an error")


def _with_radius(value: float) -> np.ndarray:
    radius = radii(0.5)
    radius[4, 5] = value
    return radius


def _refused(setting: Setting, value: float) -> Found:
    return _scatter_refused(setting, _with_radius(value))


def _layered_refused(setting: Setting) -> Found:
    given = setting.tensor(picture()), setting.tensor(_with_radius(np.nan)), setting.kernel("scatter")
    return refuses(FloatingPointError, lambda: layered_blur(*given), "signed_radius")


def _overflowing(setting: Setting) -> Found:
    radius = radii(0.5, 1e30)
    return _formula(setting, radius) if setting.precision == "float64" else _scatter_refused(setting, radius)


# ---- layers ----


def _layered_plane(setting: Setting, radius: float) -> Found:
    plane, scatter = setting.tensor(np.full((HEIGHT, WIDTH), radius)), setting.kernel("scatter")
    image = setting.tensor(picture())
    return Found(differing(layered_blur(image, plane, scatter), scatter(image, plane)), 0.0)


def _layered(setting: Setting, radius: np.ndarray) -> Found:
    return within_the_image(setting, picture(), radius)


def _cases() -> tuple[Case, ...]:
    scatter, linear = (Subject("lens", "scatter", settings) for settings in (KERNELS, SINGLE_ON_CPU[-1:]))
    defocused, layered = (Subject("lens", subject, SINGLE_ON_CPU) for subject in ("defocus", "layered"))
    ranges, rasterize = Subject("lens", "lens", NUMPY64), Subject("lens", "rasterize", KERNELS)
    near, far = radii(0.5).copy(), radii(0.5).copy()
    near[5, 7], far[5, 7] = 1e7, 10.0 * (0.0 - 0.5)
    halves = np.where(disparity() > 0.5, np.float32(1e4), np.float32(0.0))
    mixed = np.where(disparity() > 0.5, np.float32(0.0), np.float32(200.0))
    triangle = ApertureShape(blades=3, rotation=0.3)
    stopped = ApertureShape(blades=5, curvature=0.4, obstruction=0.95)
    foci = {"0": 0.0, "1": 1.0, "beyond-far": -0.5, "beyond-near": 1.5, "ten-ranges-off": 10.0}
    apertures = {"denormal": 1e-38, "ten-images": 320.0, "1e6": 1e6, "1e18": 1e18}
    alphas = (0.1, 1.0, 4.0, 100.0, 1e3, 1e4)
    return (
        *scatter.each("focus-{radius_label}", _formula, radius={name: radii(focus) for name, focus in foci.items()}),
        defocused.case("aperture-0", _closed),
        layered.case("aperture-0-layered", _closed_layered),
        defocused.case("aperture-to-0", _nearly_closed),
        *scatter.each(
            "aperture-{radius_label}", _formula, radius={name: radii(0.5, size) for name, size in apertures.items()}
        ),
        scatter.case("aperture-huge-beside-sharp", _formula, radius=halves),
        *scatter.each("alpha-{alpha:g}", _formula, radius=(radii(0.5),), alpha=alphas),
        scatter.case("without-area-term", _formula, radius=radii(0.5), energy="algorithm1"),
        *defocused.each(
            "depth-{value_label}",
            _unknown_depth,
            value={"0": 0.0, "negative": -2.0, "nan": np.nan, "infinite": np.inf},
        ),
        defocused.case("depth-all-equal-in-focus", _plane_in_focus),
        scatter.case("depth-all-equal", _formula, radius=np.full((HEIGHT, WIDTH), 6.3)),
        scatter.case("outlier-near", _formula, radius=near),
        linear.case("outlier-near-linear", _formula, radius=near, form="linear"),
        scatter.case("outlier-far", _formula, radius=far),
        *ranges.each("outlier-range-{factor_label}", _outlier_range, factor={"near": 1e-6, "far": 1e6}),
        ranges.case("range-degenerate", _degenerate_ranges),
        ranges.case("units-there-and-back", _units),
        rasterize.case("no-gaussians", _no_gaussians),
        *surfaces(),
        scatter.case("depth-is-focus-sign", _sign),
        scatter.case("depth-is-focus-continuous", _through_focus),
        *scatter.each("rim-on-pixels-alpha-{alpha:g}", _formula, radius=(_distances_of_pixels(),), alpha=(4.0, 1e4)),
        scatter.case("aperture-1e30", _overflowing),
        *scatter.each(
            "radius-{value_label}", _refused, value={"nan": np.nan, "infinite": np.inf, "minus-infinite": -np.inf}
        ),
        layered.case("radius-nan-layered", _layered_refused),
        scatter.case("polygon-huge-and-sharp", _formula, radius=mixed, shape=triangle),
        scatter.case("stop-huge-and-sharp", _formula, radius=mixed, shape=stopped),
        *layered.each("layered-plane-{radius:g}", _layered_plane, radius=(0.25, 6.3, 1e4)),
        *layered.each(
            "layered-{radius_label}",
            _layered,
            radius={"focus-10": radii(10.0), "aperture-huge": halves, "outlier": near},
        ),
    )


CASES = _cases()
