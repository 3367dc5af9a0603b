"""The colour transform on the CPU: float32, numba, one autograd function."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange
from torch.autograd.function import once_differentiable

from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend, internal

from . import op

_PIECE = 2048  # pixels a task, whatever the number of threads, so that sums have the same bits


def colours(image, change):
    return _Colours.apply(image, change)


class _Colours(torch.autograd.Function):
    @staticmethod
    def forward(context, image, change):
        context.call = (
            image.detach().contiguous().numpy().reshape(-1, 3),
            change.detach().contiguous().numpy(),
            image.shape,
        )
        pixels, matrix, shape = context.call
        return torch.from_numpy(_changed(pixels, matrix)).reshape(shape)

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        pixels, matrix, shape = context.call
        by_image, by_change = _gradient(gradient.contiguous().numpy().reshape(-1, 3), pixels, matrix)
        return torch.from_numpy(by_image).reshape(shape), torch.from_numpy(by_change.astype(np.float32))


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _changed(pixels, change):
    result = np.empty_like(pixels)
    (a, b, c, d), (e, f, g, h), (i, j, k, m) = _rows(change)
    for at in prange(len(pixels)):
        red, green, blue = pixels[at, 0], pixels[at, 1], pixels[at, 2]
        result[at, 0] = red + (a * red + b * green + c * blue + d)
        result[at, 1] = green + (e * red + f * green + g * blue + h)
        result[at, 2] = blue + (i * red + j * green + k * blue + m)
    return result


@internal(error_model="numpy")
def _rows(change):
    return (
        (change[0, 0], change[0, 1], change[0, 2], change[0, 3]),
        (change[1, 0], change[1, 1], change[1, 2], change[1, 3]),
        (change[2, 0], change[2, 1], change[2, 2], change[2, 3]),
    )


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _gradient(gradient, pixels, change):
    """By the pixels, and by the transform."""
    result = np.empty_like(pixels)
    (a, b, c, _), (e, f, g, _), (i, j, k, _) = _rows(change)
    pieces = -(-len(pixels) // _PIECE)
    sums = np.zeros((pieces, 3, 4))
    for piece in prange(pieces):
        # Numbers with names, as they stay in registers and twelve sums don't wait for each other.
        s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = s20 = s21 = s22 = s23 = 0.0
        for at in range(piece * _PIECE, min(len(pixels), piece * _PIECE + _PIECE)):
            red, green, blue = gradient[at, 0], gradient[at, 1], gradient[at, 2]
            result[at, 0] = red + (a * red + e * green + i * blue)
            result[at, 1] = green + (b * red + f * green + j * blue)
            result[at, 2] = blue + (c * red + g * green + k * blue)
            u, v, w = np.float64(red), np.float64(green), np.float64(blue)
            x, y, z = np.float64(pixels[at, 0]), np.float64(pixels[at, 1]), np.float64(pixels[at, 2])
            s00, s01, s02, s03 = s00 + u * x, s01 + u * y, s02 + u * z, s03 + u
            s10, s11, s12, s13 = s10 + v * x, s11 + v * y, s12 + v * z, s13 + v
            s20, s21, s22, s23 = s20 + w * x, s21 + w * y, s22 + w * z, s23 + w
        # One by one: a row as an array takes five seconds to compile.
        sums[piece, 0, 0], sums[piece, 0, 1], sums[piece, 0, 2], sums[piece, 0, 3] = s00, s01, s02, s03
        sums[piece, 1, 0], sums[piece, 1, 1], sums[piece, 1, 2], sums[piece, 1, 3] = s10, s11, s12, s13
        sums[piece, 2, 0], sums[piece, 2, 1], sums[piece, 2, 2], sums[piece, 2, 3] = s20, s21, s22, s23
    total = np.zeros((3, 4))
    for piece in range(pieces):
        for row in range(3):
            for column in range(4):
                total[row, column] += sums[piece, row, column]
    return result, total


def _warm_up() -> None:
    image, change = torch.ones(4, 4, 3, requires_grad=True), torch.zeros(3, 4, requires_grad=True)
    op.colours(image, change).sum().backward()


BACKEND = cpu_backend(_warm_up, _gradient)
