"""Extreme lenses: focus, aperture, alpha, invalid depths, and the kinks of the blur's formula."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens
from dofbench.evaluation.stability.case import (
    KERNELS,
    NUMPY64,
    SINGLE_ON_CPU,
    Case,
    Found,
    Setting,
    differing,
    gradient_at,
    off,
    refuses,
    values,
)
from dofbench.evaluation.stability.comparisons import (
    EXACT,
    NAMED,
    SCATTERED,
    against_formula,
    scatter_bound,
    within_the_image,
)
from dofbench.evaluation.stability.lens_surfaces import surfaces
from dofbench.evaluation.stability.oracle import ROUNDINGS, dense_scatter
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, disparity, picture, radii, single, straight
from dofbench.evaluation.stability.subject import Subject
from dofbench.optics.defocus import defocus, defocus_by_radius, defocus_numpy
from dofbench.optics.layered import layered_blur
from dofbench.training.common.depth import surface_disparity

FORMULA = "the result is the formula's in a finer precision"


def _formula(scatter: Subject, name: str, what: str, radius: np.ndarray, **options: Any) -> Case:
    return scatter.case(
        name, f"{what}: {FORMULA}", SCATTERED, against_formula, image=picture(), radius=radius, **options
    )


# ---- aperture ----


def _closed(setting: Setting) -> Found:
    image = setting.tensor(picture(), gradient=True)
    radius = setting.tensor(radii(0.5, 0.0), gradient=True)
    blurred = defocus(image, radius, backend=setting.backend)
    blurred.sum().backward()
    wrong = differing(blurred, image) + differing(gradient_at(image), np.ones(image.shape))
    return Found(wrong, 0.0)


def _nearly_closed(setting: Setting) -> Found:
    image = setting.tensor(picture())
    blurred = defocus(image, setting.tensor(radii(0.5, 1e-6)), backend=setting.backend)
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
    return Found(
        max(abs(found.q_min - usual.q_min), abs(found.q_max - usual.q_max)) / usual.extent, 2 * step / usual.extent
    )


def _degenerate_ranges(setting: Setting) -> Found:
    wrong = 0
    for some in (np.full(9, 0.25), np.array([0.25]), np.array([np.nan, np.inf, 0.0, -3.0, 0.25])):
        found = DisparityRange.of_disparity(some)
        wrong += not (found.extent > 0 and found.q_min <= 0.25 <= found.q_max)
    wrong += int(
        refuses(ValueError, lambda: DisparityRange.of_disparity(np.array([0.0, np.nan, -1.0])), "disparity range").error
    )
    return Found(float(wrong), 0.0)


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
    blurred = defocus(raster.color, 10.0 * (far - 0.5), backend=setting.backend)
    return Found(wrong + max(0.0, off(blurred, blank) - 2 * ROUNDINGS * setting.eps), 0.0)


# ---- kinks ----


def _sign(setting: Setting) -> Found:
    scatter, image, radius = setting.kernel("scatter"), setting.tensor(picture()), setting.tensor(radii(0.5))
    return Found(differing(scatter(image, radius), scatter(image, -radius)), 0.0)


def _through_focus(setting: Setting) -> Found:
    scatter, image = setting.kernel("scatter"), setting.tensor(picture())
    small, steps = 1e-5, []
    for s in (-small, 0.0, small):
        steps.append(scatter(image, setting.tensor(np.full((HEIGHT, WIDTH), s, np.float32))))
    # |dw/dR| <= 2 alpha w: a change of R by 1e-5 moves weights by 2 alpha 1e-5 of themselves, the mean by twice that.
    return Found(max(off(steps[0], steps[1]), off(steps[2], steps[1])), 4 * 4.0 * small + ROUNDINGS * setting.eps)


def _distances_of_pixels() -> np.ndarray:
    cycle = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 10.0], np.float32)  # 5 and 10 are also hypot(3, 4) and hypot(6, 8)
    return cycle[np.random.default_rng(3).integers(0, len(cycle), (HEIGHT, WIDTH))]


def _seen(setting: Setting, radius: np.ndarray) -> Found:
    """On a GPU, which the host doesn't wait for to raise an error, NaN in the pixel of that radius says the same."""
    worst = np.unravel_index(int(np.argmax(np.where(np.isnan(radius), np.inf, np.abs(radius)))), radius.shape)
    found = values(setting.kernel("scatter")(setting.tensor(picture()), setting.tensor(radius)))[worst]
    return Found(float(np.count_nonzero(~np.isnan(found))), 0.0, "NaN instead of an error")


