"""All ops of the model by name, and what is timed as a whole: training steps, and a view of stereo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gpu_work_field as field
import gpu_work_scatter as scatter
import gpu_work_stereo as stereo
import gpu_work_training as training
from gpu_sizes import Sizes
from gpu_sizes_field import FieldSizes, cells_of
from gpu_sizes_stereo import CHECKED, StereoSizes, levels
from gpu_work import Kernel, Op
from gpu_work_pictures import COLOURS, KNOWN_DEPTH, MIXTURE, SSIM, SURFACE, TONE
from gpu_work_rasterize import FROM_CENTRE, FROM_POINTS

OPS: dict[str, Op] = {
    "tone": TONE,
    "ssim": SSIM,
    "surface": SURFACE,
    "known_depth": KNOWN_DEPTH,
    "colours": COLOURS,
    "mix": MIXTURE,
    "rasterize": FROM_CENTRE,
    "rasterize_from_points": FROM_POINTS,
    "scatter": scatter.BOTH,
    "scatter_direct": scatter.DIRECT,
    "scatter_linear": scatter.LINEAR,
    "scatter_direct_polygon": scatter.DIRECT_POLYGON,
    "scatter_linear_polygon": scatter.LINEAR_POLYGON,
    "field_samples": field.SAMPLES,
    "field": field.SEEN,
    "field_density": field.DENSITIES,
    "field_features": field.FEATURES,
    "stereo": stereo.SWEEP,
    "stereo_upsample": stereo.UPSAMPLE,
    "stereo_semiglobal": stereo.SEMIGLOBAL,
    "stereo_returns": stereo.RETURNS,
    "training": training.GAUSSIANS,
    "training_points": training.MEAN_OF_POINTS,
    "training_field": field.TRAINING,
}
CELLS_EVERY = 32  # steps, after which a field's empty cells are looked for: dofbench/fields/field_options.py


@dataclass(frozen=True)
class Call:
    """An op as a task calls it. calls: how often."""

    op: str
    sizes: Any
    calls: float = 1.0
    backward: bool = True


@dataclass(frozen=True)
class Task:
    """What is timed as a whole. stages: in the order of its table. beside: stages that are shown and not added up, as
    they aren't in every such task."""

    name: str
    calls: tuple[Call, ...]
    stages: tuple[str, ...]
    beside: tuple[str, ...] = ()


def kernels() -> tuple[Kernel, ...]:
    """One of each machine code."""
    known: dict[tuple[str, str, str], Kernel] = {}
    for op in OPS.values():
        for kernel in op.kernels:
            known.setdefault(kernel.code, kernel)
    return tuple(known.values())


def training_step(sizes: Sizes) -> Task:
    """A step of Gaussians with a lens that scatters, and BAGS' mixture, which isn't in it."""
    calls = (
        Call("rasterize", sizes),
        Call("surface", sizes),
        Call("tone", sizes, 2),
        Call("scatter", sizes),
        Call("colours", sizes),
        Call("ssim", sizes),
        Call("known_depth", sizes),
        Call("training", sizes),
        Call("mix", sizes),
    )
    stages = (
        "projection", "lists", "sort", "blend forward", "lens forward", "loss", "lens backward", "blend backward",
        "projection backward", "Adam", "small operations",
    )  # fmt: skip
    return Task(sizes.name, calls, stages)


def scatter_forms(sizes: Sizes) -> tuple[Task, ...]:
    """The forms of the scatter that a training step doesn't show, all tiles in one of them."""
    forms = {"linear form, discs": "linear", "direct form, hexagons": "direct_polygon",
             "linear form, hexagons": "linear_polygon"}  # fmt: skip
    return tuple(
        Task(
            f"The scatter's {name}, {sizes.radius:.0f} px", (Call(f"scatter_{op}", sizes),),
            ("lens forward", "lens backward"),
        )
        for name, op in forms.items()
    )  # fmt: skip


def points_step(sizes: Sizes) -> Task:
    """A step of Gaussians with a lens that is sampled: the pictures from all points are decoded, their mean is encoded.
    The sharp view, which every fourth step needs for its depth, isn't in it."""
    every = replace(sizes, height=sizes.points * sizes.height)
    calls = (
        Call("rasterize_from_points", sizes),
        Call("tone", every),
        Call("training_points", sizes),
        Call("tone", sizes),
        Call("colours", sizes),
        Call("ssim", sizes),
        Call("training", sizes),
    )
    return Task(f"{sizes.name}, {sizes.points} points", calls, training_step(sizes).stages)


def field_step(sizes: FieldSizes, points: FieldSizes) -> Task:
    """A step of a field whose rays learn; besides, the densities by which its empty cells are found now and then, and
    the features that DP-NeRF reads. points: along the rays, at which it reads them."""
    calls = (
        Call("field_samples", sizes),
        Call("field", sizes),
        Call("training_field", sizes),
        Call("field_density", cells_of(sizes), backward=False),
        Call("field_features", points),
    )
    stages = (
        "samples", "densities", "along rays", "colours", "cells", "to planes and lines", "sums at nodes", "Adam",
        "smoothness", "small operations",
    )  # fmt: skip
    return Task(sizes.name, calls, stages, ("empty cells", "features"))


def stereo_view(view: StereoSizes) -> Task:
    """One view: its levels from the coarsest, paths through the scores of the finest, and the check against others."""
    calls = []
    for level in levels(view):
        calls.append(Call("stereo", level, backward=False))
        if level.coarse_planes:
            calls.append(Call("stereo_upsample", level, backward=False))
    calls += [Call("stereo_semiglobal", view, backward=False), Call("stereo_returns", view, CHECKED, backward=False)]
    return Task(view.name, tuple(calls), ("sweep", "coarser level", "paths", "choice", "check"))
