"""A pixel that several rays make up: their mean in linear light (Deblur-NeRF, Eq. 5 and 6, gamma 2.2)."""

from __future__ import annotations

from torch import Tensor

from dofbench.core.lens import GAMMA
from dofbench.optics.tone import fast_decode, fast_encode


def mixed(colours: Tensor, weights: Tensor) -> Tensor:
    """(P, 3) encoded: colours (P, N, 3), encoded, mixed in linear light by weights (P, N)."""
    light = fast_decode(colours.contiguous(), GAMMA)
    return fast_encode((weights[..., None] * light).sum(1), GAMMA)
