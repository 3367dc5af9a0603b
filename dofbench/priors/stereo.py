"""Semi-dense depth of the training views by plane-sweep stereo on their own, shallow photographs.

Each view is swept against its best neighbours (`kernels/stereo`): normalised cross-correlation at three scales of the
image, since a sharp and a blurred photograph of one thing agree in what is coarse, semiglobal matching over the planes,
and then what a depth must pass to be kept: a score, a margin over other planes, and agreement with other views.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from dofbench.cameras import Camera
from dofbench.contracts import TrainingSet
from dofbench.errors import InputError
from dofbench.gaussians.supervision import DepthMap, sparse_depth
from dofbench.images import resize
from dofbench.kernels import load

SOURCES, BEST = 4, 2             # views that a view is matched with; the best of them count
RADIUS = 3                       # pixels of the window around its centre, at every scale
SCALES = (1.0, 0.5, 0.25)         # weight of the scores at 1, 1/2, 1/4 of the size
SMALLEST = 48                    # px, the shorter side of the coarsest scale
STEP = 0.75                      # px that a plane moves the image at most from the plane before
PLANES = (16, 192)               # least and most planes
MARGIN, QUANTILE = 0.1, 0.005    # the points' disparities, without so many at each end, and how far beyond
SMALL, LARGE, EDGE = 0.05, 0.6, 0.05   # semiglobal penalties, in units of correlation, and of grey
ANGLE = (3.0, 12.0)              # degrees between two views' rays: less is imprecise, more looks different
SCORE, DISTINCT = 0.6, 0.05      # least correlation and margin that is believed
OUTLINE, JUMP = 3, 0.03          # px around what is farther by this share of the planes' range
AGREE_PX, AGREE_DEPTH = 1.0, 0.02      # forth and back: error in the image, and relative to the depth
AGREEING = 3                     # other views that must agree, but no more than half of them


@dataclass(frozen=True, eq=False)
class _Swept:
    """What a view's sweep found, everywhere: depth, score and margin, each (H, W)."""

    depth: np.ndarray
    score: np.ndarray
    margin: np.ndarray


def stereo_depth(training_set: TrainingSet) -> list[DepthMap]:
    """One map a view: z, 0 where nothing was found or agreed, and a weight of 0 ... 1.

    Uses the photographs, cameras and sparse points, which say how far planes have to reach.
    Raises InputError for a single view, and without points.
    """
    if len(training_set.views) < 2:
        raise InputError("option depth_prior", "stereo for one training view", "two or more")
    low, high = disparity_bounds(training_set)
    neighbours = choose_sources(training_set)
    pyramids = [_pyramid(view.image, view.camera) for view in training_set.views]
    swept = [_sweep(pyramids, index, chosen, low, high) for index, chosen in enumerate(neighbours)]
    cameras = [view.camera for view in training_set.views]
    return [_agreed(cameras, swept, index, high - low) for index in range(len(cameras))]


def disparity_bounds(training_set: TrainingSet) -> tuple[float, float]:
    """The disparities, 1 / scene unit, between which the planes lie."""
    if training_set.points is None:
        raise InputError("option depth_prior", "stereo without sparse points", "some, which say how far planes reach")
    found = np.concatenate([1 / sparse_depth(training_set.points, view.camera, index).depth.numpy()
                            for index, view in enumerate(training_set.views)])
    low, high = (float(value) for value in np.quantile(found, (QUANTILE, 1 - QUANTILE)))
    beyond = MARGIN * (high - low)
    return max(low - beyond, 0.1 * low), high + beyond


