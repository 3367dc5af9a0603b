"""The colour transform on a GPU: float32, Triton, one autograd function."""

from __future__ import annotations

import torch
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 512


def colours(image, change):
    return _Colours.apply(image.contiguous(), change.contiguous())


class _Colours(torch.autograd.Function):
    @staticmethod
    def forward(context, image, change):
        result, pixels = torch.empty_like(image), image.numel() // 3
        context.save_for_backward(image, change)
        launch(kernels("colours.gpu_affine").changed, _grid(pixels), image, change, result, pixels, BLOCK=_BLOCK)
        return result

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        image, change = context.saved_tensors
        pixels = image.numel() // 3
        grid, result = _grid(pixels), torch.empty_like(image)
        sums = image.new_empty(*grid, 3, 4)
        call = gradient.contiguous(), image, change, result, sums, pixels
        launch(kernels("colours.gpu_affine").gradient, grid, *call, BLOCK=_BLOCK)
        return result, sums.sum(0)


def _grid(pixels: int) -> tuple[int]:
    return (-(-pixels // _BLOCK),)
