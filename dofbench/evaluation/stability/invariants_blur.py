"""Invariants of blur: constant images, energy, linearity, translation, mirroring, and the common scale of lens and
scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape, PhysicalLens
from dofbench.evaluation.stability.case import COMPILED, KERNELS, SINGLE_ON_CPU, Case, Found, Setting, off, values
from dofbench.evaluation.stability.comparisons import EXACT, scatter_bound, summed
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, disparity, picture, radii
from dofbench.evaluation.stability.subject import Subject
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.layered import layered_blur

SUMMED = "16 roundings and one a pixel that is added up"


def _constant(
    setting: Setting, form: str = "auto", shape: ApertureShape = ApertureShape(), layered: bool = False
) -> Found:
    image = setting.tensor(np.broadcast_to([0.1, 0.5, 0.9], (HEIGHT, WIDTH, 3)))
    blur = partial(setting.kernel("scatter"), form=form, shape=shape)
    radius = setting.tensor(radii(0.5, 25.0))
    found = layered_blur(image, radius, blur) if layered else blur(image, radius)
    return Found(off(found, image), summed(setting) * (8 if layered else 1))


def _bounded(setting: Setting) -> Found:
    image = picture()
    found = values(setting.kernel("scatter")(setting.tensor(image), setting.tensor(radii(0.5))))
    low, high = image.min(axis=(0, 1)), image.max(axis=(0, 1))
    beyond = np.maximum(low - found, found - high).max()
    return Found(max(0.0, float(beyond)), summed(setting))


def _energy(setting: Setting, radius: float) -> Found:
    # A plane with a light at its middle: away from the border the weights of every pixel have the same sum.
    side = 2 * int(radius + 10) + 1
    image = np.zeros((side, side, 3), np.float32)
    image[side // 2, side // 2] = (1.0, 7.0, 1e4)
    wide = np.pad(image, ((side, side), (side, side), (0, 0)))
    plane = setting.tensor(np.full(wide.shape[:2], radius))
    found = values(setting.kernel("scatter")(setting.tensor(wide), plane))
    # The compiled edge ends at a weight of exp(-12): a rim of 2 pi R pixels, 1 / (2 alpha) wide, is missing from pi
    # R^2.
    rim = np.exp(-12.0) * max(1.0, 2 / (8 * radius)) * (setting.backend != "reference")
    return Found(off(found.sum(axis=(0, 1)) / (1.0, 7.0, 1e4), np.ones(3)), summed(setting) + rim)


def _linear(setting: Setting) -> Found:
    scatter, radius = setting.kernel("scatter"), setting.tensor(radii(0.5))
    a, b = setting.tensor(picture()), setting.tensor(picture(seed=1))
    return Found(
        off(scatter(2 * a + 0.5 * b, radius), 2 * scatter(a, radius) + 0.5 * scatter(b, radius)), 2 * summed(setting)
    )


def _lens_and_scene(setting: Setting, factor: float) -> Found:
    depth = (1.0 / (0.2 + 0.3 * disparity())).astype(np.float32)
    lens = PhysicalLens(aperture=35.0, focus_disparity=0.31, width=WIDTH)
    larger = PhysicalLens(aperture=lens.aperture * factor, focus_disparity=lens.focus_disparity / factor, width=WIDTH)
    blur = partial(defocus_numpy, picture(), blur=Blur(gamma=1.0), backend=setting.backend)
    _, expected = blur(depth, lens)
    _, found = blur((depth * np.float32(factor)).astype(np.float32), larger)
    radius = lens.signed_radius(1 / depth.astype(np.float64), WIDTH)
    # The depth is rounded once more, and a radius is proportional to a difference of disparities of at most 0.5.
    bound, note = scatter_bound(setting, picture(), radius)
    bound += 4 * 4.0 * lens.aperture * 0.5 * setting.eps
    return Found(off(found, expected), 0.0 if np.log2(factor) % 1 == 0 else 2 * bound, note)


def _moved(setting: Setting, change: Callable[[np.ndarray], np.ndarray]) -> Found:
    """The scatter of a picture turned or mirrored is the scatter, turned or mirrored."""
    scatter = setting.kernel("scatter")
    image, radius = picture(24, 24), radii(0.5, height=24, width=24)
    expected = change(values(scatter(setting.tensor(image), setting.tensor(radius))))
    found = scatter(setting.tensor(change(image)), setting.tensor(change(radius)))
    return Found(off(found, expected), 2 * summed(setting))


def _shifted(setting: Setting) -> Found:
    scatter, margin = setting.kernel("scatter"), 20
    image, radius = picture(48, 56, seed=2), radii(0.5, 6.0, 48, 56)
    whole = values(scatter(setting.tensor(image), setting.tensor(radius)))
    part = scatter(setting.tensor(image[3:, 5:]), setting.tensor(radius[3:, 5:]))
    inner = (slice(margin, -margin), slice(margin, -margin))
    return Found(
        off(values(part)[inner], whole[3:, 5:][inner]),
        summed(setting) + np.exp(-12.0) * (setting.backend != "reference"),
    )


def _forms(setting: Setting, radius: float) -> Found:
    scatter, image = setting.kernel("scatter"), setting.tensor(picture())
    spread = setting.tensor(radii(0.5, radius))
    bound, note = scatter_bound(setting, picture(), radii(0.5, radius))
    return Found(off(scatter(image, spread, form="linear"), scatter(image, spread, form="direct")), 2 * bound, note)


def _cases() -> tuple[Case, ...]:
    scatter, compiled = (Subject("invariants", "scatter", settings) for settings in (KERNELS, COMPILED))
    layered, defocused = (Subject("invariants", subject, SINGLE_ON_CPU) for subject in ("layered", "defocus"))
    turns: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "mirrored": lambda a: np.ascontiguousarray(a[:, ::-1]),
        "upside-down": lambda a: np.ascontiguousarray(a[::-1]),
        "transposed": lambda a: np.ascontiguousarray(a.swapaxes(0, 1)),
    }
    hexagon = ApertureShape(blades=6, rotation=0.2, obstruction=0.4)
    return (
        scatter.case("constant", "a constant image stays constant", SUMMED, _constant),
        compiled.case(
            "constant-direct",
            "a constant image stays constant, in the direct form",
            SUMMED,
            _constant,
            form="direct",
        ),
        scatter.case(
            "constant-shape",
            "a constant image stays constant through a stopped hexagon",
            SUMMED,
            _constant,
            shape=hexagon,
        ),
        layered.case(
            "constant-layered",
            "a constant image stays constant over eight layers",
            SUMMED + ", of each layer",
            _constant,
            layered=True,
        ),
        scatter.case("bounded", "no pixel gets lighter or darker than all there are", SUMMED, _bounded),
        *scatter.each(
            "energy-{radius:g}",
            "a light on a plane blurred by {radius:g} pixels keeps its energy",
            SUMMED + "; compiled, the rim below exp(-12)",
            _energy,
            radius=(0.5, 3.0, 12.0),
        ),
        scatter.case("linear", "the blur of a sum is the sum of the blurs", SUMMED + ", twice", _linear),
        defocused.case(
            "lens-and-scene-times-4",
            "scene and lens four times as large: the same photograph",
            EXACT,
            _lens_and_scene,
            factor=4.0,
        ),
        defocused.case(
            "lens-and-scene-times-370",
            "scene and lens 370 times as large: the same photograph",
            "rounding depth once more, as the radius and the formula make of it",
            _lens_and_scene,
            factor=370.0,
        ),
        *scatter.each(
            "{change_label}", "a picture {change_label} is blurred likewise", SUMMED + ", twice", _moved, change=turns
        ),
        scatter.case(
            "shifted",
            "shifting the picture shifts the result, away from the borders",
            SUMMED + "; compiled, what lies below exp(-12)",
            _shifted,
        ),
        *compiled.each(
            "forms-{radius:g}",
            "direct and linear form are one, for radii to {radius_label} pixels",
            "twice a form's own bound",
            _forms,
            radius={"1": 2.0, "20": 40.0, "500": 1000.0},
        ),
    )


CASES = _cases()
