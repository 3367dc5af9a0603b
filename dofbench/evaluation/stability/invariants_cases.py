"""Invariants of blur, rasterisation and image similarity: what a symmetry or a conserved quantity implies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape, PhysicalLens
from dofbench.evaluation.stability.case import COMPILED, KERNELS, SINGLE_ON_CPU, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import Scene, l1_ssim, outputs, render, scatter_bound, summed, sweep
from dofbench.evaluation.stability.deviation import differing, off, values
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import (
    HEIGHT,
    WIDTH,
    camera,
    disparity,
    gaussians,
    harmonic,
    picture,
    radii,
    single,
    straight,
    together,
)
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.layered import layered_blur

EPS = float(np.finfo(np.float32).eps)
BY_ONE = (-1.0, 0.0)  # shift of a stereo source, pixels per unit of disparity

# ---- blur ----


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
    # A light in the middle of a plane: away from the border the weights of every pixel have the same sum.
    side = 2 * int(radius + 10) + 1
    image = np.zeros((side, side, 3), np.float32)
    image[side // 2, side // 2] = (1.0, 7.0, 1e4)
    wide = np.pad(image, ((side, side), (side, side), (0, 0)))
    plane = setting.tensor(np.full(wide.shape[:2], radius))
    found = values(setting.kernel("scatter")(setting.tensor(wide), plane))
    # The compiled edge ends at a weight of exp(-12): a rim of 2 pi R pixels, 1 / (2 alpha) wide, of pi R^2.
    rim = np.exp(-12.0) * max(1.0, 2 / (8 * radius)) * (setting.backend != "reference")
    return Found(off(found.sum(axis=(0, 1)) / (1.0, 7.0, 1e4), np.ones(3)), summed(setting) + rim)


def _linear(setting: Setting) -> Found:
    scatter, radius = setting.kernel("scatter"), setting.tensor(radii(0.5))
    a, b = setting.tensor(picture()), setting.tensor(picture(seed=1))
    parts = 2 * scatter(a, radius) + 0.5 * scatter(b, radius)
    return Found(off(scatter(2 * a + 0.5 * b, radius), parts), 2 * summed(setting))


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
    """Blurring commutes with mirroring and transposing."""
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
    bound = summed(setting) + np.exp(-12.0) * (setting.backend != "reference")
    return Found(off(values(part)[inner], whole[3:, 5:][inner]), bound)


def _forms(setting: Setting, radius: float) -> Found:
    scatter, image = setting.kernel("scatter"), setting.tensor(picture())
    spread = setting.tensor(radii(0.5, radius))
    bound, note = scatter_bound(setting, picture(), radii(0.5, radius))
    return Found(off(scatter(image, spread, form="linear"), scatter(image, spread, form="direct")), 2 * bound, note)


# ---- rasterisation ----


def _permuted(scene: Scene, order: np.ndarray) -> Scene:
    return {name: value[order] for name, value in scene.items()}


def _order(setting: Setting) -> Found:
    scene = gaussians()
    shuffled = _permuted(scene, np.random.default_rng(0).permutation(40))
    found, plain = (outputs(render(setting, one, camera=camera(), geometry="full"), 5) for one in (shuffled, scene))
    if setting.backend == "reference":  # torch's vector instructions round the last elements of a batch differently
        return Found(max(map(off, found, plain)), 64 * setting.eps)
    return Found(sum(map(differing, found, plain)), 0.0)


def _coplanar() -> Scene:
    colours = ((1.0, 0.1, 0.1), (0.1, 1.0, 0.1), (0.1, 0.1, 1.0))
    layers = [single(mean=(0.05 * k, 0.0, 4.0), scale=0.3, logit=1.0, colour=c) for k, c in enumerate(colours)]
    return together(*layers)


def _equal_depth_index(setting: Setting) -> Found:
    # Equal depths are blended in stored order, so moving later Gaussians back by an ulp must change nothing.
    scene = _coplanar()
    nudged = {name: value.copy() for name, value in scene.items()}
    for k in (1, 2):
        nudged["means"][k, 2] = np.nextafter(nudged["means"][k - 1, 2], np.float32(9))
    plain, moved = (render(setting, one, camera=straight()).color for one in (scene, nudged))
    return Found(off(plain, moved), 64 * EPS)


def _equal_depth_any(setting: Setting) -> Found:
    scene = _coplanar()
    found = render(setting, _permuted(scene, np.array([2, 0, 1])), camera=straight()).color
    return Found(off(found, render(setting, scene, camera=straight()).color), 64 * setting.eps)


def _tiles(setting: Setting) -> Found:
    # The Jacobian is clamped relative to the window, so all Gaussians are inside it.
    scene, view = gaussians(60, log_scale=-2.5), straight(70, 50)
    whole = render(setting, scene, camera=view, geometry="full")
    top, left, height, width = 7, 5, 36, 53
    window = replace(view, width=width, height=height, cx=view.cx - left, cy=view.cy - top)
    part = render(setting, scene, camera=window, geometry="full")
    area = (slice(top, top + height), slice(left, left + width))
    error = max(off(a, b[area]) for a, b in zip(outputs(part, 5), outputs(whole, 5), strict=True))
    # An offset from a pixel loses as many digits as the coordinate is larger; its square counts, times 2 log 255.
    return Found(error, 70 * 16 * setting.eps)


def _scaled_scene(setting: Setting, factor: float) -> Found:
    scene, view = gaussians(), camera()
    larger = {name: value.copy() for name, value in scene.items()}
    larger["means"] = (larger["means"].astype(np.float64) * factor).astype(np.float32)
    larger["log_scales"] = (larger["log_scales"] + np.log(factor)).astype(np.float32)
    pose = view.world_to_camera.copy()
    pose[:3, 3] *= factor
    plain = render(setting, scene, camera=view, geometry="depth")
    found = render(setting, larger, camera=replace(view, world_to_camera=pose), geometry="depth", near=0.2 * factor)
    # Rounding log_scales of size log(factor) to float32 is this relative error of the scales.
    bound = 64 * (abs(np.log(factor)) + 8) * EPS
    (color, alpha, depth), (plain_color, plain_alpha, plain_depth) = outputs(found, 3), outputs(plain, 3)
    return Found(max(off(color, plain_color), off(alpha, plain_alpha), off(values(depth) / factor, plain_depth)), bound)


def _closed_lens(setting: Setting) -> Found:
    scene, view = gaussians(), camera()
    given = {name: setting.tensor(value) for name, value in scene.items()}
    still = setting.tensor(np.zeros(40, np.float32))
    points = np.array([[0.0, 0.6], [0.5, -0.3]])
    with torch.no_grad():
        found = setting.kernel("rasterize", "rasterize_from_points")(**given, camera=view, points=points, radius=still)
    plain = render(setting, scene, camera=view, geometry="none").color
    return Found(max(off(one, plain) for one in found), 64 * setting.eps)


def _layers_of_one_colour(setting: Setting) -> Found:
    scene, background = gaussians(), np.array([0.3, 0.6, 0.1])
    scene["sh_rest"] = np.zeros((40, 0, 3), np.float32)
    scene["sh_dc"] = np.broadcast_to(harmonic(background), (40, 3)).astype(np.float32)
    found = render(setting, scene, camera=camera(), background=setting.tensor(background))
    return Found(off(found.color, np.broadcast_to(background, found.color.shape)), (40 + ROUNDINGS) * EPS)


# ---- similarity ----


def _same_image(setting: Setting, image: np.ndarray) -> Found:
    given = setting.tensor(image)
    likeness = setting.kernel("ssim")(given, given)
    return Found(max(abs(float(l1_ssim(setting, given, given))), abs(float(likeness) - 1)), ROUNDINGS * setting.eps)


def _symmetric(setting: Setting) -> Found:
    a, b, ssim = setting.tensor(picture()), setting.tensor(picture(seed=1)), setting.kernel("ssim")
    # Variances of 0.07 to 0.08 are differences of numbers near 1/4, which costs one digit, in sums of 121 numbers.
    return Found(abs(float(ssim(a, b)) - float(ssim(b, a))), 8 * ROUNDINGS * setting.eps)


def _channels(setting: Setting) -> Found:
    a, b, ssim = picture(), picture(seed=1), setting.kernel("ssim")
    apart = [float(ssim(setting.tensor(a[..., k : k + 1]), setting.tensor(b[..., k : k + 1]))) for k in range(3)]
    together = float(ssim(setting.tensor(a), setting.tensor(b)))
    return Found(abs(together - float(np.mean(apart))), 8 * ROUNDINGS * setting.eps)


def _brightness(setting: Setting) -> Found:
    grey = picture()[..., 0] * 0.5 + 0.2
    planes = np.array([0.0, 1.0, 2.0])
    plain, found = (sweep(setting, grey, other, BY_ONE, planes) for other in (grey, 0.7 * grey + 0.05))
    # The floor of 2e-5 on variances of 0.02 has twice the effect on half the variance; this isn't rounding.
    return Found(off(found, plain, 1.0), 2e-5 / (0.49 * 0.005) + 64 * setting.eps / 0.005)


def _correlation(setting: Setting) -> Found:
    grey = picture(40, 48)[..., 0]
    scores = sweep(setting, grey, np.roll(grey, -3, axis=1), BY_ONE, np.array([0.0, 3.0, 5.0]))
    beyond = max(0.0, float(np.abs(scores).max()) - 1)
    missed = float(np.count_nonzero(scores[6:-6, 6:-6].argmax(axis=2) != 1))
    return Found(missed + beyond, 64 * setting.eps / 0.005, f"{missed:.0f} pixels at another plane")


def _cases() -> tuple[Case, ...]:
    group = partial(Subject, "invariants")
    scatter, compiled, rasterize = group("scatter", KERNELS), group("scatter", COMPILED), group("rasterize", KERNELS)
    layered, defocused = group("layered", SINGLE_ON_CPU), group("defocus", SINGLE_ON_CPU)
    ssim, stereo = group("ssim", KERNELS), group("stereo", tuple(s for s in KERNELS if s.device == "cpu"))
    turns: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "mirrored": lambda a: np.ascontiguousarray(a[:, ::-1]),
        "upside-down": lambda a: np.ascontiguousarray(a[::-1]),
        "transposed": lambda a: np.ascontiguousarray(a.swapaxes(0, 1)),
    }
    hexagon = ApertureShape(blades=6, rotation=0.2, obstruction=0.4)
    images = {"textured": picture(), "black": np.zeros((24, 32, 3)), "bright": 1e3 * picture()}
    return (
        scatter.case("constant", _constant),
        compiled.case("constant-direct", _constant, form="direct"),
        scatter.case("constant-shape", _constant, shape=hexagon),
        layered.case("constant-layered", _constant, layered=True),
        scatter.case("bounded", _bounded),
        *scatter.each("energy-{radius:g}", _energy, radius=(0.5, 3.0, 12.0)),
        scatter.case("linear", _linear),
        defocused.case("lens-and-scene-times-4", _lens_and_scene, factor=4.0),
        defocused.case("lens-and-scene-times-370", _lens_and_scene, factor=370.0),
        *scatter.each("{change_label}", _moved, change=turns),
        scatter.case("shifted", _shifted),
        *compiled.each("forms-{radius:g}", _forms, radius=(2.0, 40.0, 1000.0)),
        rasterize.case("order", _order),
        rasterize.case("order-at-equal-depth-is-stored", _equal_depth_index),
        rasterize.case("order-at-equal-depth", _equal_depth_any),
        rasterize.case("tiles", _tiles),
        *rasterize.each("scene-times-{factor:g}", _scaled_scene, factor=(4.0, 1e3, 1e-3)),
        rasterize.case("closed-lens", _closed_lens),
        rasterize.case("one-colour", _layers_of_one_colour),
        *ssim.each("ssim-of-itself-{image_label}", _same_image, image=images),
        ssim.case("ssim-symmetric", _symmetric),
        ssim.case("ssim-channels", _channels),
        stereo.case("stereo-brightness", _brightness),
        stereo.case("stereo-shift", _correlation),
    )


CASES = _cases()
