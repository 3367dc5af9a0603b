"""Blur with a kernel for every pixel (BAGS, Peng et al., ECCV 2024, Eq. 5)."""

from __future__ import annotations

import math

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["mix"]


def mix(image: Tensor, logits: Tensor, *, backend: str = AUTO) -> Tensor:
    """(H, W, C): each pixel the mean of the K x K pixels around it, weighted by the softmax of its own logits.

    image: (H, W, C), 0 outside. logits: (H, W, K * K), K odd, row by row from the upper left neighbour to the lower
    right one. Differentiable with respect to both. Raises ValueError for other shapes.
    """
    if image.ndim != 3 or logits.ndim != 3 or image.shape[:2] != logits.shape[:2]:
        raise ValueError(f"logits: expected (H, W, K * K) for {tuple(image.shape)}, found {tuple(logits.shape)}")
    size = math.isqrt(logits.shape[2])
    if size * size != logits.shape[2] or size % 2 == 0:
        raise ValueError(f"logits: expected the square of an odd number for each pixel, found {logits.shape[2]}")
    return implementation("mix", backend, image=image, logits=logits).mix(image, logits, size)
