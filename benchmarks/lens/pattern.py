"""The constants of `dofbench/training/gaussians/lens_pattern.py`, computed again.

    python -m benchmarks.lens.pattern

For patterns of one and of five lens points, the ring's radius and the cell's variance whose transfer function is
nearest to a disc's, at several radii of the disc; and the scale at which a single cell that has the disc's variance is
nearest, which is the bias of an aperture that is learned through it. Prints a table; takes a few seconds.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize
from scipy.special import j1

DIRECTIONS = np.linspace(0, np.pi, 18, endpoint=False)
FREQUENCIES = np.geomspace(0.02, np.pi, 160)  # radians a pixel, up to the finest that pixels hold
_BOX = np.sinc(FREQUENCIES / (2 * np.pi)) ** 2  # a pixel's own blur, squared
_POWER = _BOX / FREQUENCIES  # of a photograph whose amplitudes fall as 1 / frequency, over all directions


def ring(points: int) -> np.ndarray:
    """(P, 2) points on the unit circle."""
    angles = 2 * np.pi * np.arange(points) / points
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def mismatch(points: np.ndarray, cell: float, radius: float, scale: float = 1.0) -> float:
    """Energy of the difference between a disc of `radius` pixels and the pattern, drawn `scale` times as large.

    points: (P, 2) on the unit lens. cell: variance of each one's Gaussian, in units of radius squared.
    """
    reach = FREQUENCIES * radius
    waves = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)], axis=1) @ points.T
    phases = np.exp(-1j * scale * reach[:, None, None] * waves).mean(axis=2)
    pattern = phases * np.exp(-((scale * reach) ** 2) * cell / 2)[:, None]
    disc = 2 * j1(reach) / reach
    return float(np.trapezoid((np.abs(pattern - disc[:, None]) ** 2).mean(axis=1) * _POWER, FREQUENCIES))


def main() -> None:
    """Print the table."""
    centre, five = np.zeros((1, 2)), ring(5)
    print("radius px | one: cell, mismatch | five: ring, cell, mismatch | best scale of one cell of variance 1/4")
    for radius in (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 8.0, 40.0):
        one = minimize(lambda x, r=radius: mismatch(centre, x[0], r), [0.3], method="Nelder-Mead")
        many = minimize(lambda x, r=radius: mismatch(x[0] * five, x[1], r), [0.6, 0.08], method="Nelder-Mead")
        scale = minimize(lambda x, r=radius: mismatch(centre, 0.25, r, x[0]), [1.0], method="Nelder-Mead")
        print(
            f"{radius:9.1f} | {one.x[0]:.3f} {one.fun:.1e} | {many.x[0]:.3f} {many.x[1]:.4f} {many.fun:.1e} | "
            f"{scale.x[0]:.3f}"
        )


if __name__ == "__main__":
    main()
