"""All options of the trainer of radiance fields."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.core.errors import InputError
from dofbench.training.common.options import OptionGroups
from dofbench.training.common.photograph_colours import ColourOptions
from dofbench.training.fields.grid_field import GridOptions


@dataclass(frozen=True)
class RayOptions:
    """How rays are drawn and sampled."""

    steps: int = 5000
    """Length of the training if the budget doesn't give it. Unit: steps. Source: own; 200 000 in NeRF."""
    batch_pixels: int = 1024
    """Pixels of a training step. Unit: none. Source: NeRF."""
    ray_samples: int = 128
    """Steps that a ray, or its piece in the box where views are from all around, is divided into when the grid has its
    last size, of which those in empty cells are skipped; in proportion fewer before. Each of its pieces beyond the box
    has a quarter as many. Unit: none. Source: own; NeRF 64 and 64; TensoRF two a cell."""
    least_weight: float = 1e-3
    """Weight below which a sample has no colour. Unit: none. Source: own; TensoRF 1e-4."""
    cells: int = 64
    """Cells along each side of the grid that knows which cells are empty. Unit: none. Source: own; 128 in
    Instant-NGP."""
    cells_from: float = 0.02
    """When empty cells begin to be skipped. Unit: share of the training. Source: own."""
    cells_every: int = 32
    """Interval at which cells are looked at. Unit: steps. Source: own; 16 in Instant-NGP."""
    cells_absorb: float = 0.01
    """Share of the light that a step through a cell must absorb for the cell not to be empty. Unit: none. Source:
    Instant-NGP."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch_pixels", "ray_samples", "cells", "cells_every"):
            if getattr(self, name) < 1:
                raise InputError(f"option {name}", str(getattr(self, name)), "at least 1")


@dataclass(frozen=True)
class FieldRates:
    """Learning rates, and the weights of the terms that keep the grid smooth."""

    grid_lr: float = 0.02
    """Adam's learning rate of planes and lines at the start. Unit: parameter, a step. Source: TensoRF."""
    basis_lr: float = 1e-3
    """The same of the matrix from channels to colours. Unit: parameter, a step. Source: TensoRF."""
    lr_final: float = 0.05
    """Share of the learning rates that is left at the end; they fall exponentially. Unit: none. Source: own; TensoRF
    0.1."""
    density_smooth: float = 0.01
    """Weight of the mean squared difference of neighbouring nodes of the density. Unit: none. Source: own."""
    colour_smooth: float = 0.01
    """The same of the colour. Unit: none. Source: own."""
    smooth_every: int = 4
    """Interval at which these terms act, so many times as strongly. Unit: steps. Source: own."""


@dataclass(frozen=True)
class FieldOptions(OptionGroups):
    """The options of a radiance field that presets in `method.toml` and `--set key=value` can set."""

    rays: RayOptions = RayOptions()
    grid: GridOptions = GridOptions()
    rates: FieldRates = FieldRates()
    colours: ColourOptions = ColourOptions()
