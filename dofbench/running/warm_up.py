"""What a method is warmed up with: as many views and points as it will train on, and hardly any pixels."""

from __future__ import annotations

from dataclasses import replace

from dofbench.core.contracts import TrainingSet
from dofbench.core.images import resize

_WIDEST = 96  # pixels: enough to run every kernel, too few to spend time on


def miniature(training_set: TrainingSet) -> TrainingSet:
    """The training set with photographs of at most 96 pixels a side, and cameras to match.

    Kernels compile for kinds of numbers, not for sizes, so they compile as they will be needed, while
    what a method computes of the photographs before its first step (a depth prior) costs next to nothing.
    """
    views = []
    for view in training_set.views:
        share = min(1.0, _WIDEST / max(view.camera.width, view.camera.height))
        width, height = (max(1, round(side * share)) for side in (view.camera.width, view.camera.height))
        image = resize(view.image, width, height)
        views.append(replace(view, camera=view.camera.resized(width, height), image=image, mask=None))
    return replace(training_set, views=tuple(views))
