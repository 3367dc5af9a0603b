"""A method's prediction of a held-out photograph by a fitted lens (two numbers) and colours."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method, Rendering, Sketches
from dofbench.core.images import from_8bit, to_8bit
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.evaluation.scoring.photographs.colour_fit import colour_map, recoloured
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, shrink
from dofbench.evaluation.scoring.photographs.search import (
    LEAST_STEP,
    Effort,
    Found,
    Frame,
    best_sigma,
    lens_grid,
    simplex,
)
from dofbench.optics.tone import decode, encode

HALVES = (0, 1)
REDUCED = 256  # px, approximate width at the start of the search
LARGEST_SIGMA = 0.04  # share of the width; as wide as a disc of twice that radius
_RANGE = 2.0, 98.0  # percentiles of a view's disparities, the range of the search


@dataclass(frozen=True, eq=False)
class HalfFit:
    """The fit on one half, by which the other half is predicted. lens: None without a lens. sigma: px, of the Gaussian
    blur of the all-in-focus rendering, or None. renders: number of renderings at the reduced and the full size, grid
    and sketches (`Sketches`) included. cost: mean squared error on the fitted half."""

    fitted_on: int
    lens: PhysicalLens | None
    sigma: float | None
    renders: tuple[int, int]
    cost: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """The prediction of a photograph, every tile by the fit on the other half. picture, blurred: (H, W, 3) float32 at
    8-bit levels, by the lens and by one Gaussian blur (equal without a lens; blurred may be None). refused: why there
    is no lens, or "". bad: number of non-finite values; there is no picture then. seconds: wall time."""

    picture: np.ndarray | None
    blurred: np.ndarray | None
    halves: tuple[HalfFit, ...]
    tiles: Tiles
    refused: str
    bad: int
    seconds: float

    @staticmethod
    def by_blur(image: np.ndarray, photograph: np.ndarray, tiles: Tiles, refused: str, start: float) -> Prediction:
        """The prediction by the best Gaussian blur of the all-in-focus rendering."""
        gaussian = _fit_sigmas(image, photograph, tiles)
        blurred = assembled([found for _, found in gaussian], photograph, tiles)
        halves = tuple(
            HalfFit(half, None, sigma, (0, 1), _cost(found, photograph, tiles.fitted(half)))
            for half, (sigma, found) in zip(HALVES, gaussian, strict=True)
        )
        return Prediction(blurred, blurred, halves, tiles, refused, 0, time.perf_counter() - start)


def sharp_rendering(method: Method, camera: Camera) -> tuple[np.ndarray, np.ndarray, int]:
    """The rendering without a lens: image (H, W, 3), depth (H, W) in scene units, number of non-finite image values.

    Raises ValueError for an image of another size than the camera's.
    """
    sharp = method.render(camera, None)
    image = checked_image(sharp.image, camera)
    return image, np.asarray(sharp.depth), int(image.size - np.count_nonzero(np.isfinite(image)))


def predict(
    method: Method,
    camera: Camera,
    photograph: np.ndarray,
    learned: Mapping[str, PhysicalLens] | None,
    effort: Effort,
    *,
    cameras: Mapping[str, Camera] | None = None,
    no_lens: str = "",
    mask: np.ndarray | None = None,
) -> Prediction:
    """Fit lens and colours on each half of the photograph, and predict the other half.

    photograph: (H, W, 3) float32, encoded. learned: lenses of the training views, where the search starts. cameras:
    theirs, from which the lenses are transferred to `camera`; None if all are `camera`. no_lens: why the method has no
    lens, if known; a method that raises ValueError for a lens has none either, and the best Gaussian blur is used.
    mask: (H, W) bool, True for fitted and scored pixels; None for all. Raises ValueError for an image of another size.
    """
    start = time.perf_counter()
    tiles = Tiles.of(camera.height, camera.width, mask)
    image, depth, bad = sharp_rendering(method, camera)
    if bad:
        return Prediction(None, None, (), tiles, no_lens, bad, time.perf_counter() - start)
    frame = frame_of(depth, camera, learned)
    refused = no_lens or (
        "neither depth nor learned lenses to begin with" if frame is None else refusal(method, camera, frame)
    )
    if frame is None or refused:
        return Prediction.by_blur(image, photograph, tiles, refused, start)
    starts = [frame.ends(lens) for lens in lens_grid(frame, median_lens(learned, cameras, camera), effort)]
    search = LensSearch(method, camera, photograph, tiles, starts, frame.lens, _steps)
    found = search.prediction(effort, start)
    if not effort.blur or found.bad:
        return found
    blur = Prediction.by_blur(image, photograph, tiles, refused, start)
    halves = tuple(replace(half, sigma=other.sigma) for half, other in zip(found.halves, blur.halves, strict=True))
    return replace(found, blurred=blur.picture, halves=halves, seconds=blur.seconds)


def _steps(at: np.ndarray) -> tuple[float, float]:
    largest = float(np.abs(at).max())
    return max(LEAST_STEP, 0.25 * largest), max(LEAST_STEP, 0.1 * largest)


class LensSearch:
    """The search for one view's lens. The grid is rendered once for both halves; each half's simplex starts from its
    best grid point. A method that `Sketches` is searched by sketches, and renders only the lens found.

    starts: grid points, from which `lens` makes a lens. steps: the simplex's first steps at the reduced and full size.
    """

    def __init__(
        self,
        method: Method,
        camera: Camera,
        photograph: np.ndarray,
        tiles: Tiles,
        starts: list[np.ndarray],
        lens: Callable[[np.ndarray], PhysicalLens],
        steps: Callable[[np.ndarray], tuple[float, float]],
    ):
        self._method, self._camera, self._photograph, self._tiles = method, camera, photograph, tiles
        self._lens, self._steps = lens, steps
        factor = max(1, round(camera.width / REDUCED))
        self._factor, self._small = factor, camera.binned(factor)
        self._sharp: dict[int, Rendering] = {}  # by width: both sizes are one where a camera is small
        self._grid = [(at, self._render(self._small, lens(at))) for at in starts]

    def prediction(self, effort: Effort, start: float) -> Prediction:
        """The fits of both halves, and their prediction. start: of the work, by `time.perf_counter`."""
        found = [self._half(half, effort) for half in HALVES]
        bad = max(int(one.image.size - np.count_nonzero(np.isfinite(one.image))) for one, _ in found)
        halves = tuple(
            HalfFit(half, self._lens(one.at), None, renders, one.cost)
            for half, (one, renders) in zip(HALVES, found, strict=True)
        )
        picture = None if bad else assembled([one.image for one, _ in found], self._photograph, self._tiles)
        return Prediction(picture, None, halves, self._tiles, "", bad, time.perf_counter() - start)

    def _half(self, half: int, effort: Effort) -> tuple[Found, tuple[int, int]]:
        """The best fit on a half, and the number of renderings at the reduced and the full size."""
        shrunk = shrink(self._photograph, self._factor)
        small = partial(_cost, photograph=shrunk, mask=self._tiles.shrunk(self._factor, half))
        full = partial(_cost, photograph=self._photograph, mask=self._tiles.fitted(half))

        def render(camera: Camera) -> Callable[[np.ndarray], np.ndarray]:
            return lambda at: self._render(camera, self._lens(at))

        at, _ = min(self._grid, key=lambda pair: small(pair[1]))
        coarse = simplex(render(self._small), small, at, effort.coarse, self._steps(at)[0])
        fine = simplex(render(self._camera), full, coarse.at, effort.fine, self._steps(coarse.at)[1])
        if isinstance(self._method, Sketches):
            image = self._render(self._camera, self._lens(fine.at), sketched=False)
            fine = Found(fine.at, full(image), image, fine.renders + 1)
        return fine, (len(self._grid) + coarse.renders, fine.renders)

    def _render(self, camera: Camera, lens: PhysicalLens, *, sketched: bool = True) -> np.ndarray:
        # The reduced camera may lack the last pixels at its edge; its CoC radii are smaller by exactly `factor`.
        lens = replace(lens, width=camera.width * (self._factor if camera is self._small else 1))
        if not (sketched and isinstance(self._method, Sketches)):
            return checked_image(self._method.render(camera, lens).image, camera)
        if camera.width not in self._sharp:
            self._sharp[camera.width] = self._method.render(camera, None)
        return checked_image(self._method.sketch(self._sharp[camera.width], lens).image, camera)


def _fit_sigmas(image: np.ndarray, photograph: np.ndarray, tiles: Tiles) -> list[tuple[float, np.ndarray]]:
    """The Gaussian blur of least cost on each half: sigma, and the image blurred in linear light."""
    from scipy.ndimage import gaussian_filter

    linear = decode(np.clip(image, 0.0, 1.0))

    @lru_cache(maxsize=16)  # the grid is the same for both halves
    def blurred(sigma: float) -> np.ndarray:
        return image if sigma == 0 else encode(gaussian_filter(linear, (sigma, sigma, 0), mode="nearest", truncate=3))

    costs = [partial(_cost, photograph=photograph, mask=tiles.fitted(half)) for half in HALVES]
    return [best_sigma(blurred, cost, LARGEST_SIGMA * image.shape[1]) for cost in costs]


def _cost(image: np.ndarray, photograph: np.ndarray, mask: np.ndarray) -> float:
    """Mean squared error on the masked pixels with fitted colours; infinite for a non-finite value."""
    prediction, truth = image[mask], photograph[mask]
    if not np.isfinite(prediction).all():
        return float("inf")
    return float(np.mean(np.square(recoloured(prediction, colour_map(prediction, truth)) - truth, dtype=np.float64)))


def assembled(images: list[np.ndarray], photograph: np.ndarray, tiles: Tiles) -> np.ndarray:
    """(H, W, 3) at 8-bit levels: each half from the image and colours fitted on the other half."""
    picture = np.zeros_like(photograph, dtype=np.float32)
    for half, image in zip(HALVES, images, strict=True):
        own, other = tiles.fitted(half), tiles.half == 1 - half
        picture[other] = recoloured(image[other], colour_map(image[own], photograph[own]))
    return from_8bit(to_8bit(picture))


def frame_of(depth: np.ndarray, camera: Camera, learned: Mapping[str, PhysicalLens] | None) -> Frame | None:
    """The frame by the range of disparities of the depth (H, W), or of the learned foci; None without both."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    foci = np.array([lens.focus_disparity for lens in (learned or {}).values()])
    disparities = 1.0 / known.astype(np.float64) if known.size else foci
    if not np.any(disparities > 0):
        return None
    return Frame(DisparityRange.of_disparity(disparities, *_RANGE), camera.width)