def choose_sources(training_set: TrainingSet) -> list[list[int]]:
    """For each view the others to match it with, best first: many common points under a fair angle."""
    points, views = training_set.points, training_set.views
    count = len(views)
    seen = np.zeros((count, len(points)), dtype=bool)
    for index, view in enumerate(views):
        if points.views is not None:
            seen[index] = [index in track for track in points.views]
        else:
            xy, depth = view.camera.project(points.xyz)
            with np.errstate(invalid="ignore"):
                seen[index] = ((depth > 0) & (xy >= 0).all(axis=1) & (xy[:, 0] < view.camera.width)
                               & (xy[:, 1] < view.camera.height))
    rays = [points.xyz - view.camera.centre for view in views]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    chosen = []
    for index in range(count):
        worth = np.full(count, -1.0)
        for other in range(count):
            common = seen[index] & seen[other]
            if other == index:
                continue
            # Without a common point the cameras may still share a surface: the last resort, after all others.
            both = common if common.any() else np.ones(len(points), dtype=bool)
            cosine = np.clip((rays[index][both] * rays[other][both]).sum(axis=1), -1, 1)
            angle = np.degrees(np.arccos(cosine))
            fair = np.minimum(angle / ANGLE[0], 1) ** 2 * np.minimum(ANGLE[1] / np.maximum(angle, 1e-9), 1) ** 2
            worth[other] = fair.sum() if common.any() else -1 + 1e-3 * fair.mean()
        order = np.argsort(-worth, kind="stable")
        chosen.append([int(other) for other in order if other != index][:SOURCES])
    return chosen


def _pyramid(image: np.ndarray, camera: Camera) -> list[tuple[torch.Tensor, Camera]]:
    """Grey image and camera at each scale."""
    levels = []
    for level in range(len(SCALES)):
        width, height = camera.width >> level, camera.height >> level
        if level and min(width, height) < SMALLEST:
            break
        grey = resize(image, width, height).mean(axis=2)
        levels.append((torch.from_numpy(np.ascontiguousarray(grey, dtype=np.float32)), camera.resized(width, height)))
    return levels


def _at_size(grey: torch.Tensor, camera: Camera, goal: Camera) -> tuple[torch.Tensor, Camera]:
    """A grey image and its camera, with as many pixels as the other camera has."""
    if grey.shape == (goal.height, goal.width):
        return grey, camera
    return torch.from_numpy(resize(grey.numpy(), goal.width, goal.height)), camera.resized(goal.width, goal.height)


def plane_map(camera: Camera, source: Camera) -> np.ndarray:
    """(3, 4): takes (x, y, 1) of `camera`, and times disparity its last column, to `source`, homogeneous."""
    relative = source.world_to_camera @ camera.camera_to_world
    return np.concatenate([source.intrinsics @ relative[:3, :3] @ np.linalg.inv(camera.intrinsics),
                           source.intrinsics @ relative[:3, 3:]], axis=1)


def _planes(camera: Camera, sources: list[Camera], low: float, high: float) -> np.ndarray:
    """Evenly spaced disparities, so fine that the image moves by at most STEP from one to the next."""
    corners = np.array([[x, y, 1.0] for x in (0, camera.width / 2, camera.width)
                        for y in (0, camera.height / 2, camera.height)])
    moved = 0.0
    for source in sources:
        matrix = plane_map(camera, source)
        ends = [corners @ matrix[:, :3].T + matrix[:, 3] * disparity for disparity in (low, high)]
        if all((end[:, 2] > 0).all() for end in ends):
            first, last = (end[:, :2] / end[:, 2:] for end in ends)
            moved = max(moved, float(np.median(np.linalg.norm(first - last, axis=1))))
    return np.linspace(low, high, int(np.clip(np.ceil(moved / STEP) + 1, *PLANES)))