def _refused(setting: Setting, value: float) -> Found:
    radius = radii(0.5)
    radius[4, 5] = value
    if setting.backend == "gpu":
        return _seen(setting, radius)
    return refuses(
        FloatingPointError,
        lambda: setting.kernel("scatter")(setting.tensor(picture()), setting.tensor(radius)),
        "signed_radius",
    )


def _layered_refused(setting: Setting) -> Found:
    radius = radii(0.5)
    radius[4, 5] = np.nan
    scatter = setting.kernel("scatter")
    return refuses(
        FloatingPointError,
        lambda: layered_blur(setting.tensor(picture()), setting.tensor(radius), scatter),
        "signed_radius",
    )


def _overflowing(setting: Setting) -> Found:
    image, radius = setting.tensor(picture()), setting.tensor(radii(0.5, 1e30))
    if setting.precision == "float64":
        return against_formula(setting, picture(), radii(0.5, 1e30))
    if setting.backend == "gpu":
        return _seen(setting, radii(0.5, 1e30))
    return refuses(FloatingPointError, lambda: setting.kernel("scatter")(image, radius), "signed_radius")


# ---- layers ----


def _layered_plane(setting: Setting, radius: float) -> Found:
    plane, scatter = setting.tensor(np.full((HEIGHT, WIDTH), radius)), setting.kernel("scatter")
    image = setting.tensor(picture())
    return Found(differing(layered_blur(image, plane, scatter), scatter(image, plane)), 0.0)


