"""Semi-dense depth of the training views by plane-sweep stereo on their own defocused images.

Each view is swept against its best neighbours (`kernels/stereo`): normalised cross-correlation at three image scales,
since sharp and blurred images of one surface agree at coarse scales, then semiglobal matching over the planes. A depth
is kept if its score, its margin over other planes and its agreement with other views are large enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.images import resize
from dofbench.core.masks import shrunk_mask
from dofbench.core.progress import Update, silent
from dofbench.runtime.ops import load
from dofbench.training.common.depth import all_disparities
from dofbench.training.common.depth_map import DepthMap, PositiveMap
from dofbench.training.common.priors.stereo_sources import choose_sources

SOURCES, BEST = 4, 2  # number of views that a view is matched with, and how many of the best scores are averaged
RADIUS = 3  # pixels of the window around its centre, at every scale
SCALES = (1.0, 0.5, 0.25)  # weight of the scores at 1, 1/2, 1/4 of the size
SMALLEST = 48  # px, the shorter side of the coarsest scale
STEP = 0.75  # px, largest displacement of the image from one plane to the next
PLANES = (16, 192)  # least and most planes
TOGETHER = 8  # the kernels process planes in groups of this size, so a multiple is used
# Planes span the points' disparities between these quantiles, extended by the margin at each end
MARGIN, QUANTILE = 0.1, 0.005
# Penalties of semiglobal matching, in units of correlation; grey difference that counts as an edge
SMALL, LARGE, EDGE = 0.05, 0.6, 0.05
SCORE, DISTINCT = 0.6, 0.05  # least correlation, and least margin over other planes, of a depth that is kept
OUTLINE, JUMP = 3, 0.03  # px around a surface that is farther by this share of the planes' range
# Projecting to another view and back: tolerated error in the image, and relative to the depth
AGREE_PX, AGREE_DEPTH = 1.0, 0.02
AGREEING = 3  # other views that must agree, but no more than half of all
CHECKED = 32  # views that a view is checked against
SWEEP, CHECK = "depth prior: sweep", "depth prior: check"


_Level = tuple[torch.Tensor, Camera]  # a grey image (H, W), and its camera
_PYRAMIDS = 3 * SOURCES  # kept at a time: neighbouring views share most of their sources


@dataclass(frozen=True, eq=False)
class _Swept:
    """One view's sweep, (H, W) float32 each. depth: 0 where the score is too low. weight: the score; 0 where the margin
    over other planes is too small or an outline is near."""

    depth: np.ndarray
    weight: np.ndarray


class _Found:
    """A view's sweep as it is kept until all views are swept. weight: None once the view is checked."""

    def __init__(self, swept: _Swept):
        self.depth = PositiveMap(swept.depth)
        self.weight: PositiveMap | None = PositiveMap(swept.weight)


class _Pyramids(Sequence[list[_Level]]):
    """The views' grey images at `count` scales from 1 / 2^first on, made when they are asked for; the last few stay."""

    def __init__(self, views: Sequence[TrainingView], first: int, count: int, device: str):
        self._views, self._first, self._count, self._device = views, first, count, device
        self._made = lru_cache(_PYRAMIDS)(self._make)

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, index: Any) -> Any:
        return self._made(range(len(self._views))[index])

    def _make(self, index: int) -> list[_Level]:
        view = self._views[index]
        return _pyramid(view.image, view.camera, self._first + self._count, self._device)[self._first :]


def stereo_depth(
    training_set: TrainingSet, *, coarser: int = 0, device: str = "cpu", progress: Update = silent
) -> list[DepthMap]:
    """One map per view: z, 0 where no depth was found or confirmed, and a weight of 0 ... 1.

    The sparse points give the range of the planes. Masked pixels get no depth, and confirm none. coarser: how many
    times to repeat at half the previous size, to fill pixels without depth; each time the weight is halved, as errors
    are twice as large. progress: called for every view swept or checked. Raises InputError for a single view, and
    without points.
    """
    views = training_set.views
    if len(views) < 2:
        raise InputError("option depth_prior", "stereo for one training view", "two or more")
    bounds, neighbours = disparity_bounds(training_set), choose_sources(training_set, CHECKED)
    masks = [view.mask for view in views]
    maps = _matched(_Pyramids(views, 0, len(SCALES), device), masks, neighbours, bounds, "", progress)
    for level in range(1, coarser + 1):
        smaller = _Pyramids(views, level, len(SCALES), device)
        if not all(smaller):
            break
        more = _matched(smaller, masks, neighbours, bounds, f" at 1/{2**level}", progress)
        for index, other in enumerate(more):
            maps[index] = _filled(maps[index], other, 0.5**level)
    for index, mask in enumerate(masks):
        if mask is not None:
            maps[index] = DepthMap(np.where(mask, maps[index].depth, 0), maps[index].weight)
    return maps


