"""The radiance field's parameters: a factorised grid that grows finer during training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.factored_grid import FieldRender, GridShape, RaySamples
from dofbench.runtime.ops import load
from dofbench.training.fields.cube_rays import CubeRays

_START = 0.1  # standard deviation of a plane's and a line's numbers at the start (TensoRF's code)
PARAMETERS = ("density", "colour", "basis")


@dataclass(frozen=True)
class GridOptions:
    """The size of the grid, and how it grows."""

    grid_nodes: int = 256
    """Nodes along the grid's longest axis at the end. Unit: none. Source: own; 640 on LLFF in TensoRF."""
    grid_nodes_first: int = 96
    """The same at the start. Unit: none. Source: own; TensoRF's ratio on LLFF is one to five."""
    grid_grows: int = 4
    """In how many equal ratios the grid grows from the first to the last size. Unit: none. Source: own; TensoRF 5."""
    grid_grown: float = 0.35
    """When it has its last size. Unit: share of the training. Source: own; TensoRF 0.22."""
    surroundings_nodes: int = 128
    """Nodes along each side of the square of directions on which lies what is behind a scene seen from all around.
    Unit: none. Source: own."""
    density_rank: int = 8
    """Channels of each mode of the density, a multiple of 8. Unit: none. Source: TensoRF on LLFF: 16, 4, 4."""
    colour_rank: int = 16
    """Channels of each mode of the colour, a multiple of 8. Unit: none. Source: TensoRF on LLFF: 48, 12, 12."""
    sh_degree: int = 2
    """Degree of the spherical harmonics of a colour, 0 to 2. Unit: none. Source: own; TensoRF-SH."""
    density_shift: float = -4.0
    """Added to the density's channels before the softplus, so that space is empty at first. Unit: none. Source: own;
    TensoRF -10 in units of its own."""

    def __post_init__(self) -> None:
        if self.grid_grows < 1:
            raise InputError("option grid_grows", str(self.grid_grows), "at least 1")
        if self.surroundings_nodes < 2:
            raise InputError("option surroundings_nodes", str(self.surroundings_nodes), "at least 2")
        if not 2 <= self.grid_nodes_first <= self.grid_nodes:
            raise InputError("option grid_nodes_first", str(self.grid_nodes_first), f"2 to {self.grid_nodes}")
        for name in ("density_rank", "colour_rank"):
            rank = getattr(self, name)
            if rank < 8 or rank % 8:
                raise InputError(f"option {name}", str(rank), "a multiple of 8")
        if self.sh_degree not in (0, 1, 2):
            raise InputError("option sh_degree", str(self.sh_degree), "0, 1 or 2")

    def nodes(self, progress: float) -> int:
        """Nodes along the longest axis at `progress`, 0 to 1."""
        done = (
            1.0 if progress >= self.grid_grown else int(self.grid_grows * progress / self.grid_grown) / self.grid_grows
        )
        return round(self.grid_nodes_first * (self.grid_nodes / self.grid_nodes_first) ** done)

    @property
    def feature_count(self) -> int:
        """C of `GridField.features`, whatever the nodes."""
        return self.shape((2, 2, 2)).feature_count

    def shape(self, nodes: Sequence[int]) -> GridShape:
        """The grid with these nodes along x, y and z."""
        x, y, z = nodes
        return GridShape((x, y, z), self.density_rank, self.colour_rank, (self.sh_degree + 1) ** 2)


