"""Check poses, and convert the axes of LLFF and OpenGL to OpenCV's."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.scenes.light_field.grid import LIGHT_FIELD
from dofbench.scenes.scene import Scene

# Text files keep five or six digits of a rotation. What is farther from a rotation than this is worth a note.
_RIGID = 1e-4
# Three digits leave the products of columns off by 2 * 0.0005 * sqrt(3) at most. What is farther off is no rounding.
_ROUNDED = 2e-3
# A rotation nearer than this is left as it is, so that exact files are read exactly.
_EXACT = 1e-12

# Columns of a camera-to-world rotation, from OpenGL's (right, up, backwards) to OpenCV's (right, down, forward).
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass
class Mended:
    """Repairs of the poses of a file. off: of rounded rotations, the error of their columns' products. scales: of
    scaled rotations."""

    off: list[float] = field(default_factory=list)
    scales: list[float] = field(default_factory=list)

    def notes(self, file: Path) -> tuple[str, ...]:
        """A line for either, for `Scene.noted`."""
        notes = []
        if self.off:
            count, off = len(self.off), max(self.off)
            notes.append(
                f"rounded rotations in {file.name} ({count}, off by up to {off:.1g}): the nearest ones are read"
            )
        if self.scales:
            least, most = min(self.scales), max(self.scales)
            scale = f"{least:.4g}" if most - least <= _ROUNDED * most else f"{least:.4g} to {most:.4g}"
            notes.append(f"scaled rotations in {file.name} ({len(self.scales)}, scale {scale}): it is divided out")
        return tuple(notes)


def rigid(matrix: np.ndarray, subject: object, which: str, mended: Mended | None = None) -> np.ndarray:
    """Check a (3, 4) or (4, 4) pose and return it as (4, 4) float64 with an exact rotation.

    Rotations rounded by a text file are replaced by the nearest exact one. mended: collects, where given, further
    repairs: rotations of three digits, and a common scale, which is divided out. Raises InputError about `subject` (the
    file) and `which` (the view) for NaN, other scales, shear, reflection.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise InputError(subject, f"a pose of shape {matrix.shape} for {which}", "shape (3, 4) or (4, 4)")
    if not np.isfinite(matrix).all():
        raise InputError(subject, f"a pose with NaN or infinity for {which}", "finite numbers")
    if matrix.shape == (4, 4) and np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > _RIGID:
        raise InputError(subject, f"last row {matrix[3].tolist()} in the pose of {which}", "0 0 0 1")
    pose = np.eye(4)
    pose[:3] = matrix[:3]
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        away = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if away > _RIGID and mended is not None:
        rotation, away = _rounded_or_scaled(rotation, away, mended)
        pose[:3, :3] = rotation
    if away > (_RIGID if mended is None else _ROUNDED):
        raise InputError(subject, f"a pose that is no rotation (off by {away:.2g}) for {which}", "orthonormal columns")
    if np.linalg.det(rotation) < 0:
        raise InputError(subject, f"a mirrored pose for {which}", "a rotation with determinant +1")
    if away > _EXACT:
        left, _, right = np.linalg.svd(rotation)
        pose[:3, :3] = left @ right
    return pose


def _rounded_or_scaled(rotation: np.ndarray, away: float, mended: Mended) -> tuple[np.ndarray, float]:
    """The (3, 3) rotation without a common scale, and its error; the repair is added to `mended`."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        scale = np.sqrt(np.sum(rotation**2) / 3)
        unscaled = rotation / scale
        off = np.abs(unscaled.T @ unscaled - np.eye(3)).max()
    if not off <= _ROUNDED or np.linalg.det(unscaled) < 0:
        return rotation, away
    if away > _ROUNDED:
        mended.scales.append(float(scale))
        return unscaled, off
    mended.off.append(float(away))
    return rotation, away


def invert(pose: np.ndarray) -> np.ndarray:
    """(4, 4) inverse of a rigid (4, 4) pose, without the rounding of a general inverse."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def llff_to_opencv(pose: np.ndarray) -> np.ndarray:
    """Camera-to-world (3, 4) with columns (down, right, backwards, position) to (right, down, forward, position)."""
    return np.stack([pose[:, 1], pose[:, 0], -pose[:, 2], pose[:, 3]], axis=1)


