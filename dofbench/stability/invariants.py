"""What must stay as it is: constants, energy, order, scale, place, mirror images; of the lens and of the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from dofbench.cameras import Camera
from dofbench.defocus import defocus_numpy
from dofbench.layered import layered_blur
from dofbench.lens import ApertureShape, PhysicalLens
from dofbench.stability.case import (
    COMPILED,
    KERNELS,
    SINGLE_ON_CPU,
    Case,
    Found,
    Setting,
    differing,
    off,
    values,
)
from dofbench.stability.comparisons import EXACT, scatter_bound
from dofbench.stability.oracle import ROUNDINGS
from dofbench.stability.samples import (
    HEIGHT,
    WIDTH,
    camera,
    disparity,
    gaussians,
    picture,
    radii,
    single,
    straight,
    together,
)

SUMMED = "16 roundings and one a pixel that is added up"


def _summed(setting: Setting) -> float:
    return (ROUNDINGS + HEIGHT * WIDTH / 2) * setting.eps


# ---- scatter ----


def _constant(
    setting: Setting, form: str = "auto", shape: ApertureShape = ApertureShape(), layered: bool = False
) -> Found:
    image = setting.tensor(np.broadcast_to([0.1, 0.5, 0.9], (HEIGHT, WIDTH, 3)))
    blur = partial(setting.kernel("scatter"), form=form, shape=shape)
    radius = setting.tensor(radii(0.5, 25.0))
    found = layered_blur(image, radius, blur) if layered else blur(image, radius)
    return Found(off(found, image), _summed(setting) * (8 if layered else 1))


def _bounded(setting: Setting) -> Found:
    image = picture()
    found = values(setting.kernel("scatter")(setting.tensor(image), setting.tensor(radii(0.5))))
    low, high = image.min(axis=(0, 1)), image.max(axis=(0, 1))
    beyond = np.maximum(low - found, found - high).max()
    return Found(max(0.0, float(beyond)), _summed(setting))


def _energy(setting: Setting, radius: float) -> Found:
    # A plane, a light at its middle: away from the border every pixel's weights add up to the same.
    side = 2 * int(radius + 10) + 1
    image = np.zeros((side, side, 3), np.float32)
    image[side // 2, side // 2] = (1.0, 7.0, 1e4)
    wide = np.pad(image, ((side, side), (side, side), (0, 0)))
    plane = setting.tensor(np.full(wide.shape[:2], radius))
    found = values(setting.kernel("scatter")(setting.tensor(wide), plane))
    # The compiled edge ends at exp(-12): a rim of 2 pi R pixels, 1 / (2 alpha) wide, on pi R^2.
    rim = np.exp(-12.0) * max(1.0, 2 / (8 * radius)) * (setting.backend != "reference")
    return Found(off(found.sum(axis=(0, 1)) / (1.0, 7.0, 1e4), np.ones(3)), _summed(setting) + rim)


def _linear(setting: Setting) -> Found:
    scatter, radius = setting.kernel("scatter"), setting.tensor(radii(0.5))
    a, b = setting.tensor(picture()), setting.tensor(picture(seed=1))
    return Found(
        off(scatter(2 * a + 0.5 * b, radius), 2 * scatter(a, radius) + 0.5 * scatter(b, radius)), 2 * _summed(setting)
    )


def _lens_and_scene(setting: Setting, factor: float) -> Found:
    depth = (1.0 / (0.2 + 0.3 * disparity())).astype(np.float32)
    lens = PhysicalLens(aperture=35.0, focus_disparity=0.31, width=WIDTH)
    larger = PhysicalLens(aperture=lens.aperture * factor, focus_disparity=lens.focus_disparity / factor, width=WIDTH)
    blur = partial(defocus_numpy, picture(), gamma=1.0, backend=setting.backend)
    _, expected = blur(depth, lens)
    _, found = blur((depth * np.float32(factor)).astype(np.float32), larger)
    radius = lens.signed_radius(1 / depth.astype(np.float64), WIDTH)
    # The depth is rounded once more; a radius is a difference of disparities, of at most 0.5.
    bound, note = scatter_bound(setting, picture(), radius)
    bound += 4 * 4.0 * lens.aperture * 0.5 * setting.eps
    return Found(off(found, expected), 0.0 if np.log2(factor) % 1 == 0 else 2 * bound, note)


def _moved(setting: Setting, change: Callable[[np.ndarray], np.ndarray]) -> Found:
    """The scatter of a picture turned or mirrored is the scatter, turned or mirrored."""
    scatter = setting.kernel("scatter")
    image, radius = picture(24, 24), radii(0.5, height=24, width=24)
    expected = change(values(scatter(setting.tensor(image), setting.tensor(radius))))
    found = scatter(setting.tensor(change(image)), setting.tensor(change(radius)))
    return Found(off(found, expected), 2 * _summed(setting))


def _shifted(setting: Setting) -> Found:
    scatter, margin = setting.kernel("scatter"), 20
    image, radius = picture(48, 56, seed=2), radii(0.5, 6.0, 48, 56)
    whole = values(scatter(setting.tensor(image), setting.tensor(radius)))
    part = scatter(setting.tensor(image[3:, 5:]), setting.tensor(radius[3:, 5:]))
    inner = (slice(margin, -margin), slice(margin, -margin))
    return Found(
        off(values(part)[inner], whole[3:, 5:][inner]),
        _summed(setting) + np.exp(-12.0) * (setting.backend != "reference"),
    )


def _forms(setting: Setting, radius: float) -> Found:
    scatter, image = setting.kernel("scatter"), setting.tensor(picture())
    spread = setting.tensor(radii(0.5, radius))
    bound, note = scatter_bound(setting, picture(), radii(0.5, radius))
    return Found(off(scatter(image, spread, form="linear"), scatter(image, spread, form="direct")), 2 * bound, note)


# ---- rasteriser ----


def _render(setting: Setting, scene: dict[str, np.ndarray], view: Camera, **options):
    return setting.kernel("rasterize")(
        **{name: setting.tensor(value) for name, value in scene.items()}, camera=view, **options
    )


def _permuted(scene: dict[str, np.ndarray], order: np.ndarray) -> dict[str, np.ndarray]:
    return {name: value[order] for name, value in scene.items()}


def _order(setting: Setting) -> Found:
    scene = gaussians()
    plain = _render(setting, scene, camera(), geometry="full")
    found = _render(setting, _permuted(scene, np.random.default_rng(0).permutation(40)), camera(), geometry="full")
    if setting.backend == "reference":  # torch's vector instructions round the last few of a batch otherwise
        return Found(max(off(a, b) for a, b in zip(found[:5], plain[:5], strict=True)), 64 * setting.eps)
    return Found(sum(differing(a, b) for a, b in zip(found[:5], plain[:5], strict=True)), 0.0)


def _coplanar() -> dict[str, np.ndarray]:
    colours = ((1.0, 0.1, 0.1), (0.1, 1.0, 0.1), (0.1, 0.1, 1.0))
    return together(
        *(single(mean=(0.05 * k, 0.0, 4.0), scale=0.3, logit=1.0, colour=colour) for k, colour in enumerate(colours))
    )


def _equal_depth_index(setting: Setting) -> Found:
    # Nearest first means first stored first: nudging the later ones back by an ulp of depth must change nothing.
    scene = _coplanar()
    nudged = {name: value.copy() for name, value in scene.items()}
    for k in (1, 2):
        nudged["means"][k, 2] = np.nextafter(nudged["means"][k - 1, 2], np.float32(9))
    return Found(
        off(_render(setting, scene, straight()).color, _render(setting, nudged, straight()).color),
        64 * float(np.finfo(np.float32).eps),
    )


def _equal_depth_any(setting: Setting) -> Found:
    scene = _coplanar()
    found = _render(setting, _permuted(scene, np.array([2, 0, 1])), straight()).color
    return Found(off(found, _render(setting, scene, straight()).color), 64 * setting.eps)


def _tiles(setting: Setting) -> Found:
    # A window of the view, whose tiles begin elsewhere; the Jacobian is held at other places, so all stay inside.
    scene, view = gaussians(60, log_scale=-2.5), straight(70, 50)
    whole = _render(setting, scene, view, geometry="full")
    top, left, height, width = 7, 5, 36, 53
    window = replace(view, width=width, height=height, cx=view.cx - left, cy=view.cy - top)
    part = _render(setting, scene, window, geometry="full")
    area = (slice(top, top + height), slice(left, left + width))
    error = max(off(a, b[area]) for a, b in zip(part[:5], whole[:5], strict=True))
    # Offsets from a pixel lose what its coordinate is larger; their square counts, times up to 2 log 255.
    return Found(error, 70 * 16 * setting.eps)


def _scaled_scene(setting: Setting, factor: float) -> Found:
    scene, view = gaussians(), camera()
    larger = {name: value.copy() for name, value in scene.items()}
    larger["means"] = (larger["means"].astype(np.float64) * factor).astype(np.float32)
    larger["log_scales"] = (larger["log_scales"] + np.log(factor)).astype(np.float32)
    pose = view.world_to_camera.copy()
    pose[:3, 3] *= factor
    plain = _render(setting, scene, view, geometry="depth")
    found = _render(setting, larger, replace(view, world_to_camera=pose), geometry="depth", near=0.2 * factor)
    # log_scales of size log(factor) are rounded to float32 and exponentiated: that is their relative error.
    eps = float(np.finfo(np.float32).eps)
    bound = 64 * (abs(np.log(factor)) + 8) * eps
    return Found(
        max(
            off(found.color, plain.color), off(found.alpha, plain.alpha), off(values(found.depth) / factor, plain.depth)
        ),
        bound,
    )


def _layers_of_one_colour(setting: Setting) -> Found:
    scene, background = gaussians(), np.array([0.3, 0.6, 0.1])
    scene["sh_rest"] = np.zeros((40, 0, 3), np.float32)
    scene["sh_dc"] = np.broadcast_to(((background - 0.5) * 2 * np.sqrt(np.pi)), (40, 3)).astype(np.float32)
    found = _render(setting, scene, camera(), background=setting.tensor(background))
    return Found(
        off(found.color, np.broadcast_to(background, found.color.shape)),
        (40 + ROUNDINGS) * float(np.finfo(np.float32).eps),
    )


# ---- the others ----


def _same_image(setting: Setting, value: np.ndarray) -> Found:
    image = setting.tensor(value)
    loss = setting.kernel("ssim", "l1_ssim")(image, image, ssim_weight=0.2)
    likeness = setting.kernel("ssim")(image, image)
    return Found(max(abs(float(loss)), abs(float(likeness) - 1)), ROUNDINGS * setting.eps)


def _symmetric(setting: Setting) -> Found:
    a, b, ssim = setting.tensor(picture()), setting.tensor(picture(seed=1)), setting.kernel("ssim")
    # Variances are differences of numbers near 1/4, here of 0.07 to 0.08: one digit less, in sums of 121.
    return Found(abs(float(ssim(a, b)) - float(ssim(b, a))), 8 * ROUNDINGS * setting.eps)


def _channels(setting: Setting) -> Found:
    a, b, ssim = picture(), picture(seed=1), setting.kernel("ssim")
    apart = [float(ssim(setting.tensor(a[..., k : k + 1]), setting.tensor(b[..., k : k + 1]))) for k in range(3)]
    return Found(
        abs(float(ssim(setting.tensor(a), setting.tensor(b))) - float(np.mean(apart))), 8 * ROUNDINGS * setting.eps
    )


def _sweep(setting: Setting, reference: np.ndarray, source: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Scores (H, W, D) of a source shifted by the disparity."""
    maps = np.array([[[1.0, 0, 0, -1.0], [0, 1, 0, 0], [0, 0, 1, 0]]])
    return values(
        setting.kernel("stereo")(
            setting.tensor(reference),
            setting.tensor(source[None]),
            setting.tensor(maps),
            setting.tensor(planes),
            radius=2,
            best=1,
        )
    )


