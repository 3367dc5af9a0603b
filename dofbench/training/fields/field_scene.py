"""A radiance field in its place in the scene: what world rays see, for training and for rendering."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.runtime.factored_grid import RaySamples
from dofbench.training.fields.cube_rays import PER_RAY, CubeRays, Space, joined, points_along
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.grid_field import GridField
from dofbench.training.fields.occupancy import Occupancy
from dofbench.training.fields.pixels import CameraTable, whole_image
from dofbench.training.fields.rays_seen import RaysSeen
from dofbench.training.fields.surroundings import Surroundings

_CHUNK = 8192  # rays rendered at once
_LEAST_OPACITY = 1e-3  # of a ray that has a depth


class FieldScene:
    """A field, the space that it fills, what lies behind that, and which of its cells are empty, on the field's device.

    surroundings: None if the space has none.
    """

    def __init__(self, field: GridField, space: Space, options: FieldOptions, surroundings: Surroundings | None = None):
        self.field, self.space, self._options, self.surroundings = field, space, options, surroundings
        self.occupancy = Occupancy(options.rays.cells, options.rays.cells_absorb, field.device)

    @property
    def device(self) -> torch.device:
        """Where rays are seen."""
        return self.field.device

    @property
    def parameters(self) -> dict[str, Tensor]:
        """What is learned, by name: leaf tensors."""
        behind = {} if self.surroundings is None else {"surroundings": self.surroundings.logits}
        return self.field.parameters | behind

    @property
    def steps_of_a_ray(self) -> int:
        """Into how many steps a ray is divided; a piece of it into a share of these. While the grid is coarser than at
        the end they are longer, as in TensoRF, so that a step always crosses about as many cells."""
        share = max(self.field.shape.nodes) / self._options.grid.grid_nodes
        return max(1, round(self._options.rays.ray_samples * share))

    def look_for_empty_cells(self, generator: torch.Generator) -> None:
        """Find out anew which cells rays needn't be sampled in."""
        self.occupancy.update(self.field, PER_RAY / self.steps_of_a_ray, generator)

    def see(self, origins: Tensor, directions: Tensor, offsets: Tensor) -> RaysSeen:
        """What world rays (R, 3) see, whose directions have the length 1 in z of their camera; differentiable. offsets:
        (R,) in [0, 1), where in its step a sample lies."""
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
        """Where the pieces of rays are looked at, one piece of all rays after the other."""
        found = []
        for share, alike in itertools.groupby(zip(self.space.sampling, pieces, strict=True), key=lambda pair: pair[0]):
            own, count = [piece for _, piece in alike], max(1, round(share * self.steps_of_a_ray))
            found.append(self.occupancy.samples(joined(own), count, offsets.repeat(len(own))))
        return RaySamples.joined(found)

    def disparity(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R,) 1 / z in the cameras' frames of the mean place of what the rays met; see `RayScene.disparity`."""
        return (seen.weights / self.space.depths(origins, directions, seen.places)).sum(0)

    def features_met(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R, C); see `RayScene.features_met`."""
        with torch.no_grad():
            pieces = self.space.pieces(origins, directions)
            points = torch.stack([piece.points(place) for piece, place in zip(pieces, seen.places, strict=True)])
            most = seen.weights.argmax(0)
            met = points.gather(0, most[None, :, None].expand(1, -1, 3))[0]
        return self.field.features(met)

    def features_along(self, origins: Tensor, directions: Tensor, count: int) -> Tensor:
        """(R, count, C); see `RayScene.features_along`."""
        with torch.no_grad():
            pieces = self.space.pieces(origins, directions)
            shares = (torch.arange(count, device=origins.device) + 0.5) / count
            points = points_along(pieces, shares)
        return self.field.features(points.reshape(-1, 3)).view(len(origins), count, -1)

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        """A sharp view, and its depth: the mean place of what a ray meets."""
        device = self.device
        table, places = CameraTable([camera], device), whole_image(camera, device)
        colours, depths = [], []
        for part in places.split(_CHUNK):
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
