"""Unbounded scenes in a field's cube: rays along axes, through edges and corners, past the box, from far away."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.evaluation.stability.case import NUMPY, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import not_finite
from dofbench.evaluation.stability.oracle import ROUNDINGS, sensitivity
from dofbench.training.fields.cube_rays import points_along
from dofbench.training.fields.unbounded import Unbounded

_LOW, _HIGH = np.array([-1.0, -2.0, -1.5]), np.array([1.0, 2.0, 1.5])
_SHARES = np.linspace(0.02, 0.98, 25)  # of a ray's length in the cube

Rays = tuple[np.ndarray, np.ndarray]


def _from(origin: tuple[float, ...], *directions: tuple[float, ...]) -> Rays:
    """Rays from one point; point and directions in half sides of the box."""
    along = np.array(directions) * _HIGH
    return np.tile(np.array(origin) * _HIGH, (len(along), 1)), along


def _everywhere(origin: tuple[float, ...]) -> Rays:
    """Rays along all axes, and to all corners and edge centres of a box around this point."""
    ways = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)]
    return _from(origin, *ways)


_RAYS: dict[str, Rays] = {
    "middle": _everywhere((0, 0, 0)),
    "corner": _everywhere((1, 1, 1)),
    "face": _everywhere((0, 0, -0.999)),
    "beside": _everywhere((2, 2, 0)),
    "grazing": _from((-3, 1 + 1e-6, 0.2), (1, 0, 0), (1, -1e-6, 0)),
    "far": _from((0.3, 0.2, -1e3), (0, 0, 1), (1e-4, 0, 1), (0, -2e-4, 1)),
    "away": _everywhere((0, 0, 1e3)),
}


def _mapped(rays: tuple[Tensor, Tensor], scale: float, near: float = 0.0) -> Tensor:
    """Points in the cube along rays in a scene `scale` times as large, (R, N, 3)."""
    space = Unbounded(_LOW * scale, _HIGH * scale, near * scale)
    return points_along(space.pieces(*rays), torch.as_tensor(_SHARES).to(rays[0].dtype))


def _exact(*rays: np.ndarray, scale: float, near: float) -> np.ndarray:
    origins, directions = (torch.from_numpy(scale * part) for part in rays)
    return _mapped((origins, directions), scale, near).numpy()


def _found(setting: Setting, rays: Rays, scale: float = 1.0, near: float = 0.0) -> Found:
    """Error of the rays' points against float64, as a share of the cube's side; infinite if a gradient isn't finite."""
    given = [setting.tensor(scale * part, gradient=True) for part in rays]
    found = _mapped((given[0], given[1]), scale, near)
    found.sum().backward()
    if not_finite(found, given[0].grad, given[1].grad):
        return Found(math.inf, 0.0, "not finite")

    def exact(*parts: np.ndarray) -> np.ndarray:
        return _exact(*parts, scale=scale, near=near)

    moved = sensitivity(exact, rays, setting.eps / 2)
    error = float(np.abs(found.detach().double().numpy() - exact(*rays)).max())
    longest = max(1.0, float(np.abs(rays[0] / _HIGH).max()))
    return Found(error, 8 * moved + ROUNDINGS * longest * setting.eps, f"condition {2 * moved / setting.eps:.3g}")


def _cases() -> tuple[Case, ...]:
    space = Subject("fields", "space", NUMPY)
    return (
        *space.each("rays-{rays_label}", _found, rays=_RAYS),
        *space.each("space-times-{scale:g}", _found, rays=(_everywhere((0.3, -0.2, 0.1)),), scale=(1e-6, 1e6)),
        space.case("near-plane", _found, rays=_everywhere((0.5, 0.5, 0.5)), near=1.0),
    )


CASES = _cases()
