"""World rays as straight pieces in the unit cube, and what they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.factored_grid import FieldRender

PER_RAY = 100.0  # density is per hundredth of a ray through the whole space


@dataclass(frozen=True, eq=False)
class CubeRays:
    """R rays in the unit cube, or one straight piece of each. origins, directions: (R, 3). spans: (R, 2), the places of
    begin and end; a piece that ends before it begins is absent. gain: (R,), the factor on the length of a step."""

    origins: Tensor
    directions: Tensor
    spans: Tensor
    gain: Tensor

    @property
    def ends(self) -> Tensor:
        """(R,) the last place of each; the begin of an absent piece."""
        return torch.maximum(self.spans[:, 1], self.spans[:, 0])

    def points(self, places: Tensor) -> Tensor:
        """(..., R, 3) in the cube at places (..., R)."""
        return self.origins + places[..., None] * self.directions


class Space(Protocol):
    """A part of the scene, mapped to the unit cube."""

    @property
    def has_surroundings(self) -> bool:
        """Whether cameras look out of it on all sides, so that it needs `Surroundings`."""

    @property
    def sampling(self) -> tuple[float, ...]:
        """Number of steps of each of a ray's K pieces, as a share of `ray_samples`."""

    def pieces(self, origins: Tensor, directions: Tensor) -> tuple[CubeRays, ...]:
        """K straight pieces in the cube of each world ray (R, 3), from near to far; differentiable. directions: of
        length 1 in z of their camera."""

    def depths(self, origins: Tensor, directions: Tensor, places: Tensor) -> Tensor:
        """(K, R) z in the cameras' frames, scene units, of a place (K, R) on each piece of the rays."""

    def nodes(self, most: int) -> tuple[int, int, int]:
        """Nodes along the cube's axes, for cells that are alike in the images; `most` along the longest."""

    def record(self) -> dict[str, np.ndarray]:
        """The space's numbers by name, for a file."""


def joined(pieces: Sequence[CubeRays]) -> CubeRays:
    """Join pieces: one piece of all rays after the other."""
    if len(pieces) == 1:
        return pieces[0]
    return CubeRays(
        origins=torch.cat([piece.origins for piece in pieces]),
        directions=torch.cat([piece.directions for piece in pieces]),
        spans=torch.cat([piece.spans for piece in pieces]),
        gain=torch.cat([piece.gain for piece in pieces]),
    )


def points_along(pieces: Sequence[CubeRays], shares: Tensor) -> Tensor:
    """(R, N, 3) points in the cube at shares (N,) of the rays' whole length, measured by the gain."""
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


_NOTHING = 1e-6  # opacity of a piece that counts as if it had met something at its end


@dataclass(frozen=True, eq=False)
class RaysSeen:
    """Colours and places that R rays of K pieces see. color: (R, 3). opacity: (R,).

    met: (K, R), the share of the light that each piece absorbed; met_places: (K, R), where it did, on average. weights,
    places: the same if the last piece absorbed the rest of the light at its end.
    """

    color: Tensor
    opacity: Tensor
    met: Tensor
    met_places: Tensor
    weights: Tensor
    places: Tensor

    @staticmethod
    def of(found: FieldRender, pieces: Sequence[CubeRays]) -> RaysSeen:
        """Combine the pieces. found: of the K times R pieces, one piece of all rays after the other."""
        opacities, distances = (part.view(len(pieces), -1) for part in (found.opacity, found.distance))
        ends = torch.stack([piece.ends for piece in pieces])
        left = [torch.ones_like(opacities[0])]
        for opacity in opacities[:-1]:
            left.append(left[-1] * (1 - opacity))
        reaching = torch.stack(left)
        met = reaching * opacities
        met_places = (distances + _NOTHING * ends) / (opacities + _NOTHING)
        last = distances[-1] + (1 - opacities[-1]) * ends[-1]
        return RaysSeen(
            color=(reaching[..., None] * found.color.view(len(pieces), -1, 3)).sum(0),
            opacity=met.sum(0),
            met=met,
            met_places=met_places,
            weights=torch.cat([met[:-1], reaching[-1:]]),
            places=torch.cat([met_places[:-1], last[None]]),
        )