def _brightness(setting: Setting) -> Found:
    grey = picture()[..., 0] * 0.5 + 0.2
    planes = np.array([0.0, 1.0, 2.0])
    plain, found = (_sweep(setting, grey, other, planes) for other in (grey, 0.7 * grey + 0.05))
    # The floor of 2e-5 on variances of 0.02 counts once more where one of them is half as large; that is no rounding.
    return Found(off(found, plain, 1.0), 2e-5 / (0.49 * 0.005) + 64 * setting.eps / 0.005)


def _correlation(setting: Setting) -> Found:
    grey = picture(40, 48)[..., 0]
    scores = _sweep(setting, grey, np.roll(grey, -3, axis=1), np.array([0.0, 3.0, 5.0]))
    beyond = max(0.0, float(np.abs(scores).max()) - 1)
    missed = float(np.count_nonzero(scores[6:-6, 6:-6].argmax(axis=2) != 1))
    return Found(missed + beyond, 64 * setting.eps / 0.005, f"{missed:.0f} pixels at another plane")


def _cases() -> tuple[Case, ...]:
    rule = partial(Case, "invariants")
    turns: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "mirrored": lambda a: np.ascontiguousarray(a[:, ::-1]),
        "upside-down": lambda a: np.ascontiguousarray(a[::-1]),
        "transposed": lambda a: np.ascontiguousarray(a.swapaxes(0, 1)),
    }
    hexagon = ApertureShape(blades=6, rotation=0.2, obstruction=0.4)
    return (
        rule("constant", "scatter", "a constant image stays constant", SUMMED, KERNELS, _constant),
        rule(
            "constant-direct",
            "scatter",
            "a constant image stays constant, in the direct form",
            SUMMED,
            COMPILED,
            partial(_constant, form="direct"),
        ),
        rule(
            "constant-shape",
            "scatter",
            "a constant image stays constant through a stopped hexagon",
            SUMMED,
            KERNELS,
            partial(_constant, shape=hexagon),
        ),
        rule(
            "constant-layered",
            "layered",
            "a constant image stays constant over eight layers",
            SUMMED + ", of each layer",
            SINGLE_ON_CPU,
            partial(_constant, layered=True),
        ),
        rule("bounded", "scatter", "no pixel gets lighter or darker than all there are", SUMMED, KERNELS, _bounded),
        *(
            rule(
                f"energy-{radius:g}",
                "scatter",
                f"a light on a plane blurred by {radius:g} pixels keeps its energy",
                SUMMED + "; compiled, the rim below exp(-12)",
                KERNELS,
                partial(_energy, radius=radius),
            )
            for radius in (0.5, 3.0, 12.0)
        ),
        rule("linear", "scatter", "the blur of a sum is the sum of the blurs", SUMMED + ", twice", KERNELS, _linear),
        rule(
            "lens-and-scene-times-4",
            "defocus",
            "scene and lens four times as large: the same photograph",
            EXACT,
            SINGLE_ON_CPU,
            partial(_lens_and_scene, factor=4.0),
        ),
        rule(
            "lens-and-scene-times-370",
            "defocus",
            "scene and lens 370 times as large: the same photograph",
            "rounding depth once more, as the radius and the formula make of it",
            SINGLE_ON_CPU,
            partial(_lens_and_scene, factor=370.0),
        ),
        *(
            rule(
                name,
                "scatter",
                f"a picture {name} is blurred likewise",
                SUMMED + ", twice",
                KERNELS,
                partial(_moved, change=change),
            )
            for name, change in turns.items()
        ),
        rule(
            "shifted",
            "scatter",
            "shifting the picture shifts the result, away from the borders",
            SUMMED + "; compiled, what lies below exp(-12)",
            KERNELS,
            _shifted,
        ),
        *(
            rule(
                f"forms-{radius:g}",
                "scatter",
                f"direct and linear form are one, for radii to {radius / 2:g} pixels",
                "twice a form's own bound",
                COMPILED,
                partial(_forms, radius=radius),
            )
            for radius in (2.0, 40.0, 1000.0)
        ),
        rule(
            "order",
            "rasterize",
            "the order that Gaussians are stored in doesn't matter",
            EXACT + "; by torch, 64 roundings",
            KERNELS,
            _order,
        ),
        rule(
            "order-at-equal-depth-is-stored",
            "rasterize",
            "at equal depth what is stored first is in front",
            "64 roundings of float32: a nudge by the last digit",
            KERNELS,
            _equal_depth_index,
        ),
        rule(
            "order-at-equal-depth",
            "rasterize",
            "at equal depth the stored order doesn't matter",
            "64 roundings",
            KERNELS,
            _equal_depth_any,
        ),
        rule(
            "tiles",
            "rasterize",
            "a window of the view is rendered as the whole, wherever its tiles begin",
            "what pixel coordinates of 70 lose, times twice the largest exponent",
            KERNELS,
            _tiles,
        ),
        *(
            rule(
                f"scene-times-{factor:g}",
                "rasterize",
                f"everything {factor:g} times as large looks the same",
                "what float32 keeps of the logarithms of the scales, 64 times",
                KERNELS,
                partial(_scaled_scene, factor=factor),
            )
            for factor in (4.0, 1e3, 1e-3)
        ),
        rule(
            "one-colour",
            "rasterize",
            "Gaussians of the background's colour can't be seen",
            "one rounding of float32 a Gaussian, and 16",
            KERNELS,
            _layers_of_one_colour,
        ),
        *(
            rule(
                f"ssim-of-itself-{name}",
                "ssim",
                f"an image is like itself: {name}",
                "16 roundings",
                KERNELS,
                partial(_same_image, value=value),
            )
            for name, value in (("textured", picture()), ("black", np.zeros((24, 32, 3))), ("bright", 1e3 * picture()))
        ),
        rule(
            "ssim-symmetric",
            "ssim",
            "which image comes first doesn't matter",
            "128 roundings: variances are differences of sums",
            KERNELS,
            _symmetric,
        ),
        rule("ssim-channels", "ssim", "three channels are the mean of each", "128 roundings", KERNELS, _channels),
        rule(
            "stereo-brightness",
            "stereo",
            "another exposure matches as well",
            "the variances' floor, and their rounding",
            tuple(s for s in KERNELS if s.device == "cpu"),
            _brightness,
        ),
        rule(
            "stereo-shift",
            "stereo",
            "scores lie in -1 ... 1, and are best at the true plane",
            "rounding of a variance of 0.005",
            tuple(s for s in KERNELS if s.device == "cpu"),
            _correlation,
        ),
    )


CASES = _cases()
