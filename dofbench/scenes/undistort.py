"""Lens distortion models of camera files, and images without distortion.

Pixel centres are at half-integers, as in COLMAP; OpenCV has them at integers. So distortion is computed here in
float64, and `cv2.remap` gets the coordinates less one half.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dofbench.core.cameras import Calibration, Camera
from dofbench.core.errors import InputError

_NEWTON_STEPS = 30
# Largest error of an inverted distortion, normalised units; a millionth of a pixel at a focal length of 10 000.
_INVERTED = 1e-10
_BAND = 256


# Of an image's longer side: the focal length of a fisheye that sees all around is a sixth; a telescope's a hundred. A
# principal point is off the image only in parts of one.
_SHORTEST, _LONGEST, _FARTHEST = 0.02, 1e4, 20
# Pixels: in larger images a principal point within a pixel of the edge is no number of pixels.
_TINY = 4


@dataclass(frozen=True)
class Intrinsics(Calibration):
    """A camera without pose, with distortion, which has no unit: it stays at another number of pixels.

    distortion: in OpenCV's order, `k1 k2 p1 p2 k3 k4 k5 k6` (missing ones are 0), or with fisheye `k1 k2 k3 k4`.
    """

    distortion: tuple[float, ...] = ()
    fisheye: bool = False

    @property
    def distorted(self) -> bool:
        """Whether the image differs from a pinhole's."""
        return self.fisheye or any(self.distortion)

    def check_proportions(self, subject: object, which: str) -> None:
        """Raise InputError about `subject`, the file, for a focal length or principal point out of all proportion to
        the image of view `which`."""
        side = max(self.width, self.height)
        if not _SHORTEST * side <= min(self.fx, self.fy) <= max(self.fx, self.fy) <= _LONGEST * side:
            found = f"focal lengths {self.fx:g}, {self.fy:g} px for {which}"
            raise InputError(subject, found, f"{_SHORTEST * side:g} to {_LONGEST * side:g} px ({side} px is a side)")
        if not max(abs(self.cx), abs(self.cy)) <= _FARTHEST * side:
            found = f"a principal point of {self.cx:g}, {self.cy:g} px for {which}"
            raise InputError(subject, found, f"{_FARTHEST * side:g} px at most ({side} px is a side)")
        if min(self.width, self.height) > _TINY and min(abs(self.cx), abs(self.cy)) <= 1:
            size = f"{self.width}x{self.height}"
            found = f"a principal point of {self.cx:g}, {self.cy:g} px for {which}, whose image is {size}"
            shares = f"{self.cx * self.width:g}, {self.cy * self.height:g}"
            raise InputError(subject, found, f"pixels (were these shares of the image, {shares})")

    @property
    def off_centre(self) -> bool:
        """Whether the principal point lies outside of the middle half of the image, across or down."""
        return abs(self.cx / self.width - 0.5) > 0.25 or abs(self.cy / self.height - 0.5) > 0.25

    def camera(self, world_to_camera: np.ndarray) -> Camera:
        """The pinhole camera at a pose; ValueError while there is distortion."""
        if self.distorted:
            raise ValueError("a distorted camera has no pinhole; take undistorted() first")
        return Camera(self.width, self.height, *self.parameters, world_to_camera)


