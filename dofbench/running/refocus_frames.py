"""Refocus frames of a finished run: one test view at several focus distances, kept next to the result."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.images import write_webp
from dofbench.core.lens import PhysicalLens
from dofbench.methods.cards import find_method
from dofbench.running.load_run import LoadedRun
from dofbench.running.usual_lens import focus_range, usual_opening

if TYPE_CHECKING:
    from dofbench.core.contracts import Method
    from dofbench.datasets.format.dataset import Dataset, DatasetView

FOLDER, RECORD = "refocus", "refocus.json"
FRAMES, SIDE = 7, 400  # px: the longer side at most
_VERSION = 1  # of how frames are made
_PATIENCE = 5.0  # s, for a frame


def refocus_frames(run: LoadedRun) -> tuple[Path, ...]:
    """The frames of the first test view, far to near; empty for a method that can't refocus.

    The focus is at evenly spaced disparities, from the farthest to the nearest of the scene; the aperture is the median
    of the learned ones, or 1 without any. Frames of the same model that are there already aren't rendered again. Raises
    InputError without a test view, a kept model or the dataset, for a frame that takes over 5 s, and for a method that
    renders no depth where the dataset states no range.
    """
    if not find_method(run.result.spec.method).card.capabilities.refocus:
        return ()
    if not run.result.views:
        raise InputError(run.folder, "no test view", "one to refocus")
    name, folder = run.result.views[0].name, run.folder / FOLDER
    files = tuple(folder / f"{index}.webp" for index in range(1, FRAMES + 1))
    digest = sha256_text(canonical_json([_VERSION, FRAMES, SIDE, name, sorted(run.result.model.items())]))
    record = folder / RECORD
    kept = read_json(record) if record.is_file() else None
    if kept == {"digest": digest, "frames": FRAMES} and all(file.is_file() for file in files):
        return files
    if kept == {"digest": digest, "frames": 0}:
        return ()
    rendered = _rendered(run.method, run.dataset, run.dataset.view(name))
    for file, image in zip(files, rendered, strict=False):
        write_webp(file, image)
    write_json(record, {"digest": digest, "frames": len(rendered)})
    return files if rendered else ()


def _rendered(method: Method, dataset: Dataset, view: DatasetView) -> list[np.ndarray]:
    """The frames, each (H, W, 3) encoded in [0, 1]; none where the method raises that it can't refocus."""
    factor = min(1.0, SIDE / max(view.camera.width, view.camera.height))
    camera = view.camera.resized(round(view.camera.width * factor), round(view.camera.height * factor))
    bounds = focus_range(method, dataset, camera)
    aperture = usual_opening(method, dataset, bounds) * camera.fx
    images, times = [], [time.monotonic()]
    for focus in np.linspace(bounds.q_min, bounds.q_max, FRAMES).tolist():
        try:
            image = method.render(camera, PhysicalLens(aperture, focus, camera.width)).image
        except ValueError:
            return []
        images.append(np.clip(image, 0.0, 1.0))
        times.append(time.monotonic())
        took = times[-1] - times[-2]
        if len(images) > 1 and took > _PATIENCE:  # the first also compiles
            raise InputError("refocus frames", f"{took:.0f} s a frame", f"at most {_PATIENCE:g} s")
    return images
