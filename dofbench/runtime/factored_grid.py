"""The layout of a factorised grid: how a function on the unit cube is stored as products of planes and lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import torch
from torch import Tensor

# The function is a sum over these modes: a plane over the first two axes (columns, rows) times a line along the third.
MODES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


@dataclass(frozen=True)
class GridShape:
    """Sizes of a factorised grid (TensoRF's vector-matrix decomposition; Chen et al., ECCV 2022, section 4.2).

    nodes: along x, y and z of the unit cube, the first on 0 and the last on 1. density_rank, colour_rank: channels of a
    plane and its line, multiples of 8. harmonics: number of spherical harmonics of a colour, 1, 4 or 9.
    """

    nodes: tuple[int, int, int]
    density_rank: int
    colour_rank: int
    harmonics: int

    def __post_init__(self) -> None:
        if min(self.nodes) < 2:
            raise ValueError(f"nodes: expected at least 2 along each axis, found {self.nodes}")
        for name in ("density_rank", "colour_rank"):
            rank = getattr(self, name)
            if rank < 8 or rank % 8:
                raise ValueError(f"{name}: expected a positive multiple of 8, found {rank}")
        if self.harmonics not in (1, 4, 9):
            raise ValueError(f"harmonics: expected 1, 4 or 9, found {self.harmonics}")

    @property
    def density_size(self) -> int:
        """Numbers in the flat tensor of the density."""
        return sum(self._sizes(self.density_rank))

    @property
    def colour_size(self) -> int:
        """Numbers in the flat tensor of the colour."""
        return sum(self._sizes(self.colour_rank))

    @property
    def basis_shape(self) -> tuple[int, int]:
        """Of the matrix from a point's colour channels to the coefficients of its colour, channel by channel."""
        return 3 * self.colour_rank, 3 * self.harmonics

    @property
    def feature_columns(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """(rank, first column) of the density's and of the colour's features: what planes times lines give at a point,
        mode by mode, the density's before the colour's."""
        return (self.density_rank, 0), (self.colour_rank, len(MODES) * self.density_rank)

    @property
    def feature_count(self) -> int:
        """Features of a point."""
        return len(MODES) * (self.density_rank + self.colour_rank)

    def offsets(self, rank: int) -> tuple[int, ...]:
        """Where in the flat tensor the three planes and then the three lines begin."""
        return tuple(accumulate(self._sizes(rank), initial=0))[:6]

    def parts(self, flat: Tensor, rank: int) -> tuple[list[Tensor], list[Tensor]]:
        """Views of the flat tensor for each mode: a (rows, columns, rank) plane, and a (nodes, rank) line."""
        shapes: list[tuple[int, ...]] = [(self.nodes[row], self.nodes[column], rank) for column, row, _ in MODES]
        shapes += [(self.nodes[axis], rank) for _, _, axis in MODES]
        # One split, since its gradient is put together once; that of slices is a tensor of flat's size for each.
        views = [part.view(shape) for part, shape in zip(flat.split(self._sizes(rank)), shapes, strict=True)]
        return views[:3], views[3:]

    def planes(self, flat: Tensor, rank: int) -> list[Tensor]:
        """The planes of `parts`."""
        return self.parts(flat, rank)[0]

    def lines(self, flat: Tensor, rank: int) -> list[Tensor]:
        """The lines of `parts`."""
        return self.parts(flat, rank)[1]

    def _sizes(self, rank: int) -> list[int]:
        planes = [self.nodes[column] * self.nodes[row] * rank for column, row, _ in MODES]
        return [*planes, *(self.nodes[axis] * rank for _, _, axis in MODES)]


@dataclass(frozen=True, eq=False)
class FieldRender:
    """What R rays see. color: (R, 3), without a background. opacity: (R,), the sum of the samples' weights.
    distance: (R,), the sum of the weights times the samples' places along the ray."""

    color: Tensor
    opacity: Tensor
    distance: Tensor


@dataclass(frozen=True, eq=False)
class RaySamples:
    """Samples of R rays, ray after ray, from near to far. starts: (R + 1,) int64; ray r has samples starts[r] to
    starts[r + 1]. places: (S,), a sample lies at origin + place * direction. steps: (S,), the part of the ray, in the
    unit of places, that a sample stands for."""

    starts: Tensor
    places: Tensor
    steps: Tensor

    @staticmethod
    def joined(parts: Sequence[RaySamples]) -> RaySamples:
        """The samples of all parts, in the order of the parts."""
        if len(parts) == 1:
            return parts[0]
        before = accumulate((len(part.places) for part in parts), initial=0)
        starts = [part.starts[:-1] + count for part, count in zip(parts, before, strict=False)]
        end = parts[-1].starts.new_full((1,), sum(len(part.places) for part in parts))
        places, steps = ([getattr(part, name) for part in parts] for name in ("places", "steps"))
        return RaySamples(torch.cat([*starts, end]), torch.cat(places), torch.cat(steps))
