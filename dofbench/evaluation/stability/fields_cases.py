"""Radiance fields: rays without samples, no density and too much, samples at and beyond the cube's faces, NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability import space_cases
from dofbench.evaluation.stability.case import (
    COMPILED,
    DOUBLE,
    KERNELS,
    Case,
    Found,
    Setting,
    differing,
    not_finite,
    off,
    refuses,
    values,
)
from dofbench.evaluation.stability.comparisons import EXACT, NAMED
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.subject import Subject
from dofbench.runtime.factored_grid import GridShape

_SHAPE = GridShape((5, 4, 6), 8, 8, 4)
_RAYS, _EACH = 12, 8  # a power of two, so that a step's length is exact in float32
_LEARNED = ("density", "colour", "basis", "origins", "directions", "views")
_SUMMED = "64 roundings of each of a ray's eight samples"

Arrays = dict[str, np.ndarray]


def _scene(each: int = _EACH) -> Arrays:
    """Rays through the cube's middle, away from its faces, in a random field."""
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
    """(what the rays see, the gradients of its sum by all that has one)."""
    import torch

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
    worst = max(
        off(a, b) for a, b in [*parts, *zip(gradients, expected, strict=True)] if a is not None and b is not None
    )
    return Found(worst, 64 * _EACH * setting.eps)


def _no_samples(setting: Setting) -> Found:
    seen, gradients = _rendered(setting, _scene(each=0))
    wrong = sum(float(np.count_nonzero(values(part))) for part in (seen.color, seen.opacity, seen.distance))
    wrong += sum(float(np.count_nonzero(values(gradient))) for gradient in gradients if gradient is not None)
    return Found(wrong + not_finite(*gradients), 0.0)


def _some_without_samples(setting: Setting) -> Found:
    """Every second ray loses its samples: the others must be as they were."""
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
    """The first sample hides all others, whose colours then have no gradient."""
    scene = _scene()
    seen, gradients = _rendered(setting, scene, shift)
    first = {**scene, "starts": np.arange(_RAYS + 1)}
    first |= {name: scene[name][::_EACH] for name in ("places", "lengths")}
    alone = _rendered(setting, first, shift)[0]
    return Found(
        differing(seen.color, alone.color) + not_finite(*gradients), 0.0, f"opacity {float(seen.opacity[0]):.9g}"
    )


def _on_the_faces(setting: Setting, beyond: float) -> Found:
    """Samples on and beyond the cube's faces have the faces' values, as the same rays moved onto the faces have."""
    scene = _scene()
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    origins = np.concatenate([corners, corners[:4]])
    on = {**scene, "origins": origins, "directions": np.zeros((_RAYS, 3))}
    outside = {**on, "origins": origins + beyond * np.where(origins > 0.5, 1.0, -1.0)}
    (seen, gradients), (there, _) = _rendered(setting, outside), _rendered(setting, on)
    return Found(differing(seen.color, there.color) + not_finite(*gradients), 0.0)


def _saturated(setting: Setting) -> Found:
    """Coefficients of 1e4: every colour is black or white, without gradient, and none is NaN."""
    scene = _scene()
    scene["basis"] = np.sign(scene["basis"]) * 1e4
    seen, gradients = _rendered(setting, scene)
    return Found(not_finite(seen.color, *gradients), 0.0, f"brightest {float(seen.color.detach().max()):.4g}")


def _nan_in_the_grid(setting: Setting) -> Found:
    """NaN in one node of a plane comes out in the rays that pass beside it, and in no others."""
    scene = _scene()
    scene["origins"][: _RAYS // 2] = [0.05, 0.05, 0.05]
    scene["directions"][: _RAYS // 2] = 0.0
    scene["density"][0] = np.nan  # the node at x = y = 0 of the first plane
    seen, _ = _rendered(setting, scene)
    bad = ~np.isfinite(values(seen.opacity))
    wrong = float(np.count_nonzero(~bad[: _RAYS // 2]) + np.count_nonzero(bad[_RAYS // 2 :]))
    return Found(wrong, 0.0, f"{np.count_nonzero(bad)} of {_RAYS} rays")


def _thin(setting: Setting, samples: int = 8192) -> Found:
    """Fog of optical depth 1e-4 in all, by so many samples."""
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
        field.case("ordinary", "a field, its rendering and its gradients are those of float64", _SUMMED, _ordinary),
        field.case("no-samples", "rays without samples see nothing and have no gradient", EXACT, _no_samples),
        field.case("some-without-samples", "the others don't notice", EXACT, _some_without_samples),
        *field.each(
            "shift-{shift:g}",
            "a field of zeros is as transparent as softplus({shift:g}) says, with finite gradients",
            _SUMMED,
            _empty,
            shift=(-80.0, -12.0, 0.0),
        ),
        *field.each(
            "opaque-{shift:g}",
            "a density of {shift:g} hides all behind the first sample, with finite gradients",
            EXACT,
            _opaque,
            shift=(1e3, 1e30),
        ),
        *field.each(
            "beyond-{beyond:g}",
            "samples {beyond:g} beyond the cube's corners have the corners' values",
            EXACT,
            _on_the_faces,
            beyond=(0.0, 1e-6, 1.0, 1e30),
        ),
        field.case("saturated", "coefficients of 1e4 leave colours and gradients finite", EXACT, _saturated),
        field.case("nan-in-the-grid", "NaN comes out in the rays beside it alone", EXACT, _nan_in_the_grid),
        field.case("thin-8192", "8192 samples of thin fog", "16 roundings and half an eps a sample", _thin),
        *compiled.each(
            "{name}-nan",
            "{name} that aren't finite are refused",
            NAMED,
            _nowhere,
            name=("origins", "directions", "places"),
        ),
    )


CASES = _cases() + space_cases.CASES
