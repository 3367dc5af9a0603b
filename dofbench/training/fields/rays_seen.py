"""What rays see that are straight pieces in the cube, one behind the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.runtime.factored_grid import FieldRender
from dofbench.training.fields.cube_rays import CubeRays

_NOTHING = 1e-6  # opacity of a piece that counts as if it had met something at its end


@dataclass(frozen=True, eq=False)
class RaysSeen:
    """What R rays of K pieces see. color: (R, 3). opacity: (R,).

    met: (K, R), the share of the light that each piece took; met_places: (K, R), where it did, on average. weights and
    places: the same with what is left of the light, which counts as if the last piece had taken it at its end.
    """

    color: Tensor
    opacity: Tensor
    met: Tensor
    met_places: Tensor
    weights: Tensor
    places: Tensor

    @staticmethod
    def of(found: FieldRender, pieces: Sequence[CubeRays]) -> RaysSeen:
        """found: what K times R rays see that are the pieces, one piece of all rays after the other."""
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