def _cases() -> tuple[Case, ...]:
    scatter, linear = (Subject("lens", "scatter", settings) for settings in (KERNELS, SINGLE_ON_CPU[-1:]))
    defocused, layered = (Subject("lens", subject, SINGLE_ON_CPU) for subject in ("defocus", "layered"))
    ranges, rasterize = Subject("lens", "lens", NUMPY64), Subject("lens", "rasterize", KERNELS)
    formula = partial(_formula, scatter)
    far_out = radii(0.5).copy()
    far_out[5, 7] = 1e7
    away = radii(0.5).copy()
    away[5, 7] = 10.0 * (0.0 - 0.5)
    foci = {
        "focus-0": (0.0, "focus at the far end"),
        "focus-1": (1.0, "focus at the near end"),
        "focus-beyond-far": (-0.5, "focus beyond the far end"),
        "focus-beyond-near": (1.5, "focus before the near end"),
        "focus-ten-ranges-off": (10.0, "focus ten ranges away, nothing near focus"),
    }
    apertures = {
        "aperture-denormal": (1e-38, "radii of 1e-38 pixels"),
        "aperture-ten-images": (320.0, "radii of ten images"),
        "aperture-1e6": (1e6, "radii of 10^6 pixels"),
        "aperture-1e18": (1e18, "radii of 10^18 pixels"),
    }
    halves = np.where(disparity() > 0.5, np.float32(1e4), np.float32(0.0))
    polygon = ApertureShape(blades=3, rotation=0.3)
    stopped = ApertureShape(blades=5, curvature=0.4, obstruction=0.95)
    mixed = np.where(disparity() > 0.5, np.float32(0.0), np.float32(200.0))
    bounded = {
        "focus-10": (radii(10.0), "focus ten ranges away"),
        "aperture-huge": (halves, "radii of 10^4 pixels beside sharp ones"),
        "outlier": (far_out, "one pixel 10^6 times nearer"),
    }
    return (
        *(formula(name, what, radii(focus)) for name, (focus, what) in foci.items()),
        defocused.case(
            "aperture-0", "the sharp image comes back bit for bit, and so does its gradient", EXACT, _closed
        ),
        layered.case("aperture-0-layered", "the sharp image comes back bit for bit", EXACT, _closed_layered),
        defocused.case(
            "aperture-to-0",
            "radii of 5e-7 pixels leave the image sharp",
            "what the rim's slope makes of such radii, and 16 roundings",
            _nearly_closed,
        ),
        *(formula(name, what, radii(0.5, size)) for name, (size, what) in apertures.items()),
        formula("aperture-huge-beside-sharp", "radii of 10^4 pixels beside 0", halves),
        *(
            formula(f"alpha-{alpha:g}", f"an edge of alpha {alpha:g}", radii(0.5), alpha=alpha)
            for alpha in (0.1, 1.0, 4.0, 100.0, 1e3, 1e4)
        ),
        formula("without-area-term", "Algorithm 1 as printed", radii(0.5), energy="algorithm1"),
        *defocused.each(
            "depth-{value_label}",
            "a depth of {value} counts as infinitely far",
            SCATTERED,
            _unknown_depth,
            value={"0": 0.0, "negative": -2.0, "nan": np.nan, "infinite": np.inf},
        ),
        defocused.case(
            "depth-all-equal-in-focus", "a plane exactly in focus stays sharp", "16 roundings", _plane_in_focus
        ),
        formula("depth-all-equal", "a plane out of focus", np.full((HEIGHT, WIDTH), 6.3)),
        formula("outlier-near", "one pixel 10^6 times nearer than the rest", far_out),
        _formula(
            linear, "outlier-near-linear", "one pixel 10^6 times nearer, in the linear form", far_out, form="linear"
        ),
        formula("outlier-far", "one pixel 10^6 times farther than the rest", away),
        *ranges.each(
            "outlier-range-{factor_label}",
            "one pixel {factor_label} by 10^6 leaves the disparity range as it is",
            "two ranks of the percentiles",
            _outlier_range,
            factor={"near": 1e-6, "far": 1e6},
        ),
        ranges.case(
            "range-degenerate",
            "equal, single and unusable depths give a range with an extent, or are refused",
            "0: every one",
            _degenerate_ranges,
        ),
        ranges.case(
            "units-there-and-back",
            "a lens in scene units and back is the same lens",
            "4 roundings times the condition of taking q_min away",
            _units,
        ),
        rasterize.case(
            "no-gaussians",
            "an image without Gaussians is background, without depth, blurred or not",
            EXACT + "; blurred, 32 roundings",
            _no_gaussians,
        ),
        *surfaces(),
        scatter.case("depth-is-focus-sign", "as far before the focus as behind it blurs alike", EXACT, _sign),
        scatter.case(
            "depth-is-focus-continuous",
            "nothing jumps where depth passes the focus",
            "4 alpha times the step, and 16 roundings",
            _through_focus,
        ),
        *(
            formula(
                f"rim-on-pixels-alpha-{alpha:g}",
                f"radii that are exactly the distance to other pixels, alpha {alpha:g}",
                _distances_of_pixels(),
                alpha=alpha,
            )
            for alpha in (4.0, 1e4)
        ),
        scatter.case(
            "aperture-1e30",
            "radii whose squares float32 doesn't hold are refused by name; float64 holds them",
            NAMED + "; in float64 as above",
            _overflowing,
        ),
        *scatter.each(
            "radius-{value_label}",
            "a radius of {value} is refused by name",
            NAMED,
            _refused,
            value={"nan": np.nan, "infinite": np.inf, "minus-infinite": -np.inf},
        ),
        layered.case("radius-nan-layered", "a radius of NaN is refused by name", NAMED, _layered_refused),
        formula("polygon-huge-and-sharp", "a triangle of 200 pixels beside sharp pixels", mixed, shape=polygon),
        formula("stop-huge-and-sharp", "a stopped pentagon of 200 pixels beside sharp ones", mixed, shape=stopped),
        *layered.each(
            "layered-plane-{radius:g}",
            "a plane blurred by {radius:g} pixels is the scatter's",
            EXACT,
            _layered_plane,
            radius=(0.25, 6.3, 1e4),
        ),
        *(
            layered.case(
                f"layered-{name}",
                f"{what}: finite, and no lighter or darker than any pixel",
                "64 roundings",
                within_the_image,
                image=picture(),
                radius=radius,
            )
            for name, (radius, what) in bounded.items()
        ),
    )


CASES = _cases()
