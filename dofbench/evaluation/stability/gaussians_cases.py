"""Extreme Gaussians: scales, needles, quaternions, opacities, the near plane, a million on one tile, none."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from dofbench.evaluation.stability.case import COMPILED, KERNELS, SINGLE, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import GEOMETRY, Scene, against_reference, outputs, render
from dofbench.evaluation.stability.deviation import differing, not_finite, off, refuses, values
from dofbench.evaluation.stability.samples import VIEW_HEIGHT, VIEW_WIDTH, camera, gaussians, single, straight, together

NEAR = float(np.float32(0.2))  # the near plane as a number that is exact in both precisions


def _scale(setting: Setting, scale: float) -> Found:
    scene = together(*(single(mean=(x, 0.1, 4.0 + x), scale=scale, logit=1.0) for x in (-0.3, 0.0, 0.4)))
    return against_reference(setting, scene, filter_3d=0.02)


def _too_large(setting: Setting) -> Found:
    scene = single()
    scene["log_scales"][:] = 100.0
    call = partial(render, setting, scene, camera=straight(), geometry=GEOMETRY)
    if setting.backend == "reference":  # plain torch may give NaN, but must not give a plausible number
        raster = call()
        return Found(0.0 if not_finite(raster.color) or not values(raster.alpha).any() else 1.0, 0.0, "nothing drawn")
    return refuses(FloatingPointError, call, "log_scales")


def _bad_number(setting: Setting, name: str, value: float) -> Found:
    scene = gaussians()
    scene[name].reshape(40, -1)[7, 0] = value
    call = partial(render, setting, scene, camera=straight(), geometry=GEOMETRY)
    return refuses(FloatingPointError, call, f"{name}[7]")


def _empty(setting: Setting) -> Found:
    scene = {name: value[:0] for name, value in gaussians().items()}
    tensors = {name: setting.tensor(value, gradient=True) for name, value in scene.items()}
    background = setting.tensor(np.array([0.25, 0.5, 0.75]))
    raster = setting.kernel("rasterize")(**tensors, camera=straight(), geometry="distortion", background=background)
    blank = np.broadcast_to(values(background), (VIEW_HEIGHT, VIEW_WIDTH, 3))
    wrong = differing(raster.color, blank) + sum(differing(part, np.zeros(part.shape)) for part in raster[1:])
    if raster.color.requires_grad:
        raster.color.sum().backward()
        wrong += sum(tensor.grad is not None and tensor.grad.numel() > 0 for tensor in tensors.values())
    return Found(float(wrong), 0.0)


def _zero_quaternion(setting: Setting) -> Found:
    zero, one = (single(scale=(0.4, 0.1, 0.2), quaternion=q) for q in ((0.0,) * 4, (1.0, 0.0, 0.0, 0.0)))
    a, b = (outputs(render(setting, scene, camera=camera(), geometry=GEOMETRY), 5) for scene in (zero, one))
    return Found(sum(map(differing, a, b)), 0.0)


def _quaternion_length(setting: Setting, length: float) -> Found:
    direction = np.array([0.5, -0.1, 0.7, 0.3])
    usual, other = (single(scale=(0.4, 0.1, 0.2), quaternion=tuple(direction * size)) for size in (1.0, length))
    a, b = (outputs(render(setting, scene, camera=camera(), geometry=GEOMETRY), 5) for scene in (usual, other))
    # Scaling by a power of ten rounds each component of the quaternion, in which a rotation is quadratic.
    return Found(max(map(off, b, a)), 64 * float(np.finfo(np.float32).eps))


def _opacity(setting: Setting, logit: float) -> Found:
    scene = together(single(scale=0.3, logit=logit), single(mean=(0.0, 0.0, 6.0), scale=0.8, colour=(0.1, 0.2, 0.9)))
    return against_reference(setting, scene)


def _skipped(setting: Setting, scene: Scene) -> Found:
    raster = render(setting, scene, camera=straight(), geometry="distortion", near=NEAR)
    return Found(sum(float(np.count_nonzero(values(part))) for part in outputs(raster, 6)), 0.0)


def _drawn(setting: Setting, scene: Scene) -> Found:
    raster = render(setting, scene, camera=straight(), geometry="distortion", near=NEAR)
    seen = float((values(raster.alpha) > 0).any())
    return Found(not_finite(*raster) + (1 - seen), 0.0, "nothing was drawn" if not seen else "")


def _half_a_pixel(setting: Setting) -> Found:
    # Two errors are allowed: that of sampling a Gaussian of variance 0.25 + 0.1 px^2, 4 exp(-2 pi^2 0.35) = 4e-3, and
    # the rim below 1/255, which isn't drawn.
    worst = 0.0
    for x, y in ((0.0, 0.0), (0.5, 0.5), (0.25, 0.4), (0.9, 0.1)):
        scene = single(mean=(x * 4 / VIEW_WIDTH, y * 4 / VIEW_WIDTH, 4.0), scale=0.5 * 4 / VIEW_WIDTH, logit=0.0)
        raster = render(setting, scene, camera=straight(), geometry="none")
        integral = 0.5 * 2 * math.pi * 0.25
        worst = max(worst, abs(float(values(raster.alpha).sum()) / integral - 1))
    return Found(worst, 4 * math.exp(-2 * math.pi**2 * 0.35) + 2 / 255 / (0.5 * 0.25 / 0.35))


def _many_on_a_tile(setting: Setting, count: int) -> Found:
    one = single(scale=1e4, logit=math.log(0.005 / 0.995), colour=(0.2, 0.5, 0.8))
    scene = {name: np.repeat(value, count, axis=0) for name, value in one.items()}
    scene["means"][:, 2] = np.linspace(4, 5, count, dtype=np.float32)
    view = straight(16, 16)
    raster = render(setting, scene, camera=view, geometry="depth")
    # Footprints of 10^5 pixels: opacity 0.005 everywhere. Blending goes on until the transmittance is under 1e-4.
    layers = min(count, math.ceil(math.log(1e-4) / math.log(1 - 0.005)))
    covered = 1 - (1 - 0.005) ** layers
    bound = (layers + 64) * setting.eps + 0.005 * 1e-4  # rounding may add or drop the last layer
    expected = np.broadcast_to(covered * np.array([0.2, 0.5, 0.8]), (16, 16, 3))
    error = max(off(raster.alpha, np.full((16, 16), covered)), off(raster.color, expected))
    return Found(error, bound, f"{layers} of {count} take part")


def _harmonics(setting: Setting, size: float) -> Found:
    scene = gaussians(rest=15)
    scene["sh_rest"] *= np.float32(size)
    return against_reference(setting, scene, camera=camera())


def _overflowing_harmonics(setting: Setting) -> Found:
    scene = gaussians(rest=15)
    scene["sh_rest"][:] = np.float32(3e38)
    call = partial(render, setting, scene, camera=camera(), geometry=GEOMETRY)
    try:
        raster = call()
    except FloatingPointError as error:
        return Found(0.0, 0.0, str(error)[:120])
    return Found(0.0 if not_finite(raster.color) else 1.0, 0.0, "comes out as not finite")


def _scaled(factor: float) -> Scene:
    scene = gaussians()
    return {
        **scene,
        "means": scene["means"] * np.float32(factor),
        "log_scales": scene["log_scales"] + np.float32(math.log(factor)),
    }


def _cases() -> tuple[Case, ...]:
    every, float32, compiled = (Subject("gaussians", "rasterize", settings) for settings in (KERNELS, SINGLE, COMPILED))
    before, beyond = (float(np.nextafter(np.float32(NEAR), np.float32(side))) for side in (0, 1))
    unit, slanted = math.sqrt(0.5), (0.9, 0.1, 0.2, 0.3)
    edge_on, nearly = (unit, 0.0, unit, 0.0), (0.7067, 0.0, 0.7075, 0.0)
    far_left, far_up = single(mean=(50.0, 0.0, 1.0), scale=5.0), single(mean=(0.0, -90.0, 1.0), scale=20.0)
    scenes = {
        "needle-1e2": single(scale=(3.0, 0.03, 0.03), quaternion=slanted),
        "needle-1e4": single(scale=(300.0, 0.03, 0.03), quaternion=slanted),
        "needle-at-the-camera": single(scale=(0.05, 0.05, 5.0), mean=(0.1, 0.1, 8.0)),
        "disc-edge-on": single(scale=(50.0, 50.0, 0.01), quaternion=edge_on),
        "disc-nearly-edge-on": single(scale=(50.0, 50.0, 0.01), mean=(0.3, 0.0, 4.0), quaternion=nearly),
        "far": _scaled(2.5e5),
        "close": _scaled(0.2),
        "beside-the-image": together(far_left, far_up, single()),
        "thousand": gaussians(1000),
    }
    skipped = {
        "opacity-0": single(scale=0.5, logit=-1e4),
        "behind": single(mean=(0.0, 0.0, -4.0), scale=3.0, logit=5.0),
        "at-the-camera": single(mean=(0.0, 0.0, 0.0), scale=3.0, logit=5.0),
    }
    on, before_it, drawn = (single(mean=(0.01, 0.0, z), scale=0.05, logit=2.0) for z in (NEAR, before, beyond))
    parameters = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
    return (
        *float32.each("scale-{scale:g}", _scale, scale=(1e-8, 1e-4, 1e-1, 1e2, 1e4)),
        every.case("scale-1e-8-no-filter", _skipped, scene=single(scale=1e-8, logit=5.0)),
        float32.case("scale-e100", _too_large),
        *float32.each("{scene_label}", against_reference, scene=scenes),
        every.case("quaternion-0", _zero_quaternion),
        *every.each("quaternion-length-{length:g}", _quaternion_length, length=(1e-30, 1e-15, 1e15, 1e30)),
        *float32.each("opacity-logit-{logit:g}", _opacity, logit=(-100.0, -5.0, 4.0, 100.0)),
        *(every.case(name, _skipped, scene=scene) for name, scene in skipped.items()),
        *every.each("near-plane-{scene_label}", _skipped, scene={"on": on, "before": before_it}),
        every.case("near-plane-beyond", _drawn, scene=drawn),
        every.case("half-a-pixel", _half_a_pixel),
        every.case("thousand-on-a-tile", _many_on_a_tile, count=1000),
        compiled.case("million-on-a-tile", _many_on_a_tile, count=1_000_000),
        every.case("none", _empty),
        *float32.each("harmonics-{size:g}", _harmonics, size=(1e3, 1e6, 1e30)),
        float32.case("harmonics-3e38", _overflowing_harmonics),
        *(
            case
            for case in compiled.each("{value}-{name}", _bad_number, name=parameters, value=(np.nan, np.inf))
            if case.name != "inf-opacity_logits"  # an opacity of 1
        ),
    )


CASES = _cases()
