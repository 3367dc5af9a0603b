"""Whether photographs of unknown lens can rank lenses: whether their blur is large enough, and seen from enough places.

Two shares, by a trained model's depth and learned lenses.

Energy. E is the error of a prediction without a lens, D what the lens adds to it, both with the protocol's colours, on
its scored pixels of all test photographs: sum D^2 / sum E^2. By the true lens E = D + the rest of the error, so this is
the share that blur explains. D is zero where the protocol predicts a view without a lens. Where it doesn't, the lens
has lowered the error of the fitted half, |E - D| < |E|, so D^2 < 2 D E: at least half of D lies along the error. Any
blur lowers the error of a displaced prediction, so the share is an upper bound: a small one rules the dataset out,
unless training has closed the lens, a large one proves no lens. Predicting another aperture, D is drawn by the learned
aperture without the ratio of the f-numbers, at the median learned focus: what is at stake is the blur of the training
views.

Seen. A pixel of a training view counts if its own and two other training views see its surface (depth within
`SAME_SURFACE`), by rays within 15 degrees of each other, at least two of which are a pixel apart (else depth is
unknown), and at least one of the three with a CoC radius of a pixel or more. Fewer views, or views from farther apart,
may explain blur by geometry or by colours that depend on the direction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.resolved import SAME_SURFACE

LEAST_ENERGY, LEAST_SEEN = 5.0, 10.0  # %: with less of either, a dataset can't rank lenses; 5 % are 0.22 dB
TOGETHER = math.radians(15)  # largest angle between the rays of three views
BLURRED = 1.0  # px, CoC radius
_VIEWS, _PIXELS = 24, 400  # training views whose pixels are counted, and about how many of each, evenly spaced
_AT_ONCE = 2_000_000  # triples of views in memory


@dataclass(frozen=True, eq=False)
class Seen:
    """A training view. depth: (H, W), scene units, by the model, 0 where empty. mask: (H, W), valid pixels, None for
    all."""

    camera: Camera
    lens: PhysicalLens
    depth: np.ndarray
    mask: np.ndarray | None = None


def energies(lensed: np.ndarray, sharp: np.ndarray, photograph: np.ndarray, scored: np.ndarray) -> tuple[float, float]:
    """(energy of the blur, energy of the error) of one view: sums over scored pixels, (H, W), and channels of squared
    differences of encoded images (H, W, 3) by the lens, without it, and of the camera."""
    without = sharp[scored].astype(np.float64)
    blur, error = lensed[scored] - without, photograph[scored] - without
    return float((blur * blur).sum()), float((error * error).sum())


def energy_share(views: Sequence[tuple[float, float]]) -> float:
    """Per cent of the error energy that blur can explain, from `energies` of all views; 0 without any error."""
    blur, error = (math.fsum(energy) for energy in zip(*views, strict=True))
    return 100 * blur / error if error else 0.0


def seen_share(views: Sequence[Seen]) -> float:
    """Per cent of the training views' valid pixels that three views within 15 degrees see, one of them blurred.

    Of up to 24 evenly spaced views about 400 pixels each are counted; a pixel without a surface isn't seen. Raises
    ValueError without views.
    """
    if not views:
        raise ValueError("seen_share: expected at least one view, found none")
    chosen = np.unique(np.linspace(0, len(views) - 1, min(len(views), _VIEWS)).round().astype(int))
    counts = [_counted(views, int(own)) for own in chosen]
    seen, pixels = (sum(values) for values in zip(*counts, strict=True))
    return 100 * seen / pixels if pixels else 0.0


def cannot_rank(energy: float, seen: float) -> str:
    """Why a dataset with these shares, per cent, can't rank lenses, with both figures; "" if it can."""
    if energy >= LEAST_ENERGY and seen >= LEAST_SEEN:
        return ""
    return (
        f"blur explains at most {energy:.1f} % of the error ({LEAST_ENERGY:g} % are needed), and three views within "
        f"15° see blur at {seen:.1f} % of the pixels ({LEAST_SEEN:g} % are needed)"
    )


def _counted(views: Sequence[Seen], own: int) -> tuple[int, int]:
    """(pixels that count, valid pixels) of one view's sample."""
    view = views[own]
    camera = view.camera
    step = max(1, math.isqrt(camera.width * camera.height // _PIXELS))
    row, column = (grid.ravel() for grid in np.mgrid[step // 2 : camera.height : step, step // 2 : camera.width : step])
    if view.mask is not None:
        row, column = row[view.mask[row, column]], column[view.mask[row, column]]
    pixels, z = len(row), np.asarray(view.depth, np.float64)[row, column]
    there = np.isfinite(z) & (z > 0)
    row, column, z = row[there], column[there], z[there]
    world = camera.lifted(column, row, z)
    rays, sees, blurred = _sightings(views, world)
    sees[:, own] = True  # its own surface, whatever rounding does to its place
    most, found = max(1, _AT_ONCE // len(views) ** 2), 0
    for start in range(0, len(world), most):
        part = slice(start, start + most)
        found += int(_three(rays[part], sees[part], blurred[part], own, 1 / camera.fx).sum())
    return found, pixels


def _sightings(views: Sequence[Seen], world: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of points (P, 3): unit rays from each of V views, (P, V, 3); whether it sees the point, and whether with a CoC
    radius of a pixel or more, (P, V)."""
    rays = np.empty((len(world), len(views), 3))
    sees, blurred = (np.zeros((len(world), len(views)), bool) for _ in range(2))
    for place, view in enumerate(views):
        away = world - view.camera.centre
        rays[:, place] = away / np.linalg.norm(away, axis=1, keepdims=True)
        xy, z = view.camera.project(world)
        inside = view.camera.inside(xy)
        column, row = np.where(inside[:, None], xy, 0).astype(np.int64).T
        valid = inside if view.mask is None else inside & view.mask[row, column]
        with np.errstate(divide="ignore", invalid="ignore"):
            sees[:, place] = valid & (np.abs(view.depth[row, column] / z - 1) < SAME_SURFACE)
            blurred[:, place] = np.abs(view.lens.signed_radius(1 / z, view.camera.width)) >= BLURRED
    return rays, sees, blurred


def _three(rays: np.ndarray, sees: np.ndarray, blurred: np.ndarray, own: int, pixel: float) -> np.ndarray:
    """(P,) bool: whether view `own` and two others see the point as `seen_share` wants it. pixel: radians."""
    cosine = np.einsum("pvc,pwc->pvw", rays, rays)
    near = (cosine >= math.cos(TOGETHER)) & sees[:, :, None] & sees[:, None, :]
    near[:, range(rays.shape[1]), range(rays.shape[1])] = False
    with_own = near[:, own]
    apart = cosine <= math.cos(pixel)
    from_own = apart[:, own]
    three = near & with_own[:, :, None] & with_own[:, None, :]
    three &= apart | from_own[:, :, None] | from_own[:, None, :]
    three &= blurred[:, own, None, None] | blurred[:, :, None] | blurred[:, None, :]
    return three.any(axis=(1, 2))
