"""A scene as every reader gives it: views with lazy images, points, a split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from dofbench.cameras import Camera
from dofbench.contracts import PointCloud
from dofbench.errors import InputError

Split = Literal["train", "test"]


@dataclass(frozen=True, eq=False)
class SceneView:
    """One view. `image()` reads it: (H, W, 3) float32, encoded, undistorted, at the camera's size.

    `depth()` gives exact z-depth (H, W) float32, scene units, 0 where unknown; None when the
    scene has none. `source` is the file behind the image, for messages and provenance.
    """

    name: str
    camera: Camera
    image: Callable[[], np.ndarray]
    source: Path
    split: Split = "train"
    depth: Callable[[], np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """All-in-focus views with poses. `views` are sorted by name; names carry no suffix.

    points.views, where known, index into `views`. layout: the reader's id.
    """

    name: str
    root: Path
    layout: str
    views: tuple[SceneView, ...]
    points: PointCloud | None

    def with_hold(self, hold: int) -> Scene:
        """Views 0, hold, 2 hold, ... in name order become test views, the others training views.

        Raises InputError unless hold is at least 2 and leaves a view to train on.
        """
        if hold < 2 or len(self.views) < 2:
            found = f"hold {hold} for {len(self.views)} view{'s' if len(self.views) != 1 else ''}"
            raise InputError(self.root, found, "hold of at least 2 and two views or more: one to train, one to test")
        views = tuple(
            replace(view, split="test" if index % hold == 0 else "train") for index, view in enumerate(self.views)
        )
        return replace(self, views=views)
