"""The built-in scene at the size of a stamp, blurred in one of several ways, and what methods claim on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import cv2
import numpy as np
from made_up import Recorder

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.content import content_folder
from dofbench.core.contracts import Method, TrainingSet, TrainingView
from dofbench.core.errors import Status
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.core.similarity import psnr
from dofbench.methods.cards import find_method
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import load_scene
from dofbench.training.gaussians.gaussian_method import GaussianMethod

WIDTH, HOLD = 96, 8
FOCI = (0.2, 0.5, 0.8)  # of photographs in turn
# The usual presets without what a stamp doesn't need
SMALL = {"colour_per_view": "off", "depth_prior": "sparse", "start_points": 0, "max_gaussians": 20000}


@dataclass(frozen=True)
class Claim:
    """A method that is said to beat its plain version on photographs blurred in this way. options: what is published
    for tens of thousands of steps gets values for so few. steps: as few as show it."""

    method: str
    plain: str
    blur: str
    options: dict[str, float] = field(default_factory=dict)
    steps: int = 500


CLAIMS = (
    Claim("rgs", "mipsplatting", "evenly", {"view_blur_lr": 1.0}),
    Claim("deblurring3dgs", "3dgs", "out of focus", {"enlarge_lambda": 0.1, "enlarge_most": 2.0}, 300),
    Claim("gsplat_deblur", "mipsplatting", "out of focus", {"enlarge_lambda": 0.3, "enlarge_most": 5.0}, 300),
    Claim("bags", "mipsplatting", "evenly", steps=300),
    Claim("cocogaussian", "mipsplatting", "out of focus", {"focus_lr": 0.05, "copies_lr": 3e-3}, 300),
    Claim("dofgs", "mipsplatting", "out of focus"),
    Claim("dofgaussian", "mipsplatting", "out of focus"),
    Claim("dofnerf", "nerf", "out of focus", steps=1000),
)


@dataclass(frozen=True, eq=False)
class Tabletop:
    """training: what a method sees. tests: camera and sharp picture (H, W, 3) of each view held back."""

    training: TrainingSet
    tests: tuple[tuple[Camera, np.ndarray], ...]


@cache
def disparities() -> DisparityRange:
    """Of all surfaces, without the nearest and farthest two in a hundred."""
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH)
    every = np.concatenate([1 / depth[depth > 0] for depth in (view.depth() for view in scene.views if view.depth)])
    return DisparityRange(*(float(bound) for bound in np.percentile(every, (2, 98))))


def lens(aperture: float, focus: float, width: int = WIDTH) -> PhysicalLens:
    """A lens of the stamp, or of this width."""
    return Lens(aperture, focus).physical(disparities(), width)


def out_of_focus(aperture: float) -> Callable[[int, np.ndarray, np.ndarray], np.ndarray]:
    """Photographs by a lens of this aperture, focused near, in the middle and far in turn."""
    return lambda index, image, depth: defocus_numpy(image, depth, lens(aperture, FOCI[index % len(FOCI)]))[0]


def blurred_evenly(index: int, image: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Photographs that a Gaussian blurs, whatever their depth: hardly, by a pixel, and by two, in turn."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), (0.3, 1.0, 2.0)[index % 3]))


def sharp(index: int, image: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Photographs that nothing blurs."""
    return image


BLURS = {"evenly": blurred_evenly, "out of focus": out_of_focus(2.0), "sharp": sharp}


@cache
def tabletop(name: str) -> Tabletop:
    """name: one of BLURS, which blur by a view's number, sharp picture and depth."""
    blur = BLURS[name]
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH)
    views, tests = [], []
    for index, view in enumerate(scene.views):
        assert view.depth is not None
        image, depth = view.image().astype(np.float32), view.depth()
        if index % HOLD == 0:
            tests.append((view.camera, image))
        else:
            photograph = blur(index, image, depth).clip(0, 1).astype(np.float32)
            views.append(TrainingView(view.name, view.camera, photograph))
    return Tabletop(TrainingSet(tuple(views), scene.points), tuple(tests))


def trained(method: str, table: Tabletop, steps: int, seed: int = 0, **options: Any) -> Method:
    """The method of this id with its preset `cpu`, trained for so many steps."""
    entry = find_method(method)
    _, preset, _ = entry.preset("cpu")
    usual = entry.create({}, 0, "cpu")
    small, forced = (SMALL, usual.FORCED) if isinstance(usual, GaussianMethod) else ({}, {})
    given = {**preset, **small, "steps": steps, **options}
    made = entry.create({name: value for name, value in given.items() if name not in forced}, seed, "cpu")
    assert made.fit(table.training, Budget(steps=steps), Recorder()).status is Status.OK
    return made


def sharp_psnr(method: Method, table: Tabletop) -> float:
    """dB of the views held back, all in focus: the mean over views."""
    shown = [(method.render(camera, None).image.clip(0, 1), image) for camera, image in table.tests]
    return float(np.mean([psnr(rendered, image) for rendered, image in shown]))
