"""Noise of the camera's sensor: shot and read noise, the same for each pixel whenever it is drawn again."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sensor:
    """Noise of a sensor, in linear light whose full scale is 1.

    photons: number that a pixel at full scale collects, 0 for no shot noise. read_noise: standard deviation of the
    noise that doesn't depend on the signal. seed: seed of the random numbers. Raises ValueError for a negative or
    non-finite number.

    The variance at a signal x is x / photons + read_noise**2: the Gaussian approximation of shot noise (Foi et al.,
    Practical Poissonian-Gaussian Noise Modeling and Fitting, 2008, Eq. 4).
    """

    photons: float = 0.0
    read_noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in (("photons", self.photons), ("read_noise", self.read_noise)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: expected a number from 0 on, found {value}")

    @property
    def is_noisy(self) -> bool:
        """Whether the sensor adds any noise."""
        return self.photons > 0 or self.read_noise > 0

    def standard_noise(self, view: str, shape: tuple[int, ...]) -> np.ndarray:
        """Standard normal numbers of `shape`, float32, for a view's photograph; they depend on seed, name and shape
        alone."""
        digest = hashlib.sha256(f"{self.seed}/{view}".encode()).digest()
        generator = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))
        return generator.standard_normal(shape).astype(np.float32)

    def expose(self, linear: np.ndarray, standard_noise: np.ndarray) -> np.ndarray:
        """Linear light with noise added, cut at 0, since a sensor counts no negative light.

        linear: any shape; standard_noise: of the same shape, as `standard_noise` gives it.
        """
        variance = self.read_noise**2
        if self.photons > 0:
            variance = variance + np.maximum(linear, 0) / self.photons
        return np.maximum(linear + np.sqrt(variance).astype(linear.dtype) * standard_noise, 0)
