"""The definition of `mix`, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def mix(image: Tensor, logits: Tensor) -> Tensor:
    """(H, W, C): each pixel the mean of the K x K pixels around it, weighted by the softmax of its own logits.

    image: (H, W, C). logits: (H, W, K * K), K odd, row by row from the upper left neighbour to the lower right one.
    Beside the image everything is 0. Differentiable with respect to both (BAGS, Peng et al., ECCV 2024, Eq. 5).

    Raises ValueError for other shapes.
    """
    size = kernel_size(image, logits)
    height, width, channels = image.shape
    around = torch.nn.functional.unfold(image.permute(2, 0, 1)[None], size, padding=size // 2)
    patches = around.view(channels, size * size, height, width)
    return torch.einsum("ckhw,hwk->hwc", patches, torch.softmax(logits, 2))


def kernel_size(image: Tensor, logits: Tensor) -> int:
    """K. Raises ValueError for images and logits that don't fit."""
    if image.ndim != 3 or logits.ndim != 3 or image.shape[:2] != logits.shape[:2]:
        raise ValueError(f"logits: expected (H, W, K * K) for {tuple(image.shape)}, found {tuple(logits.shape)}")
    size = math.isqrt(logits.shape[2])
    if size * size != logits.shape[2] or size % 2 == 0:
        raise ValueError(f"logits: expected the square of an odd number for each pixel, found {logits.shape[2]}")
    return size
