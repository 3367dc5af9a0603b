"""How much more one photograph is blurred than another, patch by patch of a surface that both show.

Blur by a Gaussian of variance v leaves exp(-v w^2) of the energy at the angular frequency w. So where two photographs
show one surface, the sharper one is blurred until a band of frequencies has the energy that it has in the other. Phase
doesn't matter, so small errors of poses and depth don't either. A disc of radius R counts as a variance of R^2 / 4
along each axis, which holds while R is a few pixels; larger ones are measured on smaller images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.images import resize
from dofbench.optics.blur_width import LUMA, noise_deviation
from dofbench.optics.tone import decode

LEVELS = 4  # image sizes, each half the one before
SMALLEST = 48  # px, the shorter side of the smallest image
NEIGHBOURS = 6  # photographs that a photograph is compared with
ANGLE = 15.0  # degrees between two views' rays, at most: beyond, surfaces look different
ZOOM = 1.5  # a surface isn't this many times larger in one photograph than in the other
BAND = (0.6, 1.2)  # px: the band is the difference of Gaussians of these sigmas
WINDOW, STRIDE = 4.0, 6  # px: sigma of a patch's window; distance between patches
BLURS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)  # px, standard deviations by which the sharper photograph is blurred
FLAT = 0.05  # of the disparity range: standard deviation within a patch
SAME = 0.05  # relative difference of depths that counts as one surface
COARSER = 0.8  # px: blur of both patches before they are correlated
WHOLE = 0.98  # share of a patch that both photographs show
ALIKE = 0.7  # least correlation of two patches, both blurred
SHARED = 0.05  # least share of a view's surface that a neighbour shows
NOISIEST = 0.5  # largest share of noise in a patch's energy
SPREAD = 0.15  # standard deviation of an energy's logarithm besides noise


@dataclass(frozen=True, eq=False)
class BlurPairs:
    """Differences of blur of N patches. first, second: (N,) views. q_first, q_second: (N,) disparity of the patch,
    1 / scene unit, in each view's camera. zoom: (N,) pixels of the first view for one of the second. difference: (N,)
    variance of the first view's blur less that of the second view's, px^2 of the first view. deviation: (N,) its
    standard deviation, px^2."""

    first: np.ndarray
    second: np.ndarray
    q_first: np.ndarray
    q_second: np.ndarray
    zoom: np.ndarray
    difference: np.ndarray
    deviation: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def thinned(self, most: int, seed: int) -> BlurPairs:
        """At most so many of the patches, drawn at random."""
        if len(self) <= most:
            return self
        drawn = np.sort(np.random.default_rng([seed, 3]).choice(len(self), most, replace=False))
        return BlurPairs(*(getattr(self, field.name)[drawn] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Surface:
    """What is known of a view. photograph: gives its luma, (H, W) float32 in linear light. depth: z (H, W) in scene
    units, 0 unknown."""

    camera: Camera
    photograph: Callable[[], np.ndarray]
    depth: np.ndarray

    @staticmethod
    def of(camera: Camera, image: np.ndarray, depth: np.ndarray, mask: np.ndarray | None, gamma: float) -> Surface:
        """image: (H, W, 3), encoded. depth: (H, W) z, scene units, 0 unknown. mask: (H, W) bool of valid pixels."""
        light = luma(image, gamma)
        return Surface(camera, lambda: light, depth if mask is None else np.where(mask, depth, 0.0))

    def halved(self) -> Surface:
        """Half the size; depth is of every other pixel, since a mean of depths is on no surface."""
        width, height = self.camera.width // 2, self.camera.height // 2
        rows = ((np.arange(height) + 0.5) * self.depth.shape[0] / height).astype(np.int64)
        columns = ((np.arange(width) + 0.5) * self.depth.shape[1] / width).astype(np.int64)
        light = resize(self.photograph(), width, height)
        return Surface(self.camera.resized(width, height), lambda: light, self.depth[rows[:, None], columns])


def luma(image: np.ndarray, gamma: float) -> np.ndarray:
    """(H, W) float32, linear, of an encoded image (H, W, 3)."""
    return (decode(image, gamma) @ LUMA).astype(np.float32)


class _Own:
    """A surface while it is compared with its neighbours, and what of it all these comparisons need."""

    def __init__(self, surface: Surface):
        self.camera, self.depth, self.light = surface.camera, surface.depth, surface.photograph()

    @cached_property
    def texture(self) -> _Texture:
        """Of the photograph."""
        return _Texture.of(self.light)

    @cached_property
    def points(self) -> np.ndarray:
        """(H W, 3) what the pixels show, scene units; anything where depth is unknown."""
        height, width = self.depth.shape
        rows, columns = (grid.ravel() for grid in np.mgrid[:height, :width])
        z = self.depth.ravel().astype(np.float64)
        return self.camera.lifted(columns, rows, np.where(z > 0, z, 1.0))

    @cached_property
    def unevenness(self) -> np.ndarray:
        """At the patches: standard deviation of disparity, 1 / scene unit."""
        disparity = np.divide(1.0, self.depth, out=np.zeros(self.depth.shape), where=self.depth > 0)
        level, square = _windowed(disparity), _windowed(disparity**2)
        return np.asarray(np.sqrt(np.maximum(square - level**2, 0)))


def blur_pairs(surfaces: Sequence[Surface], extent: float) -> BlurPairs:
    """Compare every photograph with its neighbours. extent: of the disparity range, 1 / scene unit."""
    found, levels = [], list(surfaces)
    neighbours = [_neighbours(surfaces, index) for index in range(len(surfaces))]
    for level in range(LEVELS):
        if min(min(one.camera.width, one.camera.height) for one in levels) < SMALLEST:
            break
        noise = [_noise(one.photograph()) for one in levels]
        for first, others in enumerate(neighbours):
            own = _Own(levels[first])
            for second in others:
                rows = _compared(own, levels[second], (noise[first], noise[second]), extent)
                if rows is not None:
                    size = float(4**level)
                    q_first, q_second, zoom, difference, deviation = rows
                    index = np.full(len(zoom), first), np.full(len(zoom), second)
                    found.append((*index, q_first, q_second, zoom, size * difference, size * deviation))
        levels = [one.halved() for one in levels]
    columns = [np.concatenate(parts) for parts in zip(*found, strict=True)] if found else [np.zeros(0)] * 7
    return BlurPairs(columns[0].astype(np.int64), columns[1].astype(np.int64), *columns[2:])


def _neighbours(surfaces: Sequence[Surface], index: int) -> list[int]:
    """The views with the most of this view's surface in sight, within ANGLE."""
    own = surfaces[index]
    rows, columns = (grid.ravel() for grid in np.mgrid[4 : own.camera.height : 8, 4 : own.camera.width : 8])
    z = own.depth[rows, columns].astype(np.float64)
    points = own.camera.lifted(columns[z > 0], rows[z > 0], z[z > 0])
    shared = np.zeros(len(surfaces))
    for other, surface in enumerate(surfaces):
        if other != index and len(points):
            shared[other] = np.mean(_seen(own.camera, surface, points)[0])
    order = np.argsort(-shared, kind="stable")[:NEIGHBOURS]
    return [int(other) for other in order if shared[other] > SHARED]


