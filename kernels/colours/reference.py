"""The definition of the colour transform, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def colours(image: Tensor, change: Tensor) -> Tensor:
    return image + image @ change[:, :3].T + change[:, 3]