def _matched(
    pyramids: Sequence[list[_Level]],
    masks: list[np.ndarray | None],
    neighbours: list[list[int]],
    bounds: tuple[float, float],
    size: str,
    progress: Update,
) -> list[DepthMap]:
    """Maps at the size of the pyramids' first level. size: its name in progress messages."""
    swept, cameras = list[_Found](), [levels[0][1] for levels in pyramids]
    device = pyramids[0][0][0].device
    progress(SWEEP + size, 0, len(cameras))
    for index, chosen in enumerate(neighbours):
        swept.append(_Found(_unmasked(_sweep(pyramids, index, chosen[:SOURCES], *bounds), masks[index])))
        progress(SWEEP + size, index + 1, len(cameras))
    maps = []
    progress(CHECK + size, 0, len(cameras))
    for index, chosen in enumerate(neighbours):
        maps.append(_agreed(cameras, swept, index, chosen, device))
        swept[index].weight = None
        progress(CHECK + size, index + 1, len(cameras))
    return maps


def _unmasked(found: _Swept, mask: np.ndarray | None) -> _Swept:
    """The sweep without masked pixels. mask: (H, W) at the view's full size, or None."""
    if mask is None:
        return found
    valid = shrunk_mask(mask, found.depth.shape[1], found.depth.shape[0])
    return _Swept(np.where(valid, found.depth, np.float32(0)), np.where(valid, found.weight, np.float32(0)))


def _filled(found: DepthMap, coarse: DepthMap, share: float) -> DepthMap:
    """Fill the map where it has no depth by the nearest pixels of a smaller one, their weight times `share`."""
    at = np.ix_(
        *(
            ((np.arange(size) + 0.5) * small / size).astype(np.int64)
            for size, small in zip(found.depth.shape, coarse.depth.shape, strict=True)
        )
    )
    known = found.depth > 0
    return DepthMap(
        np.where(known, found.depth, coarse.depth[at]),
        np.where(known, found.weight, np.float32(share) * coarse.weight[at]),
    )


def disparity_bounds(training_set: TrainingSet) -> tuple[float, float]:
    """The disparities, 1 / scene unit, between which the planes lie."""
    if training_set.points is None:
        raise InputError("option depth_prior", "stereo without sparse points", "some, which say how far planes reach")
    found = all_disparities(training_set.points, [view.camera for view in training_set.views])
    low, high = (float(value) for value in np.quantile(found, (QUANTILE, 1 - QUANTILE)))
    beyond = MARGIN * (high - low)
    return max(low - beyond, 0.1 * low), high + beyond


def _pyramid(image: np.ndarray, camera: Camera, count: int, device: str = "cpu") -> list[_Level]:
    """Grey image and camera at each of `count` scales, or at fewer if smaller images would have too few pixels."""
    levels = []
    for level in range(count):
        width, height = camera.width >> level, camera.height >> level
        if level and min(width, height) < SMALLEST:
            break
        grey = resize(image, width, height).mean(axis=2)
        tensor = torch.from_numpy(np.ascontiguousarray(grey, dtype=np.float32)).to(device)
        levels.append((tensor, camera.resized(width, height)))
    return levels


def _at_size(level: _Level, goal: Camera) -> _Level:
    """A grey image and its camera, resized to as many pixels as the camera `goal` has."""
    grey, camera = level
    if grey.shape == (goal.height, goal.width):
        return grey, camera
    resized = torch.from_numpy(resize(grey.numpy(force=True), goal.width, goal.height)).to(grey.device)
    return resized, camera.resized(goal.width, goal.height)


def plane_map(camera: Camera, source: Camera) -> np.ndarray:
    """(3, 4) matrix that takes (x, y, 1, disparity) of `camera` to homogeneous pixel coordinates of `source`.

    If (x, y, 1, disparity) is multiplied by z first, the third coordinate of the result is the z in `source`.
    """
    relative = source.world_to_camera @ camera.camera_to_world
    return np.concatenate(
        [source.intrinsics @ relative[:3, :3] @ np.linalg.inv(camera.intrinsics), source.intrinsics @ relative[:3, 3:]],
        axis=1,
    )


