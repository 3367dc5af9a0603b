"""A radiance field in its place in the scene: what world rays see, in training and in rendering."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.runtime.factored_grid import RaySamples
from dofbench.runtime.ops import load
from dofbench.training.fields.cube_rays import PER_RAY, CubeRays, RaysSeen, Space, joined, points_along
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.grid_field import GridField
from dofbench.training.fields.pixels import CameraTable, whole_image

_FORGET = 0.9  # share of a cell's largest density that is kept from update to update (Instant-NGP 0.95)
_POINTS_AT_ONCE = 1 << 18


class Occupancy:
    """A grid of cells over the unit cube, all occupied at first.

    A cell is occupied while its density, or a neighbour's, would absorb at least `least` of the light over a step.
    """

    def __init__(self, cells: int, least: float, device: torch.device | str = "cpu"):
        self._least = least
        self.occupied = torch.ones((cells, cells, cells), dtype=torch.bool, device=device)
        self._densest = torch.zeros((cells, cells, cells), device=device)

    def update(self, field: GridField, length: float, generator: torch.Generator) -> None:
        """Update the density by a random point of each cell. length: of a step, units of the density's reciprocal."""
        cells, device = len(self.occupied), self.occupied.device
        index = torch.arange(cells**3, device=device)
        corner = torch.stack([index % cells, index // cells % cells, index // cells**2], 1)
        within = torch.rand((cells**3, 3), generator=generator).to(device, non_blocking=True)
        points = (corner + within) / cells
        found = torch.cat([field.density(part) for part in points.split(_POINTS_AT_ONCE)]).view(cells, cells, cells)
        self._densest = torch.maximum(_FORGET * self._densest, found)
        absorbed = -torch.expm1(-self._densest * length)
        # A neighbour's sample is interpolated from nodes outside this cell.
        widest = torch.nn.functional.max_pool3d(absorbed[None, None], 3, 1, 1)[0, 0]
        self.occupied = widest >= self._least

    @torch.no_grad()
    def samples(self, rays: CubeRays, count: int, offsets: Tensor) -> RaySamples:
        """Sample rays: `count` steps from begin to end, in occupied cells. offsets: (R,) in [0, 1), within a step."""
        found: RaySamples = load("field", function="field_samples")(
            rays.origins.detach().contiguous(),
            rays.directions.detach().contiguous(),
            rays.spans.contiguous(),
            offsets,
            self.occupied,
            count=count,
        )
        return found


class Surroundings:
    """Colours of what is infinitely far away, by direction, for a scene with views from all around.

    Without them a ray that meets nothing would be black, and training would block every ray with something opaque.
    Directions are laid out as the unfolded faces of an octahedron, which has no poles at which they crowd. logits:
    (N * N, 3), leaf tensor, colours before the sigmoid, row by row.
    """

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
        """(R, 3) colours in [0, 1] in world directions (R, 3) of any length, interpolated linearly; differentiable with
        respect to the colours."""
        places = (on_square(directions.detach()) + 1) * ((self._nodes - 1) / 2)
        first = places.floor().clamp(0, self._nodes - 2)
        share = (places - first)[..., None]
        column, row = first.long().unbind(1)
        corner = row * self._nodes + column
        corners = torch.stack([corner, corner + 1, corner + self._nodes, corner + self._nodes + 1], 1)
        # As an embedding, since its gradient is summed in the same order every time, on a GPU too.
        found = torch.nn.functional.embedding(corners, self.logits)
        upper = torch.lerp(found[:, 0], found[:, 1], share[:, 0])
        lower = torch.lerp(found[:, 2], found[:, 3], share[:, 0])
        return torch.sigmoid(torch.lerp(upper, lower, share[:, 1]))


def on_square(directions: Tensor) -> Tensor:
    """(R, 2) in [-1, 1]: directions (R, 3) of any length on the octahedron's square (Engelhardt and Dachsbacher,
    Octahedron Environment Maps, 2008); those with z > 0 in its middle, the others around them."""
    x, y, z = (directions / directions.abs().sum(1, keepdim=True)).unbind(1)
    folded_x = torch.copysign(1 - y.abs(), x)
    folded_y = torch.copysign(1 - x.abs(), y)
    return torch.stack([torch.where(z >= 0, x, folded_x), torch.where(z >= 0, y, folded_y)], 1)


_RAYS_AT_ONCE = 8192
_LEAST_OPACITY = 1e-3  # of a ray that has a depth


class FieldScene:
    """A field, its space, what is behind that (or None), and its empty cells, on the field's device."""

    def __init__(self, field: GridField, space: Space, options: FieldOptions, surroundings: Surroundings | None = None):
        self.field, self.space, self._options, self.surroundings = field, space, options, surroundings
        self.occupancy = Occupancy(options.rays.cells, options.rays.cells_absorb, field.device)

    @property
    def device(self) -> torch.device:
        """The field's device."""
        return self.field.device

    @property
    def parameters(self) -> dict[str, Tensor]:
        """Learned leaf tensors by name."""
        behind = {} if self.surroundings is None else {"surroundings": self.surroundings.logits}
        return self.field.parameters | behind

    @property
    def steps_of_a_ray(self) -> int:
        """Number of steps of a ray: fewer while the grid is coarser, as in TensoRF, so that a step always crosses about
        as many cells."""
        share = max(self.field.shape.nodes) / self._options.grid.grid_nodes
        return max(1, round(self._options.rays.ray_samples * share))

    def look_for_empty_cells(self, generator: torch.Generator) -> None:
        """Update the cells in which rays aren't sampled."""
        self.occupancy.update(self.field, PER_RAY / self.steps_of_a_ray, generator)

    def see(self, origins: Tensor, directions: Tensor, offsets: Tensor) -> RaysSeen:
        """Render world rays (R, 3), with directions of length 1 in z of their camera; differentiable. offsets: (R,) in
        [0, 1), the place of a sample in its step."""
        pieces = self.space.pieces(origins, directions)
        views = torch.nn.functional.normalize(directions, dim=1).repeat(len(pieces), 1)
        samples = self._samples(pieces, offsets)
        found = self.field.render(joined(pieces), views, samples, self._options.rays.least_weight)
        seen = RaysSeen.of(found, pieces)
        if self.surroundings is None:
            return seen
        behind = (1 - seen.opacity)[:, None] * self.surroundings.seen(directions)
        return replace(seen, color=seen.color + behind)

    def _samples(self, pieces: Sequence[CubeRays], offsets: Tensor) -> RaySamples:
        """The samples of the pieces of rays, one piece of all rays after the other."""
        found = []
        for share, alike in itertools.groupby(zip(self.space.sampling, pieces, strict=True), key=lambda pair: pair[0]):
            own, count = [piece for _, piece in alike], max(1, round(share * self.steps_of_a_ray))
            found.append(self.occupancy.samples(joined(own), count, offsets.repeat(len(own))))
        return RaySamples.joined(found)

    def disparity(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R,) 1 / z in the cameras' frames, 1 / scene unit, of the mean place of what `see` found; differentiable.

        Rays that met nothing count as if they had met something at their end.
        """
        return (seen.weights / self.space.depths(origins, directions, seen.places)).sum(0)

    def features_met(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R, C) `GridField.features` at the mean place of what `see` found; differentiable with respect to the field
        alone."""
        with torch.no_grad():
            pieces = self.space.pieces(origins, directions)
            points = torch.stack([piece.points(place) for piece, place in zip(pieces, seen.places, strict=True)])
            most = seen.weights.argmax(0)
            met = points.gather(0, most[None, :, None].expand(1, -1, 3))[0]
        return self.field.features(met)

    def features_along(self, origins: Tensor, directions: Tensor, count: int) -> Tensor:
        """(R, count, C) the same in the middle of each of `count` equal parts of the rays."""
        with torch.no_grad():
            pieces = self.space.pieces(origins, directions)
            shares = (torch.arange(count, device=origins.device) + 0.5) / count
            points = points_along(pieces, shares)
        return self.field.features(points.reshape(-1, 3)).view(len(origins), count, -1)

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        """Render a sharp view, with the depth of the mean place of what a ray meets."""
        device = self.device
        table, places = CameraTable([camera], device), whole_image(camera, device)
        colours, depths = [], []
        for part in places.split(_RAYS_AT_ONCE):
            origins, directions = table.rays(torch.zeros(len(part), dtype=torch.int64, device=device), part)
            seen = self.see(origins, directions, torch.full((len(part),), 0.5, device=device))
            colours.append(seen.color)
            depths.append(self._depth(origins, directions, seen))
        shape = camera.height, camera.width
        image = torch.cat(colours).view(*shape, 3).clamp(0, 1).numpy(force=True)
        return Rendering(image, torch.cat(depths).view(shape).numpy(force=True))

    def _depth(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R,) z of what the rays met, 0 where they met nothing."""
        met = seen.opacity >= _LEAST_OPACITY
        shares = seen.met / seen.opacity.clamp_min(_LEAST_OPACITY)
        disparity = (shares / self.space.depths(origins, directions, seen.met_places)).sum(0)
        return torch.where(met, 1 / disparity, 0.0)
