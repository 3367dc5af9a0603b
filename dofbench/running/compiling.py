"""JIT compilation before a run's clock starts: in the background first, then by a step on small images."""

from __future__ import annotations

from dataclasses import replace

from dofbench.core.contracts import TrainingSet
from dofbench.core.images import resize
from dofbench.methods.cards import MethodEntry
from dofbench.runtime.compilation import compile_ahead
from dofbench.runtime.devices import kind_of

_COMPILED_HERE = ("tone", "scatter")  # their forward passes, by make-dataset
_WIDEST = 96  # pixels of the warm-up's images: enough to run every kernel, too few to spend time on


def start_compiling(entry: MethodEntry, device: str) -> None:
    """Compile the method's kernels in the background, those first that making a dataset doesn't compile here."""
    if kind_of(device) == "cpu" and not entry.card.elsewhere:
        compile_ahead(sorted(entry.card.kernels, key=_COMPILED_HERE.__contains__))


def miniature(training_set: TrainingSet) -> TrainingSet:
    """The training set with images of at most 96 pixels a side, and cameras to match, for the warm-up.

    Kernels compile for types, not for sizes, so they compile as training needs them, while work on the images before
    the first step (a depth prior) costs next to nothing.
    """
    views = []
    for view in training_set.views:
        share = min(1.0, _WIDEST / max(view.camera.width, view.camera.height))
        width, height = (max(1, round(side * share)) for side in (view.camera.width, view.camera.height))
        image = resize(view.image, width, height)
        views.append(replace(view, camera=view.camera.resized(width, height), image=image, mask=None))
    return replace(training_set, views=tuple(views))
