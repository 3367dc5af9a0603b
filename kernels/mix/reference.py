"""The definition of `mix`, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def mix(image: Tensor, logits: Tensor, size: int) -> Tensor:
    height, width, channels = image.shape
    around = torch.nn.functional.unfold(image.permute(2, 0, 1)[None], size, padding=size // 2)
    patches = around.view(channels, size * size, height, width)
    return torch.einsum("ckhw,hwk->hwc", patches, torch.softmax(logits, 2))
