"""The small scene in a quarter of its size, of fewer points, and a field for it: what a Triton interpreter can train
on."""

from __future__ import annotations

import numpy as np
from made_up import cloud
from small_scene import training_set

from dofbench.core.contracts import TrainingSet, TrainingView

_POINTS, _SMALLER = 12, 4
# Options of a radiance field with few rays, samples and nodes, whose cells are looked at from the first steps on.
TINY_FIELD = {"batch_pixels": 12, "ray_samples": 6, "grid_nodes": 6, "grid_nodes_first": 5, "grid_grows": 1}
TINY_FIELD |= {"colour_rank": 8, "cells": 4, "cells_from": 0.0, "cells_every": 2}


def tiny_scene(bad_view: int | None = None) -> TrainingSet:
    """Three photographs of 12 x 9 pixels, and 12 points. bad_view: the view with a NaN in its photograph."""
    scene = training_set(bad_view)
    views = []
    for view in scene.views:
        height, width = view.camera.height // _SMALLER, view.camera.width // _SMALLER
        image = view.image.reshape(height, _SMALLER, width, _SMALLER, 3).mean((1, 3))
        views.append(TrainingView(view.name, view.camera.resized(width, height), np.ascontiguousarray(image)))
    return TrainingSet(tuple(views), cloud(scene.points.xyz[:_POINTS], rgb=scene.points.rgb[:_POINTS]))
