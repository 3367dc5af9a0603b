"""Two planes of coloured points before three small cameras: a scene on which a training takes a second."""

from __future__ import annotations

from typing import Any

import numpy as np
from made_up import cloud, frontal

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.training.gaussians.gaussian_options import GaussianOptions

WIDTH, HEIGHT = 48, 36


def cameras() -> list[Camera]:
    """Three cameras that look along z."""
    return [frontal(WIDTH, HEIGHT, 45.0, (x, y, 0.0)) for x, y in [(-0.3, 0.0), (0.3, 0.1), (0.0, -0.2)]]


def training_set(bad_view: int | None = None) -> TrainingSet:
    """Coloured points on two planes, seen by three cameras; images are splats of those points."""
    random = np.random.default_rng(0)
    depth = np.where(random.uniform(size=250) < 0.5, 3.0, 6.0)
    xyz = np.stack([random.uniform(-0.5, 0.5, 250) * depth, random.uniform(-0.4, 0.4, 250) * depth, depth], axis=1)
    points = cloud(xyz, rgb=random.uniform(size=(250, 3)))
    views = []
    for index, camera in enumerate(cameras()):
        image = np.full((HEIGHT, WIDTH, 3), 0.3, dtype=np.float32)
        xy, z = camera.project(xyz)
        for i in np.argsort(-z):
            column, row = int(xy[i, 0]), int(xy[i, 1])
            image[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = points.rgb[i]
        if index == bad_view:
            image[4, 5, 1] = np.nan
        views.append(TrainingView(f"v{index}", camera, image))
    return TrainingSet(tuple(views), points)


def options(**overrides: Any) -> GaussianOptions:
    """A short schedule."""
    return GaussianOptions().with_overrides(
        {
            "steps": 90,
            "sh_degree": 1,
            "densify_from": 0.1,
            "densify_every": 20,
            "normal_from": 0.5,
            "reset_every": 0.0,
            **overrides,
        }
    )


def field_options(**overrides: Any) -> dict[str, Any]:
    """A short schedule of a radiance field."""
    return {
        "steps": 240,
        "batch_pixels": 300,
        "ray_samples": 32,
        "grid_nodes": 40,
        "grid_nodes_first": 20,
        "grid_grows": 1,
        "cells": 16,
        "density_shift": -3.0,
        **overrides,
    }


def noise() -> TrainingSet:
    """Two views, a and b, whose one photograph is noise, and 300 points of any colour."""
    random = np.random.default_rng(1)
    xyz = np.stack([random.uniform(-2, 2, 300), random.uniform(-1.5, 1.5, 300), random.uniform(3, 6, 300)], axis=1)
    points = cloud(xyz, rgb=random.uniform(size=(300, 3)))
    image = random.uniform(size=(30, 40, 3)).astype(np.float32)
    a, b = (TrainingView(name, frontal(40, 30, 40.0, (x, 0.0, 0.0)), image) for name, x in (("a", 0.0), ("b", -0.2)))
    return TrainingSet((a, b), points)
