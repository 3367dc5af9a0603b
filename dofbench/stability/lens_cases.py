"""Extreme lenses: focus, aperture, alpha, invalid depths, and the kinks of the blur's formula."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens
from dofbench.learning.rendered_surface import surface_disparity
from dofbench.optics.defocus import defocus, defocus_by_radius, defocus_numpy
from dofbench.optics.layered import layered_blur
from dofbench.stability.case import (
    KERNELS,
    NUMPY64,
    SINGLE_ON_CPU,
    Case,
    Found,
    Setting,
    differing,
    gradient_at,
    not_finite,
    off,
    refuses,
    values,
)
from dofbench.stability.comparisons import EXACT, NAMED, SCATTERED, against_formula, scatter_bound
from dofbench.stability.oracle import ROUNDINGS, dense_scatter
from dofbench.stability.samples import HEIGHT, WIDTH, disparity, picture, radii, single, straight

FORMULA = "the result is the formula's in a finer precision"


def _formula(name: str, radius: np.ndarray, *, image: np.ndarray | None = None, what: str = "", **options: Any) -> Case:
    light = picture(*radius.shape) if image is None else image
    forms = options.pop("settings", KERNELS)
    return Case(
        "lens",
        name,
        "scatter",
        f"{what or name}: {FORMULA}",
        SCATTERED,
        forms,
        lambda setting: against_formula(setting, light, radius, **options),
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


def _rim_on_pixels(alpha: float) -> Case:
    cycle = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 10.0], np.float32)  # 5 and 10 are also hypot(3, 4) and hypot(6, 8)
    radius = cycle[np.random.default_rng(3).integers(0, len(cycle), (HEIGHT, WIDTH))]
    return _formula(
        f"rim-on-pixels-alpha-{alpha:g}",
        radius,
        alpha=alpha,
        what=f"radii that are exactly the distance to other pixels, alpha {alpha:g}",
    )


def _refused(setting: Setting, value: float) -> Found:
    radius = radii(0.5)
    radius[4, 5] = value
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
    return refuses(FloatingPointError, lambda: setting.kernel("scatter")(image, radius), "signed_radius")


# ---- layers ----


def _layered_plane(setting: Setting, radius: float) -> Found:
    plane, scatter = setting.tensor(np.full((HEIGHT, WIDTH), radius)), setting.kernel("scatter")
    image = setting.tensor(picture())
    return Found(differing(layered_blur(image, plane, scatter), scatter(image, plane)), 0.0)


def _layered_bounded(setting: Setting, radius: np.ndarray) -> Found:
    image = picture()
    found = values(layered_blur(setting.tensor(image), setting.tensor(radius), setting.kernel("scatter")))
    if not_finite(found):
        return Found(np.inf, 0.0, "not finite")
    return Found(max(0.0, float(image.min() - found.min()), float(found.max() - image.max())), 64 * setting.eps)


def _cases() -> tuple[Case, ...]:
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
    kinds = {"0": 0.0, "negative": -2.0, "nan": np.nan, "infinite": np.inf}
    blurred = partial(Case, "lens")
    return (
        *(_formula(name, radii(focus), what=what) for name, (focus, what) in foci.items()),
        blurred(
            "aperture-0",
            "defocus",
            "the sharp image comes back bit for bit, and so does its gradient",
            EXACT,
            SINGLE_ON_CPU,
            _closed,
        ),
        blurred(
            "aperture-0-layered",
            "layered",
            "the sharp image comes back bit for bit",
            EXACT,
            SINGLE_ON_CPU,
            _closed_layered,
        ),
        blurred(
            "aperture-to-0",
            "defocus",
            "radii of 5e-7 pixels leave the image sharp",
            "what the rim's slope makes of such radii, and 16 roundings",
            SINGLE_ON_CPU,
            _nearly_closed,
        ),
        *(_formula(name, radii(0.5, size), what=what) for name, (size, what) in apertures.items()),
        _formula("aperture-huge-beside-sharp", halves, what="radii of 10^4 pixels beside 0"),
        *(
            _formula(f"alpha-{alpha:g}", radii(0.5), alpha=alpha, what=f"an edge of alpha {alpha:g}")
            for alpha in (0.1, 1.0, 4.0, 100.0, 1e3, 1e4)
        ),
        _formula("without-area-term", radii(0.5), energy="algorithm1", what="Algorithm 1 as printed"),
        *(
            blurred(
                f"depth-{name}",
                "defocus",
                f"a depth of {value} counts as infinitely far",
                SCATTERED,
                SINGLE_ON_CPU,
                partial(_unknown_depth, value=value),
            )
            for name, value in kinds.items()
        ),
        blurred(
            "depth-all-equal-in-focus",
            "defocus",
            "a plane exactly in focus stays sharp",
            "16 roundings",
            SINGLE_ON_CPU,
            _plane_in_focus,
        ),
        _formula("depth-all-equal", np.full((HEIGHT, WIDTH), 6.3), what="a plane out of focus"),
        _formula("outlier-near", far_out, what="one pixel 10^6 times nearer than the rest"),
        _formula(
            "outlier-near-linear",
            far_out,
            form="linear",
            settings=SINGLE_ON_CPU[-1:],
            what="one pixel 10^6 times nearer, in the linear form",
        ),
        _formula("outlier-far", away, what="one pixel 10^6 times farther than the rest"),
        *(
            blurred(
                f"outlier-range-{name}",
                "lens",
                f"one pixel {name} by 10^6 leaves the disparity range as it is",
                "two ranks of the percentiles",
                NUMPY64,
                partial(_outlier_range, factor=factor),
            )
            for name, factor in (("near", 1e-6), ("far", 1e6))
        ),
        blurred(
            "range-degenerate",
            "lens",
            "equal, single and unusable depths give a range with an extent, or are refused",
            "0: every one",
            NUMPY64,
            _degenerate_ranges,
        ),
        blurred(
            "units-there-and-back",
            "lens",
            "a lens in scene units and back is the same lens",
            "4 roundings times the condition of taking q_min away",
            NUMPY64,
            _units,
        ),
        blurred(
            "no-gaussians",
            "rasterize",
            "an image without Gaussians is background, without depth, blurred or not",
            EXACT + "; blurred, 32 roundings",
            KERNELS,
            _no_gaussians,
        ),
        blurred(
            "depth-is-focus-sign", "scatter", "as far before the focus as behind it blurs alike", EXACT, KERNELS, _sign
        ),
        blurred(
            "depth-is-focus-continuous",
            "scatter",
            "nothing jumps where depth passes the focus",
            "4 alpha times the step, and 16 roundings",
            KERNELS,
            _through_focus,
        ),
        _rim_on_pixels(4.0),
        _rim_on_pixels(1e4),
        blurred(
            "aperture-1e30",
            "scatter",
            "radii whose squares float32 doesn't hold are refused by name; float64 holds them",
            NAMED + "; in float64 as above",
            KERNELS,
            _overflowing,
        ),
        *(
            blurred(
                f"radius-{name}",
                "scatter",
                f"a radius of {value} is refused by name",
                NAMED,
                KERNELS,
                partial(_refused, value=value),
            )
            for name, value in (("nan", np.nan), ("infinite", np.inf), ("minus-infinite", -np.inf))
        ),
        blurred(
            "radius-nan-layered",
            "layered",
            "a radius of NaN is refused by name",
            NAMED,
            SINGLE_ON_CPU,
            _layered_refused,
        ),
        _formula("polygon-huge-and-sharp", mixed, shape=polygon, what="a triangle of 200 pixels beside sharp pixels"),
        _formula(
            "stop-huge-and-sharp", mixed, shape=stopped, what="a stopped pentagon of 200 pixels beside sharp ones"
        ),
        *(
            blurred(
                f"layered-plane-{radius:g}",
                "layered",
                f"a plane blurred by {radius:g} pixels is the scatter's",
                EXACT,
                SINGLE_ON_CPU,
                partial(_layered_plane, radius=radius),
            )
            for radius in (0.25, 6.3, 1e4)
        ),
        *(
            blurred(
                f"layered-{name}",
                "layered",
                f"{what}: finite, and no lighter or darker than any pixel",
                "64 roundings",
                SINGLE_ON_CPU,
                partial(_layered_bounded, radius=radius),
            )
            for name, what, radius in (
                ("focus-10", "focus ten ranges away", radii(10.0)),
                ("aperture-huge", "radii of 10^4 pixels beside sharp ones", halves),
                ("outlier", "one pixel 10^6 times nearer", far_out),
            )
        ),
    )


CASES = _cases()
