"""Which cells of the unit cube hold anything, so that rays take no samples in empty ones."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.factored_grid import RaySamples
from dofbench.runtime.ops import load
from dofbench.training.fields.cube_rays import CubeRays
from dofbench.training.fields.grid_field import GridField

_FORGET = 0.9  # share of a cell's largest density that is kept from update to update (Instant-NGP 0.95)
_CHUNK = 1 << 18


class Occupancy:
    """A grid of cells over the unit cube, all occupied at first.

    A cell is occupied while its density, or that of a neighbour, would absorb at least `least` of the light over a step
    of a ray.
    """

    def __init__(self, cells: int, least: float, device: torch.device | str = "cpu"):
        self._least = least
        self.occupied = torch.ones((cells, cells, cells), dtype=torch.bool, device=device)
        self._densest = torch.zeros((cells, cells, cells), device=device)

    def update(self, field: GridField, length: float, generator: torch.Generator) -> None:
        """Look at the density at a random point of each cell. length: of a step, in units of the density's
        reciprocal."""
        cells, device = len(self.occupied), self.occupied.device
        index = torch.arange(cells**3, device=device)
        corner = torch.stack([index % cells, index // cells % cells, index // cells**2], 1)
        within = torch.rand((cells**3, 3), generator=generator).to(device, non_blocking=True)
        points = (corner + within) / cells
        found = torch.cat([field.density(part) for part in points.split(_CHUNK)]).view(cells, cells, cells)
        self._densest = torch.maximum(_FORGET * self._densest, found)
        absorbed = -torch.expm1(-self._densest * length)
        # A neighbour's sample is interpolated from nodes that this cell's point didn't see.
        widest = torch.nn.functional.max_pool3d(absorbed[None, None], 3, 1, 1)[0, 0]
        self.occupied = widest >= self._least

    @torch.no_grad()
    def samples(self, rays: CubeRays, count: int, offsets: Tensor) -> RaySamples:
        """Where rays are sampled: `count` steps from their beginning to their end, in occupied cells. offsets: (R,) in
        [0, 1), how far into each step."""
        found: RaySamples = load("field", function="field_samples")(
            rays.origins.detach().contiguous(),
            rays.directions.detach().contiguous(),
            rays.spans.contiguous(),
            offsets,
            self.occupied,
            count=count,
        )
        return found
