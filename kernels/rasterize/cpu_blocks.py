"""How Gaussians are divided: into blocks of eight, the last filled up with zeros, and chunks of blocks for threads."""

from __future__ import annotations

import numpy as np
from numba import njit

from dofbench.runtime.simd import LANES

# Number of parts into which the Gaussians are divided for threads: enough for many threads, with negligible overhead.
CHUNKS = 64


@njit(error_model="numpy")
def tail_of(array, n):
    """The rows of a flat array of n rows after the last full block of eight, padded with zeros to eight."""
    width = array.size // n if n > 0 else 0
    padded = np.zeros(LANES * width, np.float32)
    start = n // LANES * LANES * width
    for k in range(start, n * width):
        padded[k - start] = array[k]
    return padded


@njit(error_model="numpy")
def tails_of(means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest, filter_3d, blur, margin):
    """The last, incomplete block of every input."""
    n = opacity_logits.size
    return (
        tail_of(means, n),
        tail_of(log_scales, n),
        tail_of(quaternions, n),
        tail_of(opacity_logits, n),
        tail_of(sh_dc, n),
        tail_of(sh_rest, n),
        tail_of(filter_3d, n),
        tail_of(blur, n),
        tail_of(margin, n),
    )
