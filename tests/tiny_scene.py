"""The small scene in a quarter of its size, of fewer points: what a Triton interpreter can train on."""

from __future__ import annotations

import numpy as np
from made_up import cloud
from small_scene import training_set

from dofbench.core.contracts import TrainingSet, TrainingView

_POINTS, _SMALLER = 12, 4


def tiny_scene(bad_view: int | None = None) -> TrainingSet:
    """Three photographs of 12 x 9 pixels, and 12 points. bad_view: the view with a NaN in its photograph."""
    scene = training_set(bad_view)
    views = []
    for view in scene.views:
        height, width = view.camera.height // _SMALLER, view.camera.width // _SMALLER
        image = view.image.reshape(height, _SMALLER, width, _SMALLER, 3).mean((1, 3))
        views.append(TrainingView(view.name, view.camera.resized(width, height), np.ascontiguousarray(image)))
    return TrainingSet(tuple(views), cloud(scene.points.xyz[:_POINTS], rgb=scene.points.rgb[:_POINTS]))
