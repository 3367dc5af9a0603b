"""The definition of the colour transform, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def colours(image: Tensor, change: Tensor) -> Tensor:
    """(H, W, 3): each colour c becomes c + D c + e.

    image: (H, W, 3). change: (3, 4), [D | e], how the transform differs from identity. Differentiable with respect to
    both.
    """
    return image + image @ change[:, :3].T + change[:, 3]
