"""Radiance fields: no samples, zero and huge density, samples on and beyond the cube's faces, NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.evaluation.stability import space_cases
from dofbench.evaluation.stability.case import COMPILED, DOUBLE, KERNELS, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import differing, not_finite, off, refuses, values
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.runtime.factored_grid import GridShape

_SHAPE = GridShape((5, 4, 6), 8, 8, 4)
_RAYS, _EACH = 12, 8  # a power of two, so that a step's length is exact in float32
_LEARNED = ("density", "colour", "basis", "origins", "directions", "views")

Arrays = dict[str, np.ndarray]


def _scene(each: int = _EACH) -> Arrays:
    """Rays through the cube's centre in a random field."""
    random = np.random.default_rng(11)
    views = random.normal(size=(_RAYS, 3))
    return {
        "density": random.uniform(-1, 1, _SHAPE.density_size),
        "colour": random.uniform(-1, 1, _SHAPE.colour_size),
        "basis": random.uniform(-1, 1, _SHAPE.basis_shape),
        "origins": random.uniform(0.2, 0.4, (_RAYS, 3)),
        "directions": random.uniform(0.1, 0.5, (_RAYS, 3)),
        "views": views / np.linalg.norm(views, axis=1, keepdims=True),
        "starts": each * np.arange(_RAYS + 1),
        "places": np.tile((np.arange(each) + 0.5) / max(each, 1), _RAYS),
        "lengths": np.full(_RAYS * each, 1.0 / max(each, 1)),
    }


def _rendered(setting: Setting, scene: Mapping[str, np.ndarray], shift: float = 0.0) -> tuple[Any, list[Tensor | None]]:
    """The rendering, and the gradients of its sum with respect to each of `_LEARNED`."""
    tensors = {
        name: torch.from_numpy(array).to(setting.device)
        if name == "starts"
        else setting.tensor(array.astype(np.float32), gradient=name in _LEARNED)
        for name, array in scene.items()
    }
    seen = setting.kernel("field")(**tensors, shape=_SHAPE, shift=shift)
    (seen.color.sum() + seen.opacity.sum() + seen.distance.sum()).backward()
    return seen, [tensors[name].grad for name in _LEARNED]


def _ordinary(setting: Setting) -> Found:
    seen, gradients = _rendered(setting, _scene())
    exact, expected = _rendered(DOUBLE, _scene())
    parts = [(getattr(seen, name), getattr(exact, name)) for name in ("color", "opacity", "distance")]
    parts += zip(gradients, expected, strict=True)
    return Found(max(off(a, b) for a, b in parts if a is not None and b is not None), 64 * _EACH * setting.eps)


def _no_samples(setting: Setting) -> Found:
    seen, gradients = _rendered(setting, _scene(each=0))
    wrong = sum(float(np.count_nonzero(values(part))) for part in (seen.color, seen.opacity, seen.distance))
    wrong += sum(float(np.count_nonzero(values(gradient))) for gradient in gradients if gradient is not None)
    return Found(wrong + not_finite(*gradients), 0.0)


def _some_without_samples(setting: Setting) -> Found:
    """Every second ray loses its samples; the others must not change."""
    whole = _scene()
    kept = np.repeat(np.arange(_RAYS) % 2 == 0, _EACH)
    counts = np.where(np.arange(_RAYS) % 2 == 0, _EACH, 0)
    fewer = {**whole, "starts": np.concatenate([[0], np.cumsum(counts)])}
    fewer |= {name: whole[name][kept] for name in ("places", "lengths")}
    seen, before = _rendered(setting, fewer)[0], _rendered(setting, whole)[0]
    wrong = differing(seen.color[::2], before.color[::2]) + float(np.count_nonzero(values(seen.color[1::2])))
    return Found(wrong, 0.0)


def _empty(setting: Setting, shift: float) -> Found:
    scene = {**_scene(), "density": np.zeros(_SHAPE.density_size)}
    seen, gradients = _rendered(setting, scene, shift)
    expected = -math.expm1(-math.log1p(math.exp(shift)))  # of a ray of length 1
    error = off(seen.opacity, np.full(_RAYS, expected))
    return Found(error + not_finite(*gradients), 64 * _EACH * setting.eps, f"opacity {expected:.3g}")