class GridField:
    """Density and colour in the unit cube. parameters: `PARAMETERS` by name, leaf tensors as in the kernel."""

    def __init__(self, shape: GridShape, parameters: dict[str, Tensor], shift: float):
        self.shape, self.shift = shape, shift
        self.parameters = {name: parameters[name].detach().contiguous().requires_grad_() for name in PARAMETERS}

    @staticmethod
    def at_random(
        shape: GridShape, shift: float, generator: torch.Generator, device: torch.device | str = "cpu"
    ) -> GridField:
        """Draw a nearly empty field by the host's generator, the same on every device."""
        sizes = {"density": (shape.density_size,), "colour": (shape.colour_size,), "basis": shape.basis_shape}
        drawn = {name: _START * torch.randn(size, generator=generator).to(device) for name, size in sizes.items()}
        return GridField(shape, drawn, shift)

    @property
    def device(self) -> torch.device:
        """The parameters' device."""
        return self.parameters["density"].device

    def render(self, rays: CubeRays, views: Tensor, samples: RaySamples, least_weight: float) -> FieldRender:
        """Render the rays. views: (R, 3), unit directions in the world, on which colours depend."""
        # With `output_size` the host needn't wait for a device to add up the samples.
        gain = torch.repeat_interleave(rays.gain.detach(), samples.starts.diff(), output_size=len(samples.places))
        seen: FieldRender = load("field")(
            **self.parameters,
            origins=rays.origins.contiguous(),
            directions=rays.directions.contiguous(),
            views=views.contiguous(),
            starts=samples.starts,
            places=samples.places,
            lengths=samples.steps * gain,
            shape=self.shape,
            shift=self.shift,
            least_weight=least_weight,
        )
        return seen

    @torch.no_grad()
    def density(self, points: Tensor) -> Tensor:
        """(P,) density at points (P, 3) of the cube."""
        found: Tensor = load("field", function="field_density")(
            self.parameters["density"].detach(), points, shape=self.shape, shift=self.shift
        )
        return found

    def features(self, points: Tensor) -> Tensor:
        """(P, C) products of planes and lines at points (P, 3) of the cube, before the sums: the density's channels,
        then the colour's, mode by mode; differentiable with respect to the field. Points outside count as on the
        border."""
        grids = self.parameters["density"], self.parameters["colour"]
        found: Tensor = load("field", function="field_features")(*grids, points, shape=self.shape)
        return found

    @torch.no_grad()
    def resized(self, shape: GridShape) -> GridField:
        """Interpolate the field at other nodes."""
        found = {"basis": self.parameters["basis"]}
        for name, rank in self._ranks().items():
            flat = self.parameters[name].detach()
            resized = flat.new_empty(shape.density_size if name == "density" else shape.colour_size)
            (planes, lines), (new_planes, new_lines) = self.shape.parts(flat, rank), shape.parts(resized, rank)
            for old, new in zip(planes, new_planes, strict=True):
                new.copy_(_interpolated(old, new.shape[:2]))
            for old, new in zip(lines, new_lines, strict=True):
                new.copy_(_interpolated(old[None], (1, len(new)))[0])
            found[name] = resized
        return GridField(shape, found, self.shift)

    def roughness(self) -> dict[str, Tensor]:
        """Mean squared difference of the planes' neighbouring nodes, of density and colour (TensoRF, section 4.4);
        differentiable."""
        ranks = self._ranks()
        return {name: _Roughness.apply(self.parameters[name], self.shape, rank) for name, rank in ranks.items()}

    def _ranks(self) -> dict[str, int]:
        return {"density": self.shape.density_rank, "colour": self.shape.colour_rank}


class _Roughness(torch.autograd.Function):
    """Roughness of the planes in a flat tensor. Its gradient is written by hand: torch would fill a tensor of the
    grid's size with zeros for every view of a plane, which took longer than the differences."""

    @staticmethod
    def forward(context: Any, flat: Tensor, shape: GridShape, rank: int) -> Tensor:
        context.save_for_backward(flat)
        context.layout = shape, rank
        squares = [diff.square().mean() for plane in shape.planes(flat, rank) for diff in _differences(plane)]
        return torch.stack(squares).sum()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (flat,), (shape, rank) = context.saved_tensors, context.layout
        result = torch.zeros_like(flat)
        for plane, into in zip(shape.planes(flat, rank), shape.planes(result, rank), strict=True):
            for axis, diff in enumerate(_differences(plane)):
                diff.mul_(gradient * (2 / diff.numel()))
                into.narrow(axis, 1, diff.shape[axis]).add_(diff)
                into.narrow(axis, 0, diff.shape[axis]).sub_(diff)
        return result, None, None


def _differences(plane: Tensor) -> tuple[Tensor, Tensor]:
    """Differences of neighbouring rows, and of neighbouring columns."""
    return plane.diff(dim=0), plane.diff(dim=1)


def _interpolated(plane: Tensor, size: Sequence[int]) -> Tensor:
    """A (rows, columns, channels) plane at other nodes, the outermost at the same places."""
    moved = plane.permute(2, 0, 1)[None]
    found = torch.nn.functional.interpolate(moved, tuple(size), mode="bilinear", align_corners=True)
    return found[0].permute(1, 2, 0)
