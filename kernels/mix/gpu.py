"""`mix` on a GPU: float32, Triton. The weights, hundreds a pixel, are never in memory together."""

from __future__ import annotations

import torch

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 128
_CHANNELS = 4  # read together


def mix(image, logits, size):
    logits = logits.contiguous()
    groups = [_Mix.apply(channels.contiguous(), logits, size) for channels in image.split(_CHANNELS, dim=2)]
    return groups[0] if len(groups) == 1 else torch.cat(groups, dim=2)


class _Mix(torch.autograd.Function):
    @staticmethod
    def forward(context, image, logits, size):
        height, width, channels = image.shape
        options = {"SIZE": size, "CHANNELS": channels, "BLOCK": _BLOCK}
        grid = (-(-height * width // _BLOCK),)
        result = torch.empty_like(image)
        largest, total = (torch.empty(height, width, device=image.device) for _ in range(2))
        launch(kernels("mix.gpu_softmax").mixed, grid, image, logits, result, largest, total, height, width, **options)
        context.save_for_backward(image, logits, result, largest, total)
        context.options, context.grid = options, grid
        return result

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        softmax = kernels("mix.gpu_softmax")
        image, logits, result, largest, total = context.saved_tensors
        height, width, _ = image.shape
        gradient = gradient.contiguous()
        by_image, by_logits = torch.empty_like(image), torch.empty_like(logits)
        known = largest, total, gradient
        sizes = height, width
        launch(softmax.by_logits, context.grid, image, logits, result, *known, by_logits, *sizes, **context.options)
        launch(softmax.by_image, context.grid, logits, *known, by_image, *sizes, **context.options)
        return by_image, by_logits, None