def opencv_to_llff(pose: np.ndarray) -> np.ndarray:
    """Inverse of `llff_to_opencv`, for the first three rows of a camera-to-world matrix."""
    return np.stack([pose[:3, 1], pose[:3, 0], -pose[:3, 2], pose[:3, 3]], axis=1)


def opengl_to_opencv(pose: np.ndarray) -> np.ndarray:
    """Camera-to-world (4, 4) with OpenGL camera axes to OpenCV's; the same function is its inverse."""
    return pose @ _OPENGL


# Of positions, relative to their distance from the origin: what float32 rounds.
_ONE_PLACE = 1e-6
# Of entries of rotations.
_ONE_TURN = 1e-6
# Fewer axes meet by chance. Smallest eigenvalue of the mean of I - d d^T, the squared sine of the axes' spread: below,
# the axes are as good as parallel and meet anywhere.
_LEAST, _SPREAD = 4, 0.03
# Cameras look at a point if their axes pass it within this angle, and at a subject if so many of them do.
_COSINE, _MOST = float(np.cos(np.radians(20.0))), 0.9
_UNCHECKED = "poses are not checked: no sparse points"


def checked_poses(scene: Scene) -> Scene:
    """The scene with notes on poses that look wrong."""
    poses = np.stack([view.camera.world_to_camera for view in scene.views])
    to_world = np.stack([invert(pose) for pose in poses])
    notes: tuple[str, ...] = ()
    if len(poses) > 1 and _one_place(to_world[:, :3, 3]):
        still = np.abs(poses - poses[0])[:, :3, :3].max() <= _ONE_TURN
        one = "have one pose" if still else "are at one position"
        notes = (f"all {len(poses)} cameras {one}: nothing is seen from two places", _inverted(poses))
    elif unchecked(scene):
        notes = (_convention(poses, to_world),)
    return scene.noted(*notes)


def unchecked(scene: Scene) -> str:
    """A remark, for the terminal alone, on a scene without points to check its poses; empty where there are points,
    and for a light field, whose cameras are a fit to its images."""
    checked = (scene.points is not None and len(scene.points)) or scene.layout == LIGHT_FIELD
    return "" if checked else _UNCHECKED


def _one_place(centres: np.ndarray) -> bool:
    return bool(np.abs(centres - centres[0]).max() <= _ONE_PLACE * np.abs(centres).max())


def _convention(poses: np.ndarray, to_world: np.ndarray) -> str:
    if len(poses) < _LEAST or _looking_at(to_world, 1.0):
        return ""
    if _looking_at(to_world, -1.0):
        return (
            "optical axes meet behind the cameras: they look outwards, or the axes are flipped (OpenCV's for OpenGL's)"
        )
    return _inverted(poses)


def _inverted(poses: np.ndarray) -> str:
    """A note where cameras would look at a subject if their matrices (OpenGL's or OpenCV's axes) were inverted.

    poses: world-to-camera as read, (N, 4, 4), OpenCV axes.
    """
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    # As the file has it, an OpenGL camera-to-world matrix is invert(pose) @ flip; as a world-to-camera one of OpenGL's
    # axes, its inverse is flip @ pose, whose columns are turned back for OpenCV's.
    for turned in (flip @ poses @ flip, flip @ poses, poses):
        if len(poses) >= _LEAST and _looking_at(turned, 1.0):
            return "optical axes would meet if the matrices were world-to-camera ones: they may be inverted"
    return ""


def _looking_at(to_world: np.ndarray, sign: float) -> bool:
    """Whether cameras (N, 4, 4), OpenCV axes, look at one point along their axes; sign -1: against them."""
    centres, axes = to_world[:, :3, 3], sign * to_world[:, :3, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    mean = across.mean(axis=0)
    if np.linalg.eigvalsh(mean)[0] < _SPREAD:
        return False
    point = np.linalg.solve(mean, np.einsum("nij,nj->i", across, centres) / len(centres))
    ahead = point - centres
    along = np.einsum("ni,ni->n", axes, ahead)
    return bool((along > _COSINE * np.linalg.norm(ahead, axis=1)).mean() >= _MOST)