def _sweep(pyramids: list, index: int, chosen: list[int], low: float, high: float) -> _Swept:
    disparities = _planes(pyramids[index][0][1], [pyramids[other][0][1] for other in chosen], low, high)
    total, weight = None, 0.0
    for level, (grey, camera) in enumerate(pyramids[index]):
        others = [_at_size(*pyramids[other][min(level, len(pyramids[other]) - 1)], camera) for other in chosen]
        maps = np.stack([plane_map(camera, source) for _, source in others])
        scores = load("stereo")(grey, torch.stack([other for other, _ in others]), torch.from_numpy(maps),
                                torch.from_numpy(disparities), radius=RADIUS, best=min(BEST, len(others)))
        if total is None:
            total = scores.mul_(SCALES[level])
        else:
            load("stereo", function="upsample")(total, scores, SCALES[level])
        weight += SCALES[level]
    total /= weight
    plane, score, margin = load("stereo", function="semiglobal")(
        total, pyramids[index][0][0], small=SMALL, large=LARGE, edge=EDGE)
    step = (high - low) / (len(disparities) - 1)
    # The first and the last plane stand for all that is beyond.
    edge = (plane.numpy() < 0.5) | (plane.numpy() > len(disparities) - 1.5)
    depth = 1 / (low + step * plane.numpy().astype(np.float64))
    return _Swept(np.where(edge, 0, depth), score.numpy(), margin.numpy())


def _outline(depth: np.ndarray, extent: float) -> np.ndarray:
    """(H, W) bool: what is found near beside something far. A window reaches over an outline, so much of it is far."""
    from scipy.ndimage import minimum_filter

    disparity = 1 / np.where(depth > 0, depth, np.inf)
    return disparity - minimum_filter(disparity, 2 * OUTLINE + 1) > JUMP * extent


def _agreed(cameras: list[Camera], swept: list[_Swept], index: int, extent: float) -> DepthMap:
    """What passes the checks, weighted by score and by how many views agree."""
    own, camera = swept[index], cameras[index]
    believed = (own.depth > 0) & (own.score >= SCORE) & (own.margin >= DISTINCT) & ~_outline(own.depth, extent)
    rows, columns = np.nonzero(believed)
    depth = own.depth[rows, columns]
    local = np.stack([(columns + 0.5 - camera.cx) / camera.fx * depth,
                      (rows + 0.5 - camera.cy) / camera.fy * depth, depth, np.ones_like(depth)], axis=1)
    world = local @ camera.camera_to_world.T
    agreeing = np.zeros(len(rows))
    others = [other for other in range(len(cameras)) if other != index]
    for other in others:
        agreeing += _returns(world[:, :3], depth, (columns + 0.5, rows + 0.5), camera, cameras[other], swept[other])
    needed = min(AGREEING, max(1, len(others) // 2))
    kept = agreeing >= needed
    shape = (camera.height, camera.width)
    found, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    found[rows[kept], columns[kept]] = depth[kept]
    share = agreeing[kept] / (agreeing[kept] + 1)
    weight[rows[kept], columns[kept]] = np.clip(own.score[rows[kept], columns[kept]], 0, 1) * share
    return DepthMap(found, weight)


def _returns(world: np.ndarray, depth: np.ndarray, pixel: tuple[np.ndarray, np.ndarray], camera: Camera,
             other: Camera, seen: _Swept) -> np.ndarray:
    """(M,) bool: points that the other view sees at the same place: there, by its depth, and back again."""
    xy, _ = other.project(world)
    with np.errstate(invalid="ignore"):
        inside = (xy >= 0).all(axis=1) & (xy[:, 0] < other.width) & (xy[:, 1] < other.height)
    column, row = (np.where(inside, values, 0).astype(np.int64) for values in xy.T)
    there = np.where(inside & (seen.score[row, column] >= SCORE), seen.depth[row, column], 0)
    with np.errstate(invalid="ignore"):
        local = np.stack([(xy[:, 0] - other.cx) / other.fx * there, (xy[:, 1] - other.cy) / other.fy * there,
                          there, np.ones_like(there)], axis=1)
        back, z = camera.project((local @ other.camera_to_world.T)[:, :3])
        error = np.hypot(back[:, 0] - pixel[0], back[:, 1] - pixel[1])
        return (there > 0) & (error < AGREE_PX) & (np.abs(z / depth - 1) < AGREE_DEPTH)
