"""One picture of the viewer: rendered through a lens, shown as image, map or comparison."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Literal, get_args

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.images import to_8bit
from dofbench.core.lens import GAMMA, ApertureShape, PhysicalLens
from dofbench.evaluation.scoring.error_maps import error_map
from dofbench.evaluation.scoring.resolved import resolved_map
from dofbench.optics.defocus import defocus_numpy
from dofbench.viewing.subject import Photograph, Subject

Layer = Literal["image", "all in focus", "depth", "circle of confusion", "resolved", "photograph", "error"]
LAYERS: tuple[Layer, ...] = get_args(Layer)
_COMPARED = ("photograph", "error")  # need a photograph
_BLURRED = ("image", *_COMPARED)  # seen through the lens
_NEAR_ENOUGH = 1e-3  # of the scene's nearest depth, and radians: a camera so close to a photograph's is at it
_LINE = np.array([255, 255, 255], np.uint8)


@dataclass(frozen=True)
class Look:
    """What is shown, and through which lens.

    half_opening: scene units, 0 for all in focus. focus_disparity: 1 / scene unit. exposure: stops. wipe: share of the
    width, from the left, that shows the layer `left` instead of `layer`. Where the camera is at no photograph, there is
    none to show or to compare with.
    """

    layer: Layer = "image"
    left: Layer = "photograph"
    half_opening: float = 0.0
    focus_disparity: float = 0.0
    shape: ApertureShape = ApertureShape()
    exposure: float = 0.0
    wipe: float = 0.0


@dataclass(frozen=True, eq=False)
class Shown:
    """pixels: uint8 (H, W, 3), the subjects side by side. depths: of each, (H, W / subjects), scene units. cameras: of
    each."""

    pixels: np.ndarray
    depths: tuple[np.ndarray, ...]
    cameras: tuple[Camera, ...]

    def disparity_at(self, across: float, down: float) -> float | None:
        """Disparity at a point, shares of width and height; None where nothing is."""
        column = min(int(across * len(self.depths)), len(self.depths) - 1)
        depth = self.depths[column]
        height, width = depth.shape
        x = min(int((across * len(self.depths) - column) * width), width - 1)
        patch = depth[max(0, int(down * height) - 1) : int(down * height) + 2, max(0, x - 1) : x + 2]
        there = patch[patch > 0]
        return float(np.median(1 / there)) if there.size else None


def picture(subjects: Sequence[Subject], camera: Camera, look: Look, *, draft: bool = False) -> Shown:
    """All subjects under one camera, side by side, each with the whole height.

    draft: blur the all-in-focus rendering by the scatter renderer, for speed, instead of the subject's own renderer.
    """
    count = len(subjects)
    wide = camera.width // count
    part = replace(camera, width=wide, cx=camera.cx - (camera.width - wide) / 2)
    panes, depths = [], []
    for subject in subjects:
        pixels, depth = _pane(subject, part, look, draft)
        panes.append(pixels)
        depths.append(depth)
    for pane in panes[1:]:
        pane[:, :1] = _LINE
    return Shown(np.concatenate(panes, axis=1), tuple(depths), (part,) * count)


def at_photograph(subject: Subject, camera: Camera) -> Photograph | None:
    """The photograph whose camera stands here and looks this way, if any."""
    near = _NEAR_ENOUGH / subject.bounds.q_max
    for photograph in subject.photographs:
        other = photograph.camera
        turn = other.world_to_camera[:3, :3] @ camera.world_to_camera[:3, :3].T
        if np.linalg.norm(other.centre - camera.centre) < near and np.trace(turn) > 3 - _NEAR_ENOUGH**2:
            return photograph
    return None


def _pane(subject: Subject, camera: Camera, look: Look, draft: bool) -> tuple[np.ndarray, np.ndarray]:
    photograph = at_photograph(subject, camera)
    photographed = None if photograph is None else _placed(photograph, camera)
    if subject.render is None:  # a dataset: only its own photographs
        shown = np.zeros((camera.height, camera.width, 3), np.float32) if photographed is None else photographed
        return _exposed(shown, look.exposure), np.zeros(shown.shape[:2], np.float32)
    lens = PhysicalLens(look.half_opening * camera.fx, look.focus_disparity, camera.width)

    @cache
    def rendered(blurred: bool) -> Rendering:
        return _rendered(subject, camera, lens if blurred else None, look.shape, draft)

    def pixels_of(layer: Layer) -> tuple[np.ndarray, np.ndarray]:
        rendering = rendered(layer in _BLURRED and look.half_opening > 0)
        return _layer(subject, camera, replace(look, layer=layer), lens, rendering, photographed), rendering.depth

    pixels, depth = pixels_of(look.layer)
    edge = round(look.wipe * camera.width)
    if edge > 0 and (photographed is not None or look.left not in _COMPARED):
        pixels[:, :edge] = pixels_of(look.left)[0][:, :edge]
        pixels[:, max(0, edge - 1) : edge] = _LINE
    return pixels, depth


def _rendered(
    subject: Subject, camera: Camera, lens: PhysicalLens | None, shape: ApertureShape, draft: bool
) -> Rendering:
    assert subject.render is not None
    if lens is None or not draft:
        return subject.render(camera, lens, shape)
    sharp = subject.render(camera, None, shape)
    return replace(sharp, image=defocus_numpy(sharp.image, sharp.depth, lens, Blur(shape=shape))[0])


def _layer(
    subject: Subject,
    camera: Camera,
    look: Look,
    lens: PhysicalLens,
    rendering: Rendering,
    photographed: np.ndarray | None,
) -> np.ndarray:
    depth = rendering.depth
    disparity = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    match look.layer:
        case "depth":
            return _coloured(subject.bounds.normalise(disparity), depth > 0)
        case "circle of confusion":
            radius = np.abs(lens.signed_radius(disparity, camera.width))
            return _coloured(radius / (0.02 * camera.width), depth > 0)
        case "resolved" if subject.resolved is not None:
            return resolved_map(subject.resolved.smallest(camera))
        case "photograph" if photographed is not None:
            return _exposed(photographed, look.exposure)
        case "error" if photographed is not None:
            return error_map(np.clip(rendering.image, 0, 1), photographed).copy()
    return _exposed(rendering.image, look.exposure)


def _exposed(image: np.ndarray, stops: float) -> np.ndarray:
    """uint8 pixels; brightened in linear light."""
    return to_8bit(np.clip(image * 2.0 ** (stops / GAMMA), 0.0, 1.0))


def _coloured(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Values from 0 to 1 as colours; black where nothing is."""
    from matplotlib import colormaps

    pixels = colormaps["viridis"](np.clip(values, 0, 1), bytes=True)[..., :3].copy()
    pixels[~there] = 0
    return pixels


@lru_cache(maxsize=4)
def _read(photograph: Photograph) -> np.ndarray:
    return photograph.read()


def _placed(photograph: Photograph, camera: Camera) -> np.ndarray:
    """The photograph as the camera at its place shows it, (H, W, 3); black around it."""
    import cv2

    image, of = _read(photograph), photograph.camera
    across, down = camera.fx / of.fx, camera.fy / of.fy
    # OpenCV's pixel centres are whole numbers, ours are at half-integers.
    place = np.array(
        [
            [across, 0, camera.cx - across * of.cx + 0.5 * across - 0.5],
            [0, down, camera.cy - down * of.cy + 0.5 * down - 0.5],
        ]
    )
    size = camera.width, camera.height
    method = cv2.INTER_AREA if across < 1 else cv2.INTER_LINEAR
    return np.clip(cv2.warpAffine(image, place, size, flags=method), 0, 1)


def fitting(photograph: Camera, width: int, height: int) -> float:
    """Vertical field of view, radians, with which a window of this size shows the whole photograph."""
    tall = 0.5 * photograph.height / photograph.fy
    wide = 0.5 * photograph.width / photograph.fx * height / width
    return 2 * math.atan(max(tall, wide))