def _planes(camera: Camera, sources: list[Camera], low: float, high: float) -> np.ndarray:
    """Evenly spaced disparities, so fine that the image moves by at most STEP from one to the next."""
    corners = np.array(
        [[x, y, 1.0] for x in (0, camera.width / 2, camera.width) for y in (0, camera.height / 2, camera.height)]
    )
    moved = 0.0
    for source in sources:
        matrix = plane_map(camera, source)
        ends = [corners @ matrix[:, :3].T + matrix[:, 3] * disparity for disparity in (low, high)]
        if all((end[:, 2] > 0).all() for end in ends):
            first, last = (end[:, :2] / end[:, 2:] for end in ends)
            moved = max(moved, float(np.median(np.linalg.norm(first - last, axis=1))))
    count = int(np.clip(np.ceil(moved / STEP) + 1, *PLANES))
    return np.linspace(low, high, -(-count // TOGETHER) * TOGETHER)


def _sweep(pyramids: Sequence[list[_Level]], index: int, chosen: list[int], low: float, high: float) -> _Swept:
    levels = pyramids[index]
    disparities = _planes(levels[0][1], [pyramids[other][0][1] for other in chosen], low, high)
    total, weight = None, 0.0
    for level in reversed(range(len(levels))):
        grey, camera = levels[level]
        others = [_at_size(pyramids[other][min(level, len(pyramids[other]) - 1)], camera) for other in chosen]
        maps = np.stack([plane_map(camera, source) for _, source in others])
        # Displacements are half as large in an image of half the size, so half as many planes are enough.
        planes = np.linspace(low, high, -(-(len(disparities) - 1) // 2**level) + 1)
        scores = load("stereo")(
            grey,
            torch.stack([other for other, _ in others]),
            torch.from_numpy(maps).to(grey.device),
            torch.from_numpy(planes).to(grey.device),
            radius=RADIUS,
            best=min(BEST, len(others)),
        )
        if total is not None:
            load("stereo", function="upsample")(scores, total, weight / (weight + SCALES[level]))
        total, weight = scores, weight + SCALES[level]
    plane, score, margin = (
        found.numpy(force=True)
        for found in load("stereo", function="semiglobal")(total, levels[0][0], small=SMALL, large=LARGE, edge=EDGE)
    )
    depth = 1 / (low + (high - low) / (len(disparities) - 1) * plane.astype(np.float64))
    # The first and the last plane also attract surfaces outside the range, so depths on them aren't kept.
    depth[(plane < 0.5) | (plane > len(disparities) - 1.5)] = 0
    believed = (depth > 0) & (score >= SCORE) & (margin >= DISTINCT) & ~_outline(depth, high - low)
    depth[score < SCORE] = 0
    return _Swept(depth.astype(np.float32), np.where(believed, np.clip(score, 0, 1), 0).astype(np.float32))


def _outline(depth: np.ndarray, extent: float) -> np.ndarray:
    """(H, W) bool: pixels with a much farther surface nearby, whose depth is often wrong, since the matching window
    reaches over the outline."""
    from scipy.ndimage import minimum_filter

    disparity = 1 / np.where(depth > 0, depth, np.inf)
    return disparity - minimum_filter(disparity, 2 * OUTLINE + 1) > JUMP * extent


def _agreed(
    cameras: list[Camera], swept: list[_Found], index: int, others: list[int], device: torch.device
) -> DepthMap:
    """The depths that other views confirm, weighted by score and by how many views agree."""
    own, camera = swept[index], cameras[index]
    assert own.weight is not None
    weight = own.weight.whole()
    depth = np.where(weight > 0, own.depth.whole(), 0)
    agreeing = np.zeros(depth.shape, np.float32)
    for other in others:
        there, back = (plane_map(*pair) for pair in ((camera, cameras[other]), (cameras[other], camera)))
        arrays = depth, swept[other].depth.whole(), there, back
        seen = load("stereo", function="returns")(
            *(torch.from_numpy(array).to(device) for array in arrays), pixels=AGREE_PX, share=AGREE_DEPTH
        )
        agreeing += seen.numpy(force=True)
    kept = agreeing >= min(AGREEING, max(1, (len(cameras) - 1) // 2))
    return DepthMap(np.where(kept, depth, 0), np.where(kept, weight * (agreeing / (agreeing + 1)), 0))