def _seen(camera: Camera, other: Surface, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of points (P, 3) on a view's surface: whether the other view shows the same surface within ANGLE; where, (P, 2),
    px; and their z there."""
    xy, z = other.camera.project(points)
    seen = other.camera.inside(xy)
    at = np.where(seen[:, None], xy, 0).astype(np.int64)
    there = other.depth[at[:, 1], at[:, 0]]
    seen &= (there > 0) & (np.abs(there - z) < SAME * z)
    rays = [points - one.centre for one in (camera, other.camera)]
    rays = [ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-12) for ray in rays]
    return seen & ((rays[0] * rays[1]).sum(axis=1) > np.cos(np.radians(ANGLE))), xy, z


def _compared(own: _Own, other: Surface, noise: tuple[float, float], extent: float) -> tuple[np.ndarray, ...] | None:
    """(q_first, q_second, zoom, difference, deviation) of the patches of one pair at one size; None without any."""
    import cv2

    height, width = own.depth.shape
    z = own.depth.ravel().astype(np.float64)
    points = own.points
    seen, xy, z_other = _seen(own.camera, other, points)
    with np.errstate(divide="ignore", invalid="ignore"):
        zoom = (own.camera.fx / z) / (other.camera.fx / z_other)
    valid = (seen & (z > 0) & (zoom < ZOOM) & (zoom > 1 / ZOOM)).reshape(height, width)
    if not valid.any():
        return None
    at = np.where(np.isfinite(xy), xy - 0.5, -10).astype(np.float32).reshape(height, width, 2)
    warped = cv2.remap(other.photograph(), at[..., 0], at[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    mine, theirs = own.texture, _Texture.of(np.where(valid, warped, own.light))
    # A patch lies where its centre does, which may be one of the few pixels of unknown depth.
    centres = slice(STRIDE // 2, None, STRIDE), slice(STRIDE // 2, None, STRIDE)
    known = ((z > 0) & (z_other > 0)).reshape(height, width)[centres]
    whole = (_windowed(valid.astype(np.float32)) > WHOLE) & known
    together = _windowed(mine.fine * theirs.fine)
    alike = together > ALIKE * np.sqrt(np.maximum(mine.fine_energy * theirs.fine_energy, 1e-20))
    used = (own.unevenness < FLAT * extent) & whole & alike & (mine.mean > 0) & (theirs.mean > 0)
    if not used.any():
        return None
    # Exposure scales both energies and means.
    textures = mine, theirs
    own_energy, other_energy = (np.log(one.energies[:, used] / one.mean[used] ** 2) for one in textures)
    floors = [energy / one.mean[used] ** 2 for energy, one in zip(noise, textures, strict=True)]
    difference, slope, ok = _difference(own_energy, other_energy)
    noisy = [floor / np.exp(energy[0]) for floor, energy in zip(floors, (own_energy, other_energy), strict=True)]
    ok &= (noisy[0] < NOISIEST) & (noisy[1] < NOISIEST)
    if not ok.any():
        return None
    deviation = np.sqrt(SPREAD**2 + noisy[0] ** 2 + noisy[1] ** 2) / slope
    chosen = np.zeros(used.shape, bool)
    chosen[used] = ok
    near, far, larger = (values.reshape(height, width)[centres][chosen] for values in (z, z_other, zoom))
    return 1 / near, 1 / far, larger, difference[ok], deviation[ok]


def _difference(own: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(variance, px^2, positive where own is more blurred; fall of the log energy a px^2 there; whether in reach).

    own, other: (blurs, P) log energies of the patches, blurred by BLURS.
    """
    variances = np.square(BLURS)
    sharper = np.where(other[0] > own[0], other, own)  # (blurs, P)
    target = np.minimum(own[0], other[0])
    reach = sharper[-1] <= target
    place = np.clip((sharper >= target).sum(axis=0), 1, len(BLURS) - 1)  # energies fall with blur
    columns = np.arange(len(target))
    before, after = sharper[place - 1, columns], sharper[place, columns]
    step = variances[place] - variances[place - 1]
    fall = np.maximum(before - after, 1e-6)
    variance = variances[place - 1] + step * np.clip((before - target) / fall, 0, 1)
    return np.where(other[0] > own[0], variance, -variance), fall / step, reach


def _blurred(values: np.ndarray, deviation: float) -> np.ndarray:
    """Blurred by a Gaussian of this standard deviation, px."""
    import cv2

    reach = int(np.ceil(3.5 * deviation))
    side = 2 * reach + 1
    return np.asarray(cv2.GaussianBlur(values, (side, side), deviation, borderType=cv2.BORDER_REFLECT))


def _band(light: np.ndarray, blur: float) -> np.ndarray:
    """The band of the image blurred by a Gaussian of standard deviation `blur` px."""
    return _blurred(light, float(np.hypot(BAND[0], blur))) - _blurred(light, float(np.hypot(BAND[1], blur)))


def _windowed(values: np.ndarray) -> np.ndarray:
    """The means over the patches' windows."""
    return _blurred(values, WINDOW)[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]


@dataclass(frozen=True, eq=False)
class _Texture:
    """Of one image, at the patches: energies (blurs, ...) of the band after each blur, and the mean. fine: (H, W) the
    blurred image's band, and its energy at the patches."""

    energies: np.ndarray
    mean: np.ndarray
    fine: np.ndarray
    fine_energy: np.ndarray

    @staticmethod
    def of(light: np.ndarray) -> _Texture:
        fine = _band(light, COARSER)
        energies = np.array([_windowed(_band(light, blur) ** 2) for blur in BLURS])
        return _Texture(energies, _windowed(light), fine, _windowed(fine**2))


def _noise(light: np.ndarray) -> float:
    """Energy of the photograph's noise in the band."""
    return noise_deviation(light) ** 2 * _gain()


def _gain() -> float:
    """Energy of the band of white noise of variance 1."""
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1.0
    return float(np.sum(_band(impulse, 0.0) ** 2))
