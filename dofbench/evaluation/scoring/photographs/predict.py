"""A method's prediction of a held-out photograph: one image, by the learned aperture or without a lens."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method, Rendering, Sketches
from dofbench.core.images import from_8bit, to_8bit
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.evaluation.scoring.photographs.colour_fit import colour_map, recoloured
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, shrink
from dofbench.evaluation.scoring.photographs.search import Allowed, Effort, Render, best_of_grid, found_at, refined

REDUCED = 256  # px, approximate width at the start of the search
_RANGE = 2.0, 98.0  # percentiles of a view's disparities, the range of the search


@dataclass(frozen=True, eq=False)
class LensFit:
    """The fit on the first half. lens: None where no lens fits better, or the method has none. at_bound: whether
    the focus is at the bound of what is allowed. renders: number of renderings at the reduced and the full
    size, sketches (`Sketches`) included. cost: mean squared error on the fitted half, encoded."""

    lens: PhysicalLens | None
    at_bound: bool
    renders: tuple[int, int]
    cost: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """The prediction of a photograph. picture: (H, W, 3) float32 at 8-bit levels, by the fitted lens. sharp: the same
    without a lens. Both with colours fitted; None for a non-finite rendering. refused: why no lens was tried, or "".
    bad: number of non-finite values. seconds: wall time."""

    picture: np.ndarray | None
    sharp: np.ndarray | None
    fit: LensFit | None
    tiles: Tiles
    refused: str
    bad: int
    seconds: float


def predict(
    method: Method,
    camera: Camera,
    photograph: np.ndarray,
    aperture: float | None,
    effort: Effort,
    *,
    foci: Iterable[float] = (),
    no_lens: str = "",
    mask: np.ndarray | None = None,
) -> Prediction:
    """Fit focus and colours on half of the photograph, and predict all of it by the learned aperture.

    photograph: (H, W, 3) float32, encoded. aperture: learned, on `camera`, pixels * scene unit; None without one. foci:
    learned focus disparities, the range of the search for a method without depth. no_lens: why the method has no lens,
    if known; one that raises ValueError for a lens has none either. mask: (H, W) bool, True for fitted and scored
    pixels; None for all. The rendering without a lens is always a candidate. Raises ValueError for an image of another
    size.
    """
    start = time.perf_counter()
    tiles = Tiles.of(camera.height, camera.width, mask)
    sharp = method.render(camera, None)
    image = checked_image(sharp.image, camera)
    bad = int(image.size - np.count_nonzero(np.isfinite(image)))
    if bad:
        return Prediction(None, None, None, tiles, no_lens, bad, time.perf_counter() - start)
    allowed = _allowed(np.asarray(sharp.depth), camera, aperture, foci)
    refused = no_lens or _refusal(method, camera) or (allowed if isinstance(allowed, str) else "")
    fit = LensFit(None, False, (0, 1), _cost(image, photograph, tiles.fitted))
    plain = picture = recoloured_by(image, photograph, tiles)
    if not (refused or isinstance(allowed, str)):
        found, lensed = _Search(method, camera, photograph, tiles, allowed).best(effort)
        if not np.isfinite(lensed).all():
            bad = int(lensed.size - np.count_nonzero(np.isfinite(lensed)))
            return Prediction(None, None, found, tiles, "", bad, time.perf_counter() - start)
        if found.cost < fit.cost:
            fit, picture = found, recoloured_by(lensed, photograph, tiles)
        else:
            fit = replace(fit, renders=(found.renders[0], found.renders[1] + 1))
    return Prediction(picture, plain, fit, tiles, refused, 0, time.perf_counter() - start)


class _Search:
    """The search for one view's lens. A method that `Sketches` is searched by sketches, and renders only the lens
    found."""

    def __init__(self, method: Method, camera: Camera, photograph: np.ndarray, tiles: Tiles, allowed: Allowed):
        self._method, self._camera, self._photograph, self._tiles = method, camera, photograph, tiles
        self._allowed = allowed
        self._factor = max(1, round(camera.width / REDUCED))
        self._small = camera.binned(self._factor)
        self._sharp: dict[int, Rendering] = {}  # by width: both sizes are one where a camera is small

    def best(self, effort: Effort) -> tuple[LensFit, np.ndarray]:
        """The fit of least cost, and its rendering at full size."""
        shrunk = shrink(self._photograph, self._factor)
        small = partial(_cost, photograph=shrunk, mask=self._tiles.shrunk(self._factor))
        full = partial(_cost, photograph=self._photograph, mask=self._tiles.fitted)

        def render(camera: Camera) -> Render:
            return lambda focus: self._render(camera, self._allowed.lens(focus))

        grid, apart = best_of_grid(render(self._small), small, effort.focuses)
        coarse = refined(render(self._small), small, grid, apart, effort.coarse)
        first = found_at(render(self._camera), full, coarse.focus)
        fine = refined(render(self._camera), full, first, apart / 4, effort.fine)
        renders = (coarse.renders, fine.renders)
        lens, image, cost = self._allowed.lens(fine.focus), fine.image, fine.cost
        if isinstance(self._method, Sketches):
            image = self._render(self._camera, lens, sketched=False)
            cost, renders = full(image), (renders[0], renders[1] + 1)
        return LensFit(lens, self._allowed.at_bound(fine.focus), renders, cost), image

    def _render(self, camera: Camera, lens: PhysicalLens, *, sketched: bool = True) -> np.ndarray:
        # The reduced camera may lack the last pixels at its edge; its CoC radii are smaller by exactly `factor`.
        lens = replace(lens, width=camera.width * (self._factor if camera is self._small else 1))
        if not (sketched and isinstance(self._method, Sketches)):
            return checked_image(self._method.render(camera, lens).image, camera)
        if camera.width not in self._sharp:
            self._sharp[camera.width] = self._method.render(camera, None)
        return checked_image(self._method.sketch(self._sharp[camera.width], lens).image, camera)


def _cost(image: np.ndarray, photograph: np.ndarray, mask: np.ndarray) -> float:
    """Mean squared error on the masked pixels with fitted colours; infinite for a non-finite value."""
    prediction, truth = image[mask], photograph[mask]
    if not np.isfinite(prediction).all():
        return float("inf")
    return float(np.mean(np.square(recoloured(prediction, colour_map(prediction, truth)) - truth, dtype=np.float64)))


def recoloured_by(image: np.ndarray, photograph: np.ndarray, tiles: Tiles) -> np.ndarray:
    """(H, W, 3) at 8-bit levels: the image with the colours fitted on the first half."""
    own = tiles.fitted
    return from_8bit(to_8bit(recoloured(image, colour_map(image[own], photograph[own]))))


def _allowed(depth: np.ndarray, camera: Camera, aperture: float | None, foci: Iterable[float]) -> Allowed | str:
    """The lenses to search, their foci in the range of the rendered depth (H, W), or of the learned foci; or why there
    are none."""
    if aperture is None:
        return "no learned aperture to predict with"
    known = depth[np.isfinite(depth) & (depth > 0)]
    disparities = 1.0 / known.astype(np.float64) if known.size else np.array(list(foci))
    if not np.any(disparities > 0):
        return "neither depth nor learned foci to search in"
    return Allowed(aperture, DisparityRange.of_disparity(disparities, *_RANGE), camera.width)


def _refusal(method: Method, camera: Camera) -> str:
    """Why the method can't render with a lens: the text of its ValueError, or "" if it can."""
    if isinstance(method, Sketches):
        return ""
    small = camera.binned(max(1, round(camera.width / REDUCED)))
    try:
        method.render(small, PhysicalLens(0.0, 0.0, small.width))
    except ValueError as error:
        return str(error) or "the method raised ValueError for a lens"
    return ""


def checked_image(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The rendered image. Raises ValueError unless it has the camera's size."""
    found = np.asarray(image)
    expected = (camera.height, camera.width, 3)
    if found.shape != expected:
        raise ValueError(f"render: expected an image of shape {expected}, found {found.shape}")
    return found
