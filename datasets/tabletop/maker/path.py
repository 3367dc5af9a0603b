"""The camera path: a forward-facing spiral of hand-held views that all look at about the middle of the table."""

from __future__ import annotations

import numpy as np

from dofbench.cameras import Camera

# Pixels of focal length per pixel of width: about 60 degrees across, like a phone's main camera.
FOCAL = 0.875
EYE = np.array([0.0, 0.0, 1.12])
TARGET = np.array([0.0, 3.4, 0.52])
# Half-extents of the path (right, forward, up): 20 views span 0.53 units, 16 % of the distance to the middle.
EXTENT = np.array([0.30, 0.05, 0.20])
ROLL_DEGREES = 1.5
AIM = 0.06


def cameras(count: int, width: int, height: int, seed: int) -> list[Camera]:
    """`count` pinhole cameras. Positions follow a sunflower spiral, so every prefix and every stride of it covers
    the same ellipse and no test view lies far outside the training views.
    """
    rng = np.random.default_rng([seed, 1])
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    angle = index * np.pi * (3 - np.sqrt(5))
    across = np.stack([radius * np.cos(angle), rng.uniform(-1, 1, count), radius * np.sin(angle)], axis=1)
    eyes = EYE + EXTENT * (across + rng.uniform(-0.05, 0.05, (count, 3)))
    targets = TARGET + rng.uniform(-AIM, AIM, (count, 3))
    rolls = np.radians(rng.uniform(-ROLL_DEGREES, ROLL_DEGREES, count))
    focal = FOCAL * width
    return [
        Camera(width, height, focal, focal, width / 2, height / 2, _look(eye, target, roll))
        for eye, target, roll in zip(eyes, targets, rolls, strict=True)
    ]


def _look(eye: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """(4, 4) world to camera, OpenCV axes, the world's z upwards in the picture but for `roll` radians."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    pose = np.eye(4)
    pose[:3, :3] = [right, down, forward]
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose
