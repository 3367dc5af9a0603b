"""An affine transform of an image's colours."""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["colours"]


def colours(image: Tensor, change: Tensor, *, backend: str = AUTO) -> Tensor:
    """(H, W, 3): each colour c becomes c + D c + e.

    image: (H, W, 3). change: (3, 4), [D | e], how the transform differs from identity. Differentiable with respect to
    both.
    """
    return implementation("colours", backend, image=image, change=change).colours(image, change)
