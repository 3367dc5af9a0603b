"""All of space in the unit cube, for views from around a scene.

A box around what the views look at keeps its shape, as a smaller box in the middle of the cube. What lies outside is
drawn together, and infinity is the cube's surface: a point x, with half a side of the box as the unit, goes to
x / (|x| + a), |x| being the length of its longest coordinate. The map is continuous, and projective in each of seven
parts, the box and what lies beyond each of its faces, so that a straight ray is a few straight pieces in the cube. That
of MERF (Reiser et al., SIGGRAPH 2023, Eq. 3) is projective in these parts too, but isn't continuous between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.compute.device_numbers import beside
from dofbench.fields.cube_rays import PER_RAY, CubeRays

_BOX_SHARE = 0.85  # of the cube's side, which the box fills; 0.7 does as well (reports/notes/fields.md)
_PULL = 1 / _BOX_SHARE - 1  # a in x / (|x| + a), so that the box's surface is where that of the smaller box is
_SAMPLING = (1.0, 0.25, 0.25, 0.25)  # beyond the box most pieces are that much shorter in the cube
_LEAST_DEPTH = 1e-6  # scene units, of a place on a piece that isn't there
_LEAST_RECIPROCAL = 1e-4  # of a distance: what is farther away counts as being there
_LEAST_SLOPE = 1e-6  # of a ray along an axis, half a box's side for a length of 1


@dataclass(frozen=True, eq=False)
class Unbounded:
    """All of space, with a box along the world's axes from `low` to `high`, (3,), in its middle.

    A ray has four pieces: from the box's near side to its far side, where a place is z in the camera's frame; and up to
    three beyond, where it is 1 - 1 / (|x| + a). What is between a camera and the box counts as empty, and so does what
    is nearer than `near`, z in the camera's frame, scene units: few cameras see what stands right before one of them,
    so training would explain a photograph by a haze there.
    """

    low: np.ndarray
    high: np.ndarray
    near: float

    @property
    def has_surroundings(self) -> bool:
        """See `Space.has_surroundings`."""
        return True

    @property
    def sampling(self) -> tuple[float, ...]:
        """See `Space.sampling`."""
        return _SAMPLING

    def pieces(self, origins: Tensor, directions: Tensor) -> tuple[CubeRays, ...]:
        """See `Space.pieces`."""
        half = beside(origins, (self.high - self.low) / 2)
        start, along = self._from_the_middle(origins, directions, half)
        begin, slope = _rising(start, along)
        with torch.no_grad():
            enter, leave = _crossings(begin, slope, torch.ones_like(begin[:, :1]))
            inside = torch.stack([enter.clamp_min(self.near), leave], 1)
            axes = slope.argsort(1)
            cuts = _cuts(begin, slope, axes, self.near)
        found = [_piece(_BOX_SHARE * start, _BOX_SHARE * along, inside, half)]
        for number, axis in enumerate(axes.unbind(1)):
            first, rate = (part.gather(1, axis[:, None]) for part in (begin, slope))
            with torch.no_grad():  # in the box, where r is less than 1, the ray is the piece above
                nearest = (first + cuts[number][:, None] * rate).clamp_min(1)
                farthest = torch.maximum(first + cuts[number + 1][:, None] * rate, nearest)
                spans = torch.cat([1 - 1 / (nearest + _PULL), 1 - 1 / (farthest + _PULL)], 1)
            # In q = 1 / (r + a), r being the longest coordinate, the ray is A + q B; its place is 1 - q.
            infinite = along / rate
            nearer = start - along * (first + _PULL) / rate
            found.append(_piece(infinite + nearer, -nearer, spans, half))
        return tuple(found)

    def depths(self, origins: Tensor, directions: Tensor, places: Tensor) -> Tensor:
        """See `Space.depths`."""
        half = beside(origins, (self.high - self.low) / 2)
        begin, slope = _rising(*self._from_the_middle(origins, directions, half))
        axes = slope.detach().argsort(1)
        first, rate = begin.gather(1, axes).T, slope.gather(1, axes).T
        far = (1 / (1 - places[1:]).clamp_min(_LEAST_RECIPROCAL) - _PULL - first) / rate
        return torch.cat([places[:1], far]).clamp_min(_LEAST_DEPTH)

    def nodes(self, most: int) -> tuple[int, int, int]:
        """See `Space.nodes`."""
        extent = self.high - self.low
        x, y, z = (max(2, round(most * float(side / extent.max()))) for side in extent)
        return x, y, z

    def record(self) -> dict[str, np.ndarray]:
        """See `Space.record`."""
        return {"box_low": self.low, "box_high": self.high, "near": np.array(self.near)}

    def _from_the_middle(self, origins: Tensor, directions: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
        return (origins - beside(origins, (self.low + self.high) / 2)) / half, directions / half


def _rising(start: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    """(R, 3) each: where rays begin and how fast they go along each axis, towards the side to which they go."""
    sign = torch.where(along.detach() < 0, -1.0, 1.0).to(along.dtype)
    return sign * start, (sign * along).clamp_min(_LEAST_SLOPE)


def _crossings(begin: Tensor, slope: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    """(R,) each: where rays enter and leave the box that is `size`, (R, 1), times as large."""
    return ((-size - begin) / slope).amax(1), ((size - begin) / slope).amin(1)


def _cuts(begin: Tensor, slope: Tensor, axes: Tensor, near: float) -> Tensor:
    """(4, R): where the longest coordinate of rays is one along another axis, from where it is least, which is where a
    ray touches a box that it just doesn't miss, or from `near`, up to infinity.

    From there on it only grows: it is the largest of three lines, in the order of their slopes. axes: (R, 3), that
    order.
    """
    others = torch.roll(begin, 1, 1), torch.roll(slope, 1, 1)
    touching = ((begin * others[1] - others[0] * slope).abs() / (slope + others[1])).amax(1, keepdim=True)
    _, nearest = _crossings(begin, slope, touching)
    (one, two, three), (a, b, c) = begin.gather(1, axes).T, slope.gather(1, axes).T
    meet = [
        torch.where(rise > 0, (low - high) / rise, torch.where(high > low, -torch.inf, torch.inf))
        for low, high, rise in ((one, two, b - a), (one, three, c - a), (two, three, c - b))
    ]
    first = nearest.clamp_min(near)
    second = torch.maximum(first, torch.minimum(meet[0], meet[1]))
    third = torch.maximum(second, meet[2])
    return torch.stack([first, second, third, torch.full_like(first, torch.inf)])


def _piece(begin: Tensor, along: Tensor, spans: Tensor, half: Tensor) -> CubeRays:
    """From coordinates from -1 to 1 to those of the unit cube."""
    gain = PER_RAY * (along.detach() / 2 * half).norm(dim=1) / half.norm()
    return CubeRays((begin + 1) / 2, along / 2, spans, gain)