def _opaque(setting: Setting, shift: float) -> Found:
    """The first sample hides all others."""
    scene = _scene()
    seen, gradients = _rendered(setting, scene, shift)
    first = {**scene, "starts": np.arange(_RAYS + 1)}
    first |= {name: scene[name][::_EACH] for name in ("places", "lengths")}
    alone = _rendered(setting, first, shift)[0]
    wrong = differing(seen.color, alone.color) + not_finite(*gradients)
    return Found(wrong, 0.0, f"opacity {float(seen.opacity[0]):.9g}")


def _on_the_faces(setting: Setting, beyond: float) -> Found:
    """Samples beyond the cube's corners have the corners' values."""
    scene = _scene()
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    origins = np.concatenate([corners, corners[:4]])
    on = {**scene, "origins": origins, "directions": np.zeros((_RAYS, 3))}
    outside = {**on, "origins": origins + beyond * np.where(origins > 0.5, 1.0, -1.0)}
    (seen, gradients), (there, _) = _rendered(setting, outside), _rendered(setting, on)
    return Found(differing(seen.color, there.color) + not_finite(*gradients), 0.0)


def _saturated(setting: Setting) -> Found:
    """Coefficients of 1e4: every colour is black or white, none is NaN."""
    scene = _scene()
    scene["basis"] = np.sign(scene["basis"]) * 1e4
    seen, gradients = _rendered(setting, scene)
    return Found(not_finite(seen.color, *gradients), 0.0, f"brightest {float(seen.color.detach().max()):.4g}")


def _nan_in_the_grid(setting: Setting) -> Found:
    """NaN in one node of a plane affects the rays that pass next to it, and no others."""
    scene = _scene()
    scene["origins"][: _RAYS // 2] = [0.05, 0.05, 0.05]
    scene["directions"][: _RAYS // 2] = 0.0
    scene["density"][0] = np.nan  # the node at x = y = 0 of the first plane
    seen, _ = _rendered(setting, scene)
    bad = ~np.isfinite(values(seen.opacity))
    wrong = float(np.count_nonzero(~bad[: _RAYS // 2]) + np.count_nonzero(bad[_RAYS // 2 :]))
    return Found(wrong, 0.0, f"{np.count_nonzero(bad)} of {_RAYS} rays")


def _thin(setting: Setting, samples: int = 8192) -> Found:
    """Fog of a total optical depth of 1e-4."""
    scene = {**_scene(each=samples), "density": np.zeros(_SHAPE.density_size)}
    shift = math.log(1e-4)
    seen, _ = _rendered(setting, scene, shift)
    expected = -math.expm1(-math.log1p(math.exp(shift)))
    return Found(off(seen.opacity, np.full(_RAYS, expected)), (ROUNDINGS + samples / 2) * setting.eps)


def _nowhere(setting: Setting, name: str) -> Found:
    scene = _scene()
    scene[name].reshape(-1)[3] = np.nan
    return refuses(FloatingPointError, lambda: _rendered(setting, scene), name)


def _cases() -> tuple[Case, ...]:
    field, compiled = Subject("fields", "field", KERNELS), Subject("fields", "field", COMPILED)
    return (
        field.case("ordinary", _ordinary),
        field.case("no-samples", _no_samples),
        field.case("some-without-samples", _some_without_samples),
        *field.each("shift-{shift:g}", _empty, shift=(-80.0, -12.0, 0.0)),
        *field.each("opaque-{shift:g}", _opaque, shift=(1e3, 1e30)),
        *field.each("beyond-{beyond:g}", _on_the_faces, beyond=(0.0, 1e-6, 1.0, 1e30)),
        field.case("saturated", _saturated),
        field.case("nan-in-the-grid", _nan_in_the_grid),
        field.case("thin-8192", _thin),
        *compiled.each("{name}-nan", _nowhere, name=("origins", "directions", "places")),
    )


CASES = _cases() + space_cases.CASES
