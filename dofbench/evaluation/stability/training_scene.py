"""A tiny scene to train on, and defects of its views.

Where a lens has to be found, the scene is blurred by the method's own model, the scatter renderer or a CoC radius for
each Gaussian. So only initial values, learning rates and defects can prevent success.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.evaluation.stability.samples import harmonic
from dofbench.optics.defocus import scatter_defocus
from dofbench.runtime.ops import load

WIDTH, HEIGHT, VIEWS = 64, 48, 6
NEAR, FAR = 2.0, 6.0
BACKGROUND = [0.15, 0.2, 0.3]
# Beyond the usual 0 ... 1, which blurs so small an image by one pixel at most; A = 5 gives 6.4 pixels.
TRUE_APERTURES, TRUE_FOCI = (3.0, 5.0), (0.2, 0.5, 0.8)


@cache
def true_range() -> DisparityRange:
    """The disparity range that F = 0 and F = 1 refer to."""
    return DisparityRange(1 / FAR, 1 / NEAR)


def true_lens(view: int, one_plane: bool = False) -> Lens:
    """The true lens of a view; `one_plane`: all lenses are focused at 0.5."""
    focus = 0.5 if one_plane else TRUE_FOCI[view % len(TRUE_FOCI)]
    return Lens(TRUE_APERTURES[view % len(TRUE_APERTURES)], focus)


@cache
def scene(
    views: int = VIEWS, one_plane: bool = False, textureless: bool = False, own_blur: bool = False
) -> TrainingSet:
    """Views of two layers of coloured dots, and their centres as sparse points. own_blur: blur every dot by its own CoC
    radius, in place of the scatter renderer."""
    random = np.random.default_rng(0)
    count = 220
    depth = np.where(random.uniform(size=count) < 0.4, NEAR + 0.4, FAR - 0.4) + random.uniform(-0.4, 0.4, count)
    xyz = np.stack(
        [random.uniform(-0.75, 0.75, count) * depth, random.uniform(-0.55, 0.55, count) * depth, depth], axis=1
    )
    xyz[:60, :2] *= 0.5
    colour = np.full((count, 3), 0.5) if textureless else random.uniform(0, 1, (count, 3))
    truth, background = _dots(xyz, 0.035 * depth, colour), [0.5, 0.5, 0.5] if textureless else BACKGROUND
    taken = []
    for index in range(views):
        angle = 2 * math.pi * index / views
        pose = np.eye(4)
        pose[:2, 3] = -0.35 * math.cos(angle), -0.25 * math.sin(angle)
        lens = true_lens(index, one_plane).physical(true_range(), WIDTH)
        taken.append(_taken(f"v{index}", pose, truth, background, lens, own_blur))
    points = PointCloud(
        xyz + random.normal(0, 0.01, xyz.shape), colour.astype(np.float32), np.full(count, 0.3, np.float32)
    )
    return TrainingSet(tuple(taken), points)


@cache
def around() -> TrainingSet:
    """Views of a ball of coloured dots by cameras on a circle around it."""
    random = np.random.default_rng(2)
    count, distance = 220, (NEAR + FAR) / 2
    xyz = random.normal(size=(count, 3))
    xyz *= (1.2 * random.uniform(size=count) ** (1 / 3) / np.linalg.norm(xyz, axis=1))[:, None]
    colour = random.uniform(0, 1, (count, 3))
    truth, taken = _dots(xyz, np.full(count, 0.035 * distance), colour), []
    for index in range(VIEWS):
        angle = 2 * math.pi * index / VIEWS
        pose = np.eye(4)
        pose[:3, :3], pose[2, 3] = _turned(angle), distance
        lens = true_lens(index).physical(true_range(), WIDTH)
        taken.append(_taken(f"v{index}", pose, truth, BACKGROUND, lens))
    return TrainingSet(tuple(taken), PointCloud(xyz, colour.astype(np.float32), np.full(count, 0.3, np.float32)))


def _turned(angle: float) -> np.ndarray:
    """Rotation matrix about the axis that points down. angle: radians."""
    return np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])


def _dots(xyz: np.ndarray, size: np.ndarray, colour: np.ndarray) -> dict[str, Tensor]:
    """Round Gaussians at (N, 3), as the rasteriser's six arguments. size: (N,), scene units."""
    tensor, count = partial(torch.tensor, dtype=torch.float32), len(xyz)
    return {
        "means": tensor(xyz),
        "log_scales": tensor(np.log(size)[:, None].repeat(3, 1)),
        "quaternions": tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        "opacity_logits": torch.full((count,), 3.0),
        "sh_dc": tensor(harmonic(colour)),
        "sh_rest": torch.zeros(count, 0, 3),
    }


@torch.no_grad()
def _taken(
    name: str,
    pose: np.ndarray,
    truth: dict[str, Tensor],
    background: list[float],
    lens: PhysicalLens,
    own_blur: bool = False,
) -> TrainingView:
    """A view from this pose, (4, 4) world to camera; see `scene`."""
    camera, behind = Camera(WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2, pose), torch.tensor(background)
    if own_blur:
        depth = truth["means"] @ torch.from_numpy(pose[2, :3]).float() + float(pose[2, 3])
        radius = lens.signed_radius(1 / depth, WIDTH)
        # The variance of a disc of this radius along each axis
        picture = load("rasterize")(**truth, camera=camera, background=behind, blur=radius**2 / 4)
        return TrainingView(name, camera, picture.color.clamp(0, 1).numpy())
    raster = load("rasterize")(**truth, camera=camera, background=behind)
    surface = torch.where(raster.alpha > 0.1, raster.depth, FAR).clamp_min(NEAR / 2)
    photograph = scatter_defocus(raster.color, lens.signed_radius(1 / surface, WIDTH)).clamp(0, 1)
    return TrainingView(name, camera, photograph.numpy())


def spoiled(training_set: TrainingSet, index: int | None, change: Callable[[np.ndarray], np.ndarray]) -> TrainingSet:
    """The training set with one view's image changed; for None, every view's."""
    views = tuple(
        replace(view, image=change(view.image).astype(np.float32)) if index in (None, k) else view
        for k, view in enumerate(training_set.views)
    )
    return replace(training_set, views=views)


def noise(sigma: float) -> TrainingSet:
    """The scene with Gaussian noise of this standard deviation on every view."""
    random = np.random.default_rng(1)
    return spoiled(scene(), None, lambda image: np.clip(image + random.normal(0, sigma, image.shape), 0, 1))


def nothing_but_noise() -> TrainingSet:
    """The scene with every view replaced by uniform noise."""
    random = np.random.default_rng(1)
    return spoiled(scene(), None, lambda image: random.uniform(0, 1, image.shape))


def black(index: int | None) -> TrainingSet:
    """The scene with one view black; for None, every view."""
    return spoiled(scene(), index, np.zeros_like)


def wrong_pose() -> TrainingSet:
    """The scene with one camera turned by 0.2 radians."""
    views = list(scene().views)
    turn, pose = 0.2, views[2].camera.world_to_camera.copy()
    pose[:3] = _turned(turn) @ pose[:3]
    views[2] = replace(views[2], camera=replace(views[2].camera, world_to_camera=pose))
    return replace(scene(), views=tuple(views))
