"""A few views of the built-in scene, small and shallow, with exact depth to compare with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dofbench.core.content import content_folder
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.images import resize
from dofbench.core.lens import DisparityRange, Lens
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import load_scene

WIDTH, HEIGHT, VIEWS = 160, 120, 6


@dataclass(frozen=True, eq=False)
class Photographed:
    """A training set, and the exact depth (H, W) of its views, which no prior may see."""

    training_set: TrainingSet
    truth: list[np.ndarray]

    def shares(self, maps, within: float) -> tuple[float, float]:
        """(share of all pixels that have depth, share of those within so much of the truth)."""
        found = np.stack([one.depth for one in maps])
        truth = np.stack(self.truth)
        known = found > 0
        return float(known.mean()), float((np.abs(found[known] / truth[known] - 1) < within).mean())


@pytest.fixture(scope="session")
def photographed() -> Photographed:
    """Six photographs by six lenses."""
    scene = load_scene(content_folder("datasets") / "tabletop")
    chosen = list(range(0, 2 * VIEWS, 2))
    views, truth = [], []
    sharp = [scene.views[index] for index in chosen]
    disparity_range = DisparityRange.of_disparity(np.concatenate([1 / view.depth().ravel() for view in sharp]))
    for place, view in enumerate(sharp):
        rows, columns = (
            ((np.arange(size) + 0.5) * factor).astype(int)
            for size, factor in ((HEIGHT, view.camera.height / HEIGHT), (WIDTH, view.camera.width / WIDTH))
        )
        depth = view.depth()[rows[:, None], columns]
        lens = Lens(aperture=(0.5, 1.0)[place % 2], focus=(0.2, 0.5, 0.8)[place % 3])
        image, _ = defocus_numpy(resize(view.image(), WIDTH, HEIGHT), depth, lens.physical(disparity_range, WIDTH))
        views.append(TrainingView(view.name, view.camera.resized(WIDTH, HEIGHT), image))
        truth.append(depth)
    assert scene.points is not None
    return Photographed(TrainingSet(tuple(views), scene.points.seen_by(chosen)), truth)
