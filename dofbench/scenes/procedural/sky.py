"""Skies: radiance at infinity as a map of all directions."""

from __future__ import annotations

import numpy as np

from dofbench.scenes.procedural.textures import fractal


def directions(height: int) -> np.ndarray:
    """(height, 2 height, 3) unit vectors of a sky map's pixels: first row the zenith, columns from x through y."""
    polar = (np.arange(height) + 0.5)[:, None] / height * np.pi
    around = (np.arange(2 * height) + 0.5)[None, :] / height * np.pi
    return np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) * np.ones_like(around)], axis=-1
    )


def cloudy(rng: np.random.Generator, sun: tuple[float, float, float], height: int = 512) -> np.ndarray:
    """Blue with clouds, brighter towards the horizon and the sun; (height, 2 height, 3) linear, float32.

    sun: direction; the map has only the sun's glow, since a disc of half a degree is better rendered as a lamp.
    """
    way = directions(height)
    up = np.clip(way[..., 2], 0, 1)
    towards = np.clip(way @ (np.asarray(sun) / np.linalg.norm(sun)), 0, 1)
    blue = np.array([0.16, 0.34, 0.85]) * (0.55 + 0.25 * (1 - up[..., None]))
    haze = np.array([0.85, 0.88, 0.92]) * np.exp(-6 * up)[..., None]
    cover = fractal(rng, height, 2 * height, 1.7) + 0.35 * fractal(rng, height, 2 * height, 1.1)
    cloud = np.clip(0.9 * cover - 0.1, 0, 1)[..., None] * np.clip(3 * up, 0, 1)[..., None]
    sky = (blue * (1 - 0.6 * haze) + haze) * (1 - cloud) + cloud * np.array([1.0, 0.98, 0.96])
    sky = sky + (0.6 * towards**12 + 4.0 * towards**400)[..., None] * np.array([1.0, 0.85, 0.6])
    below = np.array([0.20, 0.22, 0.16])
    return np.where(way[..., 2:] > 0, sky, below).astype(np.float32)


def night(rng: np.random.Generator, height: int = 256) -> np.ndarray:
    """Deep blue, paler at the horizon; (height, 2 height, 3) linear, float32."""
    way = directions(height)
    up = np.clip(way[..., 2:], 0, 1)
    glow = np.exp(-5 * up) * np.array([0.060, 0.045, 0.055])
    cloud = np.clip(fractal(rng, height, 2 * height, 1.6), 0, 2)[..., None] * 0.004
    return (np.array([0.012, 0.016, 0.030]) + glow + cloud).astype(np.float32)
