"""What is infinitely far away behind a scene that is seen from all around: a colour for every direction.

A ray that meets nothing in the field would be black otherwise, and training would have to put something opaque in the
way of every ray. Directions are laid out on a square, as the faces of an octahedron that are folded out: unlike a map
by longitude and latitude it has no poles at which they crowd.
"""

from __future__ import annotations

import torch
from torch import Tensor


class Surroundings:
    """Colours by direction. logits: (N * N, 3), leaf tensor: what the colours are before the sigmoid, row by row on the
    square of directions."""

    def __init__(self, logits: Tensor):
        self.logits = logits.detach().contiguous().requires_grad_()
        self._nodes = round(len(logits) ** 0.5)
        if self._nodes**2 != len(logits) or self._nodes < 2 or logits.shape[1:] != (3,):
            raise ValueError(f"surroundings: expected (N * N, 3) with N of 2 or more, found {tuple(logits.shape)}")

    @staticmethod
    def grey(nodes: int, device: torch.device | str = "cpu") -> Surroundings:
        """The same grey in every direction, stored at `nodes` times `nodes` places."""
        return Surroundings(torch.zeros(nodes * nodes, 3, device=device))

    def seen(self, directions: Tensor) -> Tensor:
        """(R, 3) colours in [0, 1] in world directions (R, 3) of any length, interpolated linearly on the square;
        differentiable by the colours."""
        places = (on_square(directions.detach()) + 1) * ((self._nodes - 1) / 2)
        first = places.floor().clamp(0, self._nodes - 2)
        share = (places - first)[..., None]
        column, row = first.long().unbind(1)
        corner = row * self._nodes + column
        corners = torch.stack([corner, corner + 1, corner + self._nodes, corner + self._nodes + 1], 1)
        # Looked up as an embedding since its gradient is added up in the same order every time, on a GPU too.
        found = torch.nn.functional.embedding(corners, self.logits)
        upper = torch.lerp(found[:, 0], found[:, 1], share[:, 0])
        lower = torch.lerp(found[:, 2], found[:, 3], share[:, 0])
        return torch.sigmoid(torch.lerp(upper, lower, share[:, 1]))


def on_square(directions: Tensor) -> Tensor:
    """(R, 2) in [-1, 1]: where directions (R, 3) of any length lie on the square of an octahedron (Engelhardt and
    Dachsbacher, Octahedron Environment Maps, 2008). Those with z > 0 lie in its middle, the others around them."""
    x, y, z = (directions / directions.abs().sum(1, keepdim=True)).unbind(1)
    folded_x = torch.copysign(1 - y.abs(), x)
    folded_y = torch.copysign(1 - x.abs(), y)
    return torch.stack([torch.where(z >= 0, x, folded_x), torch.where(z >= 0, y, folded_y)], 1)
