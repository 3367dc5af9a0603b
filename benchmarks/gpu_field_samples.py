"""How many samples the rays of a trained radiance field keep, and how they crowd in the cells of its grid, by rays of a
training step and nodes of the grid: field_samples.csv.

    python benchmarks/gpu_field_samples.py --out reports/gpu

A field with the preset of all methods of fields is trained on the built-in scene on the CPU. Then as many rays as a
step has are drawn from the photographs once more and sampled in the cells that are occupied. Which cells of a grid the
samples lie in doesn't depend on what it holds, so grids of other sizes are counted with the same samples. Nothing here
needs a GPU, and no time is measured.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
import tyro
from dofbench.kernels.field.reference import LEAST_TRANSMITTANCE
from gpu_sizes_field import ALONG, crowd
from gpu_torch_calls import field_options, training_set
from unobserved import Unobserved

from dofbench.compute.factored_grid import MODES
from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet
from dofbench.fields.field_options import FieldOptions
from dofbench.fields.field_scene import FieldScene
from dofbench.fields.field_trainer import FieldTrainer
from dofbench.fields.forward.pinhole_rays import PinholeRays
from dofbench.fields.pixels import CameraTable, TrainingPixels
from dofbench.reporting.csv_writer import write_csv

# As in kernels/field/gpu_grid_gradient.py: nodes of a plane that a program sums, and samples of each cell around them
# that it reads at once, where cells have few samples and where they are crowded; programs that share a cell of a line,
# and samples times channels that one of them reads at once.
FEW, MANY, PARTS, LISTED = (4, 2), (1, 8), 4, 1024
CHANNELS = {"density": 8, "colour": 16}  # read at once, of the ranks 8 and 16


@dataclass(frozen=True)
class Settings:
    """Which field is trained, how long, and what is counted."""

    out: Path
    """Folder for field_samples.csv."""
    rays: tuple[int, ...] = (1024, 8192)
    """Of a training step."""
    nodes: tuple[int, ...] = (200, 400)
    """Of the grid, along each axis."""
    width: int = 128
    """Of the pictures, pixels."""
    steps: int = 600
    """Of the training."""


@dataclass(frozen=True)
class Row:
    """A training step's rays. kind: "samples" that a ray's light is made of, or "points" along it whose features are
    read, which all count alike. steps: that each ray is divided into. samples: those of them that lie in occupied
    cells, a mean over the rays as the next two. looked_at: samples that light reaches. lit: samples with a colour.

    planes, lines: passes of the loops that sum at a grid's nodes, mean over the programs, and of the longest program;
    of the density and of the colour. some: share of the programs that have any.
    """

    kind: str
    rays: int
    nodes: int
    steps: int
    samples: float
    looked_at: float
    lit: float
    planes_density: float
    planes_density_longest: int
    planes_density_some: float
    planes_colour: float
    planes_colour_longest: int
    planes_colour_some: float
    lines_density: float
    lines_density_longest: int
    lines_colour: float
    lines_colour_longest: int


@dataclass(frozen=True, eq=False)
class Samples:
    """Of R rays. counts: (R,), how many each has. points: (S, 3) in the unit cube. looked_at, lit: (S,) bool."""

    counts: np.ndarray
    points: np.ndarray
    looked_at: np.ndarray
    lit: np.ndarray


def main(settings: Settings) -> None:
    """Train, count and write."""
    data, options = training_set(settings.width), field_options(grid_nodes=settings.nodes[0])
    trainer = FieldTrainer(data, options, PinholeRays(), 0)
    trainer.fit(Budget(steps=settings.steps), Unobserved())
    rows = []
    for rays in settings.rays:
        samples, points = drawn(trainer.scene, data, options, rays)
        for nodes in settings.nodes:
            rows += [row("samples", samples, trainer.scene.steps_of_a_ray, nodes), row("points", points, ALONG, nodes)]
    names = tuple(field.name for field in fields(Row))
    write_csv(settings.out / "field_samples.csv", names, [{name: getattr(one, name) for name in names} for one in rows])


@torch.no_grad()
def drawn(scene: FieldScene, data: TrainingSet, options: FieldOptions, count: int) -> tuple[Samples, Samples]:
    """The samples of `count` rays through pixels as training draws them, and the points along them."""
    pixels = TrainingPixels(data.views, np.random.default_rng(1)).draw(count)
    cameras = CameraTable([view.camera for view in data.views])
    (rays,) = scene.space.pieces(*cameras.rays(pixels.views, pixels.places))
    offsets = torch.rand(count, generator=torch.Generator().manual_seed(1))
    samples = scene.occupancy.samples(rays, scene.steps_of_a_ray, offsets)
    counts = samples.starts.diff()
    ray = torch.repeat_interleave(torch.arange(count), counts)
    points = rays.origins[ray] + samples.places[:, None] * rays.directions[ray]
    optical = (scene.field.density(points) * samples.steps * rays.gain[ray]).double()
    # What lies before each sample on its ray: a sum over all rays, less what it is where the ray begins.
    before = optical.cumsum(0) - optical
    before -= before[samples.starts[:-1].clamp_max(len(points) - 1)][ray]
    left = (-before).exp()
    looked_at = left >= LEAST_TRANSMITTANCE
    lit = looked_at & (left * -torch.expm1(-optical) >= options.rays.least_weight)
    begin, end = rays.spans.T
    along = begin[:, None] + (torch.arange(ALONG) + 0.5) / ALONG * (end - begin).clamp_min(0)[:, None]
    features = (rays.origins[:, None] + along[..., None] * rays.directions[:, None]).view(-1, 3)
    every = torch.ones(len(features), dtype=torch.bool)
    return (
        Samples(*(one.numpy() for one in (counts, points, looked_at, lit))),
        Samples(np.full(count, ALONG), features.numpy(), every.numpy(), every.numpy()),
    )


def row(kind: str, samples: Samples, steps: int, nodes: int) -> Row:
    """The figures of one draw in a grid. steps: that a ray is divided into."""
    rays, found = len(samples.counts), {}
    tile = MANY if crowd(samples.counts.sum(), nodes) else FEW
    for name, mask in (("density", samples.looked_at), ("colour", samples.lit)):
        cells = np.clip((samples.points[mask].clip(0, 1) * (nodes - 1)).astype(int), 0, nodes - 2)
        passes = {
            "planes": plane_passes(cells, nodes, *tile),
            "lines": line_passes(cells, nodes, LISTED // CHANNELS[name]),
        }
        for part, each in passes.items():
            found |= {f"{part}_{name}": float(each.mean()), f"{part}_{name}_longest": int(each.max())}
        found[f"planes_{name}_some"] = float((passes["planes"] > 0).mean())
    return Row(
        kind=kind,
        rays=rays,
        nodes=nodes,
        steps=steps,
        samples=float(samples.counts.mean()),
        looked_at=float(samples.looked_at.sum() / rays),
        lit=float(samples.lit.sum() / rays),
        **found,
    )


def plane_passes(cells: np.ndarray, nodes: int, together: int, each: int) -> np.ndarray:
    """Of each program of `add_to_planes`: as many as the fullest cell around its nodes needs. cells: (S, 3), whole
    numbers. together: nodes of a program. each: samples of a cell that it reads at a time."""
    fullest = []
    for column, row, _ in MODES:
        number = cells[:, row] * (nodes - 1) + cells[:, column]
        counts = np.bincount(number, minlength=(nodes - 1) ** 2).reshape(nodes - 1, nodes - 1)
        around = np.pad(counts, 1)
        fullest.append(np.max([around[:-1, :-1], around[1:, :-1], around[:-1, 1:], around[1:, 1:]], axis=0).reshape(-1))
    many = np.concatenate(fullest)
    return -(-np.pad(many, (0, -len(many) % together)).reshape(-1, together).max(1) // each)


def line_passes(cells: np.ndarray, nodes: int, each: int) -> np.ndarray:
    """Of each program of `add_in_line_cells`: a cell's samples are shared by so many."""
    counts = np.concatenate([np.bincount(cells[:, axis], minlength=nodes - 1) for _, _, axis in MODES])
    share = -(-counts // PARTS)
    own = np.clip(counts[:, None] - share[:, None] * np.arange(PARTS), 0, share[:, None])
    return -(-own.reshape(-1) // each)


if __name__ == "__main__":
    main(tyro.cli(Settings))
