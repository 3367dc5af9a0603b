"""What poses say of themselves where no sparse points check them: one position, axes or matrices of another convention.

Cameras that look at a subject have optical axes that meet in front of them. Where they meet behind, or don't meet but
would if the matrices were inverted, the file may be of another convention than its layout's.
"""

from __future__ import annotations

import numpy as np

from dofbench.scenes.readers.poses import invert
from dofbench.scenes.scene import Scene

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
    """What to say to whoever reads a scene whose poses no points check; empty where there are points. It is said on the
    terminal alone, and not recorded: nothing was chosen, changed or skipped."""
    return "" if scene.points is not None and len(scene.points) else _UNCHECKED


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
    """What to say where the cameras look at a subject if their matrices are world-to-camera ones, with OpenGL's axes or
    OpenCV's; else nothing. poses: world-to-camera as read, (N, 4, 4), OpenCV axes."""
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
