"""Invariants of rendering: the order of the Gaussians, the position of tiles, the scale of the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from dofbench.evaluation.stability.case import KERNELS, Case, Found, Setting, differing, off, values
from dofbench.evaluation.stability.comparisons import EXACT, Scene, outputs, render
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import camera, gaussians, harmonic, single, straight, together
from dofbench.evaluation.stability.subject import Subject


def _permuted(scene: Scene, order: np.ndarray) -> Scene:
    return {name: value[order] for name, value in scene.items()}


def _order(setting: Setting) -> Found:
    scene = gaussians()
    plain = render(setting, scene, camera=camera(), geometry="full")
    found = render(
        setting, _permuted(scene, np.random.default_rng(0).permutation(40)), camera=camera(), geometry="full"
    )
    if setting.backend == "reference":  # torch's vector instructions round the last elements of a batch differently
        return Found(
            max(off(a, b) for a, b in zip(outputs(found, 5), outputs(plain, 5), strict=True)), 64 * setting.eps
        )
    return Found(sum(differing(a, b) for a, b in zip(outputs(found, 5), outputs(plain, 5), strict=True)), 0.0)


def _coplanar() -> Scene:
    colours = ((1.0, 0.1, 0.1), (0.1, 1.0, 0.1), (0.1, 0.1, 1.0))
    return together(
        *(single(mean=(0.05 * k, 0.0, 4.0), scale=0.3, logit=1.0, colour=colour) for k, colour in enumerate(colours))
    )


def _equal_depth_index(setting: Setting) -> Found:
    # Gaussians of equal depth are blended in stored order: moving later ones back by an ulp of depth must change
    # nothing.
    scene = _coplanar()
    nudged = {name: value.copy() for name, value in scene.items()}
    for k in (1, 2):
        nudged["means"][k, 2] = np.nextafter(nudged["means"][k - 1, 2], np.float32(9))
    return Found(
        off(render(setting, scene, camera=straight()).color, render(setting, nudged, camera=straight()).color),
        64 * float(np.finfo(np.float32).eps),
    )


def _equal_depth_any(setting: Setting) -> Found:
    scene = _coplanar()
    found = render(setting, _permuted(scene, np.array([2, 0, 1])), camera=straight()).color
    return Found(off(found, render(setting, scene, camera=straight()).color), 64 * setting.eps)


def _tiles(setting: Setting) -> Found:
    # A window of the view, whose tiles begin elsewhere. The Jacobian is clamped relative to the window, so all
    # Gaussians lie inside it.
    scene, view = gaussians(60, log_scale=-2.5), straight(70, 50)
    whole = render(setting, scene, camera=view, geometry="full")
    top, left, height, width = 7, 5, 36, 53
    window = replace(view, width=width, height=height, cx=view.cx - left, cy=view.cy - top)
    part = render(setting, scene, camera=window, geometry="full")
    area = (slice(top, top + height), slice(left, left + width))
    error = max(off(a, b[area]) for a, b in zip(outputs(part, 5), outputs(whole, 5), strict=True))
    # An offset from a pixel loses as many digits as the pixel's coordinate is larger; its square counts, times up to 2
    # log 255.
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
    # log_scales of size log(factor) are rounded to float32 and exponentiated, which gives the scales this relative
    # error.
    eps = float(np.finfo(np.float32).eps)
    bound = 64 * (abs(np.log(factor)) + 8) * eps
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
    return Found(
        off(found.color, np.broadcast_to(background, found.color.shape)),
        (40 + ROUNDINGS) * float(np.finfo(np.float32).eps),
    )


def _cases() -> tuple[Case, ...]:
    rasterize = Subject("invariants", "rasterize", KERNELS)
    return (
        rasterize.case(
            "order",
            "the order that Gaussians are stored in doesn't matter",
            EXACT + "; by torch, 64 roundings",
            _order,
        ),
        rasterize.case(
            "order-at-equal-depth-is-stored",
            "at equal depth what is stored first is in front",
            "64 roundings of float32: a nudge by the last digit",
            _equal_depth_index,
        ),
        rasterize.case(
            "order-at-equal-depth", "at equal depth the stored order doesn't matter", "64 roundings", _equal_depth_any
        ),
        rasterize.case(
            "tiles",
            "a window of the view is rendered as the whole, wherever its tiles begin",
            "what pixel coordinates of 70 lose, times twice the largest exponent",
            _tiles,
        ),
        *rasterize.each(
            "scene-times-{factor:g}",
            "everything {factor:g} times as large looks the same",
            "what float32 keeps of the logarithms of the scales, 64 times",
            _scaled_scene,
            factor=(4.0, 1e3, 1e-3),
        ),
        rasterize.case(
            "closed-lens",
            "from every point of a closed lens the view is that from its centre",
            "64 roundings",
            _closed_lens,
        ),
        rasterize.case(
            "one-colour",
            "Gaussians of the background's colour can't be seen",
            "one rounding of float32 a Gaussian, and 16",
            _layers_of_one_colour,
        ),
    )


CASES = _cases()
