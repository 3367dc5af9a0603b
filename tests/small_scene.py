"""Two planes of coloured points before three small cameras: a scene on which a training takes a second."""

from __future__ import annotations

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.gaussians.gaussian_options import GaussianOptions

WIDTH, HEIGHT = 48, 36


class Recorder:
    """An observer that keeps every loss and can stop after some steps."""

    def __init__(self, stop_after=None):
        self.losses, self._stop_after = [], stop_after

    def seconds(self):
        return 0.0

    def after_step(self, step, loss):
        self.losses.append(loss)
        return self._stop_after is None or step < self._stop_after

    def stage(self, name, done, total):
        pass


def cameras():
    """Three cameras that look along z."""
    found = []
    for x, y in [(-0.3, 0.0), (0.3, 0.1), (0.0, -0.2)]:
        pose = np.eye(4)
        pose[:2, 3] = -x, -y
        found.append(Camera(WIDTH, HEIGHT, 45.0, 45.0, WIDTH / 2, HEIGHT / 2, pose))
    return found


def training_set(bad_view=None):
    """Coloured points on two planes, seen by three cameras; images are splats of those points."""
    random = np.random.default_rng(0)
    depth = np.where(random.uniform(size=250) < 0.5, 3.0, 6.0)
    xyz = np.stack([random.uniform(-0.5, 0.5, 250) * depth, random.uniform(-0.4, 0.4, 250) * depth, depth], axis=1)
    points = PointCloud(xyz, random.uniform(size=(250, 3)).astype(np.float32), np.zeros(250, np.float32))
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


def options(**overrides):
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
