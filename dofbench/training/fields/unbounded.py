"""All of space in the unit cube, for views from around a scene.

A box around the sparse points keeps its shape, as a smaller box in the middle of the cube. The outside is contracted,
and infinity is the cube's surface: a point x, in units of half a side of the box, goes to x / (|x| + a), |x| being its
longest coordinate. The map is continuous, and projective in the box and beyond each of its faces, so that a straight
ray is a few straight pieces in the cube. MERF's map (Reiser et al., SIGGRAPH 2023, Eq. 3) isn't continuous between
them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.device_numbers import beside
from dofbench.training.fields.cube_rays import PER_RAY, CubeRays

_BOX_SHARE = 0.85  # of the cube's side, which the box fills; 0.7 does as well (docs/notes/fields.md)
_PULL = 1 / _BOX_SHARE - 1  # a in x / (|x| + a), for which the map is continuous at the box's surface
_SAMPLING = (1.0, 0.25, 0.25, 0.25)  # beyond the box most pieces are that much shorter in the cube
_LEAST_DEPTH = 1e-6  # scene units, of a place on an absent piece
_LEAST_RECIPROCAL = 1e-4  # of a distance; the farthest that counts
_FARTHEST = 1e30  # scene units, of a piece that begins at infinity
_LEAST_SLOPE = 1e-6  # of a ray along an axis, half a box's side for a length of 1


@dataclass(frozen=True, eq=False)
class Unbounded:
    """All of space, with a box along the world's axes from `low` to `high`, (3,), in its middle.

    A ray has four pieces: through the box, where a place is z in the camera's frame, and up to three beyond, where it
    is the share of the way in the cube, which is exact for a ray along a face too. Space between a camera and the box
    counts as empty, and so does what is nearer than `near`, z in the camera's frame, scene units: few cameras see it,
    so training would explain images by a haze there.
    """

    low: np.ndarray
    high: np.ndarray
    near: float

    @property
    def has_surroundings(self) -> bool:
        return True

    @property
    def sampling(self) -> tuple[float, ...]:
        return _SAMPLING

    def pieces(self, origins: Tensor, directions: Tensor) -> tuple[CubeRays, ...]:
        """As `Space.pieces`. Gradients are at fixed depths along the rays, not at fixed places in the cube."""
        half = beside(origins, (self.high - self.low) / 2)
        start, along = self._from_the_middle(origins, directions, half)
        begin, slope = _rising(start, along)
        inside, stretches = _divided(begin, slope, self.near)
        return (
            _piece(_BOX_SHARE * start, _BOX_SHARE * along, inside, half),
            *(_piece(*stretch.ends(start, along), stretch.spans, half) for stretch in stretches),
        )

    def depths(self, origins: Tensor, directions: Tensor, places: Tensor) -> Tensor:
        half = beside(origins, (self.high - self.low) / 2)
        _, stretches = _divided(*_rising(*self._from_the_middle(origins, directions, half)), self.near)
        beyond = [stretch.depths(place) for stretch, place in zip(stretches, places[1:], strict=True)]
        return torch.stack([places[0], *beyond]).clamp_min(_LEAST_DEPTH)

    def nodes(self, most: int) -> tuple[int, int, int]:
        extent = self.high - self.low
        x, y, z = (max(2, round(most * float(side / extent.max()))) for side in extent)
        return x, y, z

    def record(self) -> dict[str, np.ndarray]:
        return {"box_low": self.low, "box_high": self.high, "near": np.array(self.near)}

    def _from_the_middle(self, origins: Tensor, directions: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
        return (origins - beside(origins, (self.low + self.high) / 2)) / half, directions / half


def _rising(start: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    """(R, 3) each: begin and slope of rays along each axis, mirrored so that all rise."""
    sign = torch.where(along.detach() < 0, -1.0, 1.0).to(along.dtype)
    return sign * start, (sign * along).clamp_min(_LEAST_SLOPE)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """The part of every ray beyond the box's face across one axis: from depth `begin` to `end`, (R,) each, which may be
    infinite; absent where it ends before it begins. first, rate: (R,), the rays' begin and slope along that axis, their
    longest coordinate in this stretch."""

    first: Tensor
    rate: Tensor
    begin: Tensor
    end: Tensor

    @property
    def spans(self) -> Tensor:
        """(R, 2); see `CubeRays`."""
        return torch.stack([torch.zeros_like(self.begin), self._there.to(self.begin.dtype)], 1)

    def ends(self, start: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
        """(R, 3) each: its begin, and the way to its end, in coordinates from -1 to 1. start, along: the rays."""
        begin, end = self._finite_ends
        origin, finite = ((start + depth[:, None] * along) / self._drawn(depth)[:, None] for depth in (begin, end))
        infinite = along / self.rate[:, None]
        return origin, torch.where(self._endless[:, None], infinite, finite) - origin

    def depths(self, places: Tensor) -> Tensor:
        """(R,) of the shares `places`, (R,), of the way in the cube."""
        begin, end = self._finite_ends
        near, far = self._drawn(begin), self._drawn(end)
        finite = places * (end - begin) * near / (far - places * (far - near))
        left = torch.maximum(1 - places, (_LEAST_RECIPROCAL * near).clamp_max(1))
        infinite = (1 - left) * near / (self.rate * left)
        found = begin + torch.where(self._endless, infinite, finite)
        return torch.where(self._there, found, self.begin.clamp(0, _FARTHEST))

    @property
    def _there(self) -> Tensor:
        return self.end > self.begin

    @property
    def _endless(self) -> Tensor:
        return self._there & self.end.isinf()

    @property
    def _finite_ends(self) -> tuple[Tensor, Tensor]:
        """(R,) each, finite: the ends, but 0 of absent ones, and the begin for an end at infinity."""
        begin = torch.where(self._there, self.begin, 0)
        return begin, torch.where(self._there & ~self.end.isinf(), self.end, begin)

    def _drawn(self, depth: Tensor) -> Tensor:
        """(R,) |x| + a at these depths, |x| being at least 1. On the box's face, where rounding may make it less, it
        keeps its gradient."""
        size = self.first + depth * self.rate
        return size + (1 - size.detach()).clamp_min(0) + _PULL


def _divided(begin: Tensor, slope: Tensor, near: float) -> tuple[Tensor, list[_Stretch]]:
    """The depths (R, 2) at which rays enter and leave the box, and the three stretches beyond it."""
    with torch.no_grad():
        enter, leave = _crossings(begin, slope, torch.ones_like(begin[:, :1]))
        inside = torch.stack([enter.clamp_min(near), leave], 1)
        axes = slope.argsort(1)
        cuts = torch.maximum(_cuts(begin, slope, axes, near), torch.where(enter < leave, leave, -torch.inf))
    rays = zip(begin.gather(1, axes).T, slope.gather(1, axes).T, strict=True)
    ends = itertools.pairwise(cuts)
    return inside, [_Stretch(first, rate, *pair) for (first, rate), pair in zip(rays, ends, strict=True)]


def _crossings(begin: Tensor, slope: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    """(R,) each: the depths at which rays enter and leave the box that is `size`, (R, 1), times as large."""
    return ((-size - begin) / slope).amax(1), ((size - begin) / slope).amin(1)


def _cuts(begin: Tensor, slope: Tensor, axes: Tensor, near: float) -> Tensor:
    """(4, R): the depths at which the axis of the rays' longest coordinate changes, from where that coordinate is
    least, or from `near`, up to infinity.

    From there on it only grows: it is the largest of three lines, in the order of their slopes. axes: (R, 3), that
    order.
    """
    others, slopes = torch.roll(begin, 1, 1), torch.roll(slope, 1, 1)
    # A ray touches the smallest box that it doesn't miss at an edge, where two coordinates are as long.
    edge = ((begin * slopes - others * slope).abs() / (slope + slopes)).argmax(1, keepdim=True)
    nearest = (-(begin + others) / (slope + slopes)).gather(1, edge)[:, 0]
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
    """A piece in the unit cube from coordinates from -1 to 1."""
    gain = PER_RAY * (along.detach() / 2 * half).norm(dim=1) / half.norm()
    return CubeRays((begin + 1) / 2, along / 2, spans, gain)