def distort(intrinsics: Intrinsics, xy: np.ndarray) -> np.ndarray:
    """Distort rays (..., 2), `x/z, y/z`; returns normalised coordinates (..., 2).

    Perspective: Brown's radial and tangential terms with the rational denominator, as OpenCV and COLMAP's FULL_OPENCV.
    Fisheye: Kannala and Brandt 2006, `theta + k1 theta^3 + ...`.
    """
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    if intrinsics.fisheye:
        k = (*intrinsics.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        # bent / r goes to 1 on the axis, where it would be 0 / 0.
        scale = np.where(r > 1e-9, bent / np.where(r > 1e-9, r, 1.0), 1.0)
        return np.stack([x * scale, y * scale], axis=-1)
    k1, k2, p1, p2, k3, k4, k5, k6 = (*intrinsics.distortion, *(0.0,) * 8)[:8]
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    across = 2 * x * y
    return np.stack(
        [x * radial + p1 * across + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + p2 * across], axis=-1
    )


def _jacobian(intrinsics: Intrinsics, xy: np.ndarray) -> np.ndarray:
    """(..., 2, 2) derivative of `distort` by central differences."""
    step = 1e-6
    columns = [
        (distort(intrinsics, xy + offset) - distort(intrinsics, xy - offset)) / (2 * step)
        for offset in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    return np.stack(columns, axis=-1)


def undistort_points(intrinsics: Intrinsics, pixels: np.ndarray) -> np.ndarray:
    """Rays (P, 2) `x/z, y/z` that land at image coordinates (P, 2): Newton's method on `distort`.

    Raises InputError where the distortion can't be inverted (it folds the image over).
    """
    target = np.stack(intrinsics.rays(pixels[:, 0], pixels[:, 1]), axis=1)
    rays = target.copy()
    if not intrinsics.distorted:
        return rays
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            missing = target - distort(intrinsics, rays)
            if np.abs(missing).max() < 0.01 * _INVERTED:
                break
            matrix = _jacobian(intrinsics, rays)
            determinant = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
            rays[:, 0] += (matrix[:, 1, 1] * missing[:, 0] - matrix[:, 0, 1] * missing[:, 1]) / determinant
            rays[:, 1] += (matrix[:, 0, 0] * missing[:, 1] - matrix[:, 1, 0] * missing[:, 0]) / determinant
        missing = np.abs(target - distort(intrinsics, rays))
        folded = ~(np.linalg.det(_jacobian(intrinsics, rays)) > 0) | ~(missing.max(axis=1) < _INVERTED)
    if folded.any():
        found = f"distortion {list(intrinsics.distortion)}, which folds {folded.mean():.0%} of the tested pixels over"
        raise InputError("camera", found, "distortion that can be undone over the whole image")
    return rays


@lru_cache(maxsize=256)
def undistorted(intrinsics: Intrinsics) -> Intrinsics:
    """The pinhole of the same image size that shows no pixel from outside the distorted image.

    Like `alpha = 0` of OpenCV's getOptimalNewCameraMatrix, but the border is traced pixel by pixel, and fx : fy is kept
    (a lens blurs to a disc on square pixels only). The principal point moves no more than it must. Raises InputError if
    distortion can't be undone.
    """
    if not intrinsics.distorted:
        return intrinsics
    width, height = intrinsics.width, intrinsics.height
    across, down = np.arange(width) + 0.5, np.arange(height) + 0.5

    def side(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        return undistort_points(intrinsics, np.stack(np.broadcast_arrays(x, y), axis=-1).astype(np.float64))

    left, right = side(0.5, down)[:, 0].max(), side(width - 0.5, down)[:, 0].min()
    top, bottom = side(across, 0.5)[:, 1].max(), side(across, height - 0.5)[:, 1].min()
    # The inside must be free of folds as well; a coarse grid is enough for polynomials of this degree.
    grid = np.stack(np.meshgrid(across[:: max(1, width // 16)], down[:: max(1, height // 16)]), axis=-1)
    undistort_points(intrinsics, grid.reshape(-1, 2))
    if not (left < right and top < bottom):
        found = f"distortion {list(intrinsics.distortion)}, which leaves no rectangle"
        raise InputError("camera", found, "distortion that leaves a part of the image without borders")
    scale = float(max((width - 1) / (intrinsics.fx * (right - left)), (height - 1) / (intrinsics.fy * (bottom - top))))
    fx, fy = intrinsics.fx * scale, intrinsics.fy * scale
    # Pixel centres 0.5 and width - 0.5 must see rays in [left, right].
    cx = float(np.clip(intrinsics.cx, width - 0.5 - fx * right, 0.5 - fx * left))
    cy = float(np.clip(intrinsics.cy, height - 0.5 - fy * bottom, 0.5 - fy * top))
    return Intrinsics(width, height, fx, fy, cx, cy)


@lru_cache(maxsize=1)
def source_coordinates(intrinsics: Intrinsics, target: Intrinsics) -> np.ndarray:
    """Where the distorted image shows every pixel centre of the pinhole `target`: (H, W, 2) float32, pixels. The last
    answer is cached, as views nearly always share their lens."""
    if target.distorted:
        raise ValueError("target must be a pinhole")
    x, y = target.rays(np.arange(target.width) + 0.5, np.arange(target.height) + 0.5)
    coordinates = np.empty((target.height, target.width, 2), dtype=np.float32)
    # By bands of rows: float64 intermediates of a whole photograph would take a gigabyte.
    for start in range(0, target.height, _BAND):
        bent = distort(intrinsics, np.stack(np.meshgrid(x, y[start : start + _BAND]), axis=-1))
        bent *= (intrinsics.fx, intrinsics.fy)
        bent += (intrinsics.cx, intrinsics.cy)
        coordinates[start : start + _BAND] = bent
    coordinates.setflags(write=False)
    return coordinates


def undistort_image(image: np.ndarray, intrinsics: Intrinsics, *, light: bool = False) -> np.ndarray:
    """Image (H, W, 3) float32 at the intrinsics' size, as `undistorted(intrinsics)` would have taken it.

    Lanczos with 8 x 8 samples, because bilinear sampling blurs unevenly; overshoot is clipped to each channel's range.
    light: linear light, sampled bilinearly, because Lanczos leaves bright rings around highlights.
    """
    import cv2

    if not intrinsics.distorted:
        return image
    coordinates = source_coordinates(intrinsics, undistorted(intrinsics)) - np.float32(0.5)
    x, y = np.ascontiguousarray(coordinates.transpose(2, 0, 1))
    samples = cv2.INTER_LINEAR if light else cv2.INTER_LANCZOS4
    straight = cv2.remap(image, x, y, samples, borderMode=cv2.BORDER_REPLICATE)
    return np.clip(straight, image.min(axis=(0, 1)), image.max(axis=(0, 1)))


def sample_depth(depth: np.ndarray, intrinsics: Intrinsics, target: Intrinsics) -> np.ndarray:
    """Sample a depth map (h, w) of the distorted lens, of any size, at the pixel centres of the pinhole `target`: (H,
    W).

    Nearest, since averages of near and far, or of depth and "unknown", lie where nothing is.
    """
    source = intrinsics.resized(depth.shape[1], depth.shape[0])
    nearest = np.floor(source_coordinates(source, target)).astype(np.int64)
    # By construction only rounding can lead outside, by less than a pixel.
    column, row = np.clip(nearest, 0, (depth.shape[1] - 1, depth.shape[0] - 1)).transpose(2, 0, 1)
    return np.ascontiguousarray(depth[row, column])
