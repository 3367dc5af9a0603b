"""Sizes of the workloads with radiance fields that `gpu_model.py` predicts times of."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path

from gpu_sizes import torch_calls

from dofbench.fields.forward.weight_proposal import WeightProposalOptions

DENSITY, COLOUR, TERMS = 8, 16, 9  # ranks and harmonics of the presets
CELLS = 64  # along each side of the grid that knows which cells are empty
CROWDED = 8  # samples of a cell on average, as a program's size is chosen by
ALONG = WeightProposalOptions().proposal_samples  # points of a ray whose features DP-NeRF reads


@dataclass(frozen=True)
class FieldSizes:
    """What the time of a training step of a field depends on.

    rays: of the step. nodes: of the grid along each axis. steps: that a ray is divided into. samples: of them that lie
    in occupied cells, a mean over the rays, as the next two. looked_at: samples that light reaches. lit: samples with a
    colour. planes, lines: passes of the loops that sum at nodes, of the density and of the colour; mean, longest, and
    the share of programs that have any: see `gpu_field_samples.py`. torch_ops: torch's own small operations.
    """

    name: str
    rays: int
    nodes: int
    steps: int = 64
    samples: float = 40.0
    looked_at: float = 32.0
    lit: float = 24.0
    planes_density: float = 1.0
    planes_density_longest: float = 10.0
    planes_density_some: float = 0.5
    planes_colour: float = 1.0
    planes_colour_longest: float = 10.0
    planes_colour_some: float = 0.5
    lines_density: float = 1.0
    lines_density_longest: float = 2.0
    lines_colour: float = 1.0
    lines_colour_longest: float = 2.0
    torch_ops: int = 0

    @property
    def all_samples(self) -> float:
        """Of all rays."""
        return self.rays * self.samples

    @property
    def all_looked_at(self) -> float:
        """Samples of all rays that light reaches."""
        return self.rays * self.looked_at

    @property
    def all_lit(self) -> float:
        """Samples of all rays with a colour."""
        return self.rays * self.lit

    @property
    def crowded(self) -> bool:
        """See `crowd`."""
        return crowd(self.all_samples, self.nodes)

    @property
    def plane_nodes(self) -> int:
        """Of all three planes."""
        return 3 * self.nodes**2

    @property
    def plane_cells(self) -> int:
        """Between the nodes of all three planes."""
        return 3 * (self.nodes - 1) ** 2

    @property
    def line_cells(self) -> int:
        """Between the nodes of all three lines."""
        return 3 * (self.nodes - 1)

    @property
    def grid_nodes(self) -> int:
        """Of planes and lines."""
        return self.plane_nodes + 3 * self.nodes

    @property
    def numbers_of_cells(self) -> int:
        """Two of each cell, kernels/field/gpu_nodes.py."""
        return 2 * (self.plane_cells + self.line_cells)

    @property
    def parameters(self) -> int:
        """Of the grid; those of the matrix are few."""
        return (DENSITY + COLOUR) * self.grid_nodes

    def read(self, samples: float, rank: int) -> float:
        """Bytes of a grid that so many samples read: each node once at most, and no more than they have around them,
        four of a plane and two of a line in each mode."""
        return 4 * rank * min(self.grid_nodes, 3 * 6 * samples)

    def along(self, count: float, block: int) -> float:
        """Mean passes of a loop over a ray's samples, `block` at a time, if rays have `count` of them on average and
        the last block is half full."""
        return min(count / block + (block - 1) / (2 * block), self.all_along(block))

    def all_along(self, block: int) -> float:
        """Passes for a ray all of whose steps are samples: no ray has more."""
        return float(math.ceil(self.steps / block))


def crowd(samples: float, nodes: int) -> bool:
    """Whether cells of planes have so many samples that a program sums at one node instead of four,
    kernels/field/gpu_grid_gradient.py."""
    return 3 * samples > CROWDED * 3 * nodes**2


def field_workloads(folder: Path, kind: str = "samples") -> tuple[FieldSizes, ...]:
    """The trainings. folder: of field_samples.csv and torch_calls.csv, which were measured on the CPU. kind: "samples",
    or "points" along the rays whose features are read."""
    calls, wanted = torch_calls(folder)["field"], {field.name for field in fields(FieldSizes)}
    found = []
    with (folder / "field_samples.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row.pop("kind") == kind:
                values = {name: float(value) for name, value in row.items() if name in wanted}
                counts = {name: int(values.pop(name)) for name in ("rays", "nodes", "steps")}
                name = f"{counts['rays']} rays, {counts['nodes']} nodes"
                found.append(FieldSizes(name, **counts, **values, torch_ops=calls))
    return tuple(found)


def cells_of(sizes: FieldSizes) -> FieldSizes:
    """The points at which a field is looked at to find its empty cells: one in each, without a ray."""
    return replace(sizes, rays=CELLS**3, samples=1.0, looked_at=1.0, lit=1.0)
