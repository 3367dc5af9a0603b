"""Small inputs of cases: images with disparity, Gaussians in front of a camera. All numbers are exact in float32."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dofbench.core.cameras import Camera

HEIGHT, WIDTH = 16, 20  # of images; small, because the weights of all pairs of pixels are computed
VIEW_HEIGHT, VIEW_WIDTH = 24, 32  # size of a camera's image


def picture(height: int = HEIGHT, width: int = WIDTH, channels: int = 3, seed: int = 0) -> np.ndarray:
    """An image of random light between 0.05 and 1, (H, W, C) float32."""
    return np.random.default_rng(seed).uniform(0.05, 1, (height, width, channels)).astype(np.float32)


def by_size(*sizes: tuple[int, int]) -> dict[str, tuple[int, int]]:
    """Sizes (H, W) by their label, width x height."""
    return {f"{width}x{height}": (height, width) for height, width in sizes}


def disparity(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Normalised disparity, (H, W) float32, 0 ... 1: a slanted background behind a step."""
    y, x = np.mgrid[:height, :width] / max(height, width, 2)
    values = np.where(x > 0.55, 0.7 + 0.3 * y, 0.35 * (x + y))
    return values.astype(np.float32)


def radii(focus: float, radius: float = 10.0, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Signed radii, (H, W) float32 pixels, of `disparity` through a lens of `radius` pixels per unit."""
    return (np.float32(radius) * (disparity(height, width) - np.float32(focus))).astype(np.float32)


def camera(width: int = VIEW_WIDTH, height: int = VIEW_HEIGHT, *, turned: float = 0.1) -> Camera:
    """A camera near the origin along z, turned by `turned` radians, with an off-centre principal point."""
    pose = np.eye(4)
    pose[0, 0], pose[0, 2] = math.cos(turned), math.sin(turned)
    pose[2, 0], pose[2, 2] = -math.sin(turned), math.cos(turned)
    pose[:3, 3] = (0.1, 0.05, 0.2) if turned else (0.0, 0.0, 0.0)
    return Camera(width, height, 1.1 * VIEW_WIDTH, 1.2 * VIEW_WIDTH, 0.45 * width, 0.55 * height, pose)


def straight(width: int = VIEW_WIDTH, height: int = VIEW_HEIGHT) -> Camera:
    """A camera at the origin along z with square pixels and a centred principal point."""
    return Camera(width, height, float(VIEW_WIDTH), float(VIEW_WIDTH), width / 2, height / 2, np.eye(4))


def gaussians(
    count: int = 40, seed: int = 1, *, depth: float = 4.0, log_scale: float = -2.0, rest: int = 3
) -> dict[str, np.ndarray]:
    """Random Gaussians around `depth` in front of the camera, as the rasteriser's six arguments, float32."""
    random = np.random.default_rng(seed)
    made = {
        "means": random.normal(size=(count, 3)) * (0.8, 0.6, 0.4) + (0.0, 0.0, depth),
        "log_scales": random.normal(size=(count, 3)) * 0.4 + log_scale,
        "quaternions": random.normal(size=(count, 4)),
        "opacity_logits": random.normal(size=count),
        "sh_dc": random.uniform(-1, 1, (count, 3)),
        "sh_rest": random.normal(size=(count, rest, 3)) * 0.2,
    }
    return {name: value.astype(np.float32) for name, value in made.items()}


def harmonic(colour: np.ndarray | Sequence[float] | float) -> np.ndarray:
    """The coefficient of the constant spherical harmonic for this colour."""
    return (np.asarray(colour) - 0.5) * 2 * math.sqrt(math.pi)


def single(
    *,
    mean: tuple[float, float, float] = (0.0, 0.0, 4.0),
    scale: float | tuple[float, float, float] = 0.1,
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    logit: float = 0.0,
    colour: tuple[float, float, float] = (0.9, 0.5, 0.2),
) -> dict[str, np.ndarray]:
    """One Gaussian of one colour. scale: scene units; quaternion: w first."""
    made = {
        "means": [mean],
        "log_scales": [np.log(np.broadcast_to(scale, 3))],
        "quaternions": [quaternion],
        "opacity_logits": [logit],
        "sh_dc": [harmonic(colour)],
        "sh_rest": np.zeros((1, 0, 3)),
    }
    return {name: np.array(value, dtype=np.float32) for name, value in made.items()}


def together(*parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Several scenes as one, in this order."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