def refusal(method: Method, camera: Camera, frame: Frame) -> str:
    """Why the method can't render with a lens: the text of its ValueError, or "" if it can."""
    if isinstance(method, Sketches):
        return ""
    small = camera.binned(max(1, round(camera.width / REDUCED)))
    try:
        method.render(small, PhysicalLens(0.0, frame.disparities.q_min, small.width))
    except ValueError as error:
        return str(error) or "the method raised ValueError for a lens"
    return ""


def median_lens(
    learned: Mapping[str, PhysicalLens] | None, cameras: Mapping[str, Camera] | None, camera: Camera
) -> PhysicalLens | None:
    """Median aperture and focus of learned lenses, on `camera`; None without any. cameras: of the lenses, by name; None
    if all are `camera`'s, at any size."""
    if not learned:
        return None
    taken = dict.fromkeys(learned, camera) if cameras is None else cameras
    lenses = [lens.transferred(taken[name], camera) for name, lens in learned.items()]
    aperture, focus = np.median([[lens.aperture, lens.focus_disparity] for lens in lenses], axis=0)
    return PhysicalLens(float(aperture), float(focus), camera.width)


def checked_image(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The rendered image. Raises ValueError unless it has the camera's size."""
    found = np.asarray(image)
    expected = (camera.height, camera.width, 3)
    if found.shape != expected:
        raise ValueError(f"render: expected an image of shape {expected}, found {found.shape}")
    return found
