"""What a space makes of world rays: straight pieces in the unit cube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

PER_RAY = 100.0  # density is per hundredth of a ray through the whole space


@dataclass(frozen=True, eq=False)
class CubeRays:
    """R rays in the unit cube, or one straight piece of each. origins, directions: (R, 3). spans: (R, 2), the places
    where they begin and end; what ends before it begins is not there. gain: (R,), what the length of a step along the
    ray is multiplied by before it meets the density."""

    origins: Tensor
    directions: Tensor
    spans: Tensor
    gain: Tensor

    @property
    def ends(self) -> Tensor:
        """(R,) the last place of each, that where it begins if it isn't there."""
        return torch.maximum(self.spans[:, 1], self.spans[:, 0])

    def points(self, places: Tensor) -> Tensor:
        """(..., R, 3) in the cube at places (..., R)."""
        return self.origins + places[..., None] * self.directions


class Space(Protocol):
    """A part of the scene, and where its points lie in the unit cube."""

    @property
    def has_surroundings(self) -> bool:
        """Whether cameras look out of it on all sides, so that what is infinitely far away is a colour for every
        direction (`surroundings.py`)."""

    @property
    def sampling(self) -> tuple[float, ...]:
        """Into how many steps each of the K pieces of a ray is divided, as a share of `ray_samples`."""

    def pieces(self, origins: Tensor, directions: Tensor) -> tuple[CubeRays, ...]:
        """World rays (R, 3) in the cube, K straight pieces of each from near to far; differentiable. directions: of
        length 1 in z of their camera."""

    def depths(self, origins: Tensor, directions: Tensor, places: Tensor) -> Tensor:
        """(K, R) z in the cameras' frames, scene units, of a place (K, R) on each piece of world rays (R, 3)."""

    def nodes(self, most: int) -> tuple[int, int, int]:
        """Nodes along the cube's axes, for cells that are alike in the images; `most` along the longest."""

    def record(self) -> dict[str, np.ndarray]:
        """The numbers that the space is made of, by name."""


def joined(pieces: Sequence[CubeRays]) -> CubeRays:
    """One piece of all rays after the other, as if each were a ray."""
    if len(pieces) == 1:
        return pieces[0]
    return CubeRays(
        origins=torch.cat([piece.origins for piece in pieces]),
        directions=torch.cat([piece.directions for piece in pieces]),
        spans=torch.cat([piece.spans for piece in pieces]),
        gain=torch.cat([piece.gain for piece in pieces]),
    )


def points_along(pieces: Sequence[CubeRays], shares: Tensor) -> Tensor:
    """(R, N, 3) in the cube at shares (N,) of the whole length of the rays, their gain being the measure of length."""
    spans = torch.stack([piece.ends - piece.spans[:, 0] for piece in pieces])
    lengths = spans * torch.stack([piece.gain for piece in pieces])
    parts = lengths / lengths.sum(0)
    before = parts.cumsum(0) - parts
    number = (shares[:, None, None] >= before).sum(1) - 1  # (N, R), the last piece that has begun
    within = ((shares[:, None] - before.gather(0, number)) / parts.gather(0, number)).clamp(0, 1)
    begins = torch.stack([piece.spans[:, 0] for piece in pieces]).gather(0, number)
    places = begins + within * spans.gather(0, number)
    own = number[..., None].expand(-1, -1, 3)
    origins = torch.stack([piece.origins for piece in pieces]).gather(0, own)
    directions = torch.stack([piece.directions for piece in pieces]).gather(0, own)
    return (origins + places[..., None] * directions).transpose(0, 1)
