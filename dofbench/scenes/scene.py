"""A scene as every reader gives it: views with lazy images, points, a split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.scenes.visibility import unmasked_points

Split = Literal["train", "test"]
# What a view's image is: all in focus, or taken by an unknown lens with shallow depth of field.
Photograph = Literal["all-in-focus", "shallow"]
# What an alpha channel means: a mask, or the share of what isn't background, which is black.
Alpha = Literal["mask", "background"]


@dataclass(frozen=True, eq=False)
class SceneView:
    """One view. `image()` reads it: (H, W, 3) float32, encoded, undistorted, at the camera's size, with masked pixels
    replaced by their nearest valid ones.

    source: the file behind the image. photograph: what the image is. exif: None where unknown. `depth()`: z-depth (H,
    W) float32, scene units, 0 where unknown. `mask()`: (H, W) bool, True for valid pixels. `linear()`: the image as
    linear light, not clipped at 1; None where the file is encoded.
    """

    name: str
    camera: Camera
    image: Callable[[], np.ndarray]
    source: Path
    split: Split = "train"
    depth: Callable[[], np.ndarray] | None = None
    photograph: Photograph = "all-in-focus"
    exif: Exif | None = None
    mask: Callable[[], np.ndarray] | None = None
    linear: Callable[[], np.ndarray] | None = None

    def __repr__(self) -> str:
        return f"SceneView({self.name!r}, {self.split}, {self.camera.width} x {self.camera.height} px)"


@dataclass(frozen=True, eq=False)
class Scene:
    """Views with poses, sorted by name; names carry no suffix.

    points.views, where known, index into `views`. layout: the reader's id. notes: what was chosen, changed or skipped
    while reading, one sentence each. offset: add it to coordinates of the local frame for those of the files
    (`local_frame.py`). split_by: the rule or file that made the split. places: of the views among all names of the
    files, where some were skipped for want of an image.
    """

    name: str
    root: Path
    layout: str
    views: tuple[SceneView, ...]
    points: PointCloud | None
    notes: tuple[str, ...] = ()
    offset: Offset = NO_OFFSET
    split_by: str = ""
    places: tuple[int, ...] | None = None

    def __repr__(self) -> str:
        points = "no points" if self.points is None else f"{len(self.points)} points"
        views = f"{len(self.views)} views, {len(self.test_views())} of them to test"
        return f"Scene({self.name!r}, {self.layout}, {views}, {points}, in {self.root})"

    def noted(self, *notes: str) -> Scene:
        """The scene with further notes; empty ones and repeated ones are dropped."""
        return replace(self, notes=tuple(dict.fromkeys([*self.notes, *filter(None, notes)])))

    @property
    def photographs(self) -> Photograph:
        """ "shallow" where training images are blurred by an unknown lens (test images may be sharp, to score
        all-in-focus renders); "all-in-focus" in nearly every layout."""
        return "shallow" if any(view.photograph == "shallow" for view in self.views) else "all-in-focus"

    def taken_as(self, train: Photograph, test: Photograph) -> Scene:
        """The scene with what the images of its training and test views are."""
        photograph = {"train": train, "test": test}
        return replace(self, views=tuple(replace(view, photograph=photograph[view.split]) for view in self.views))

    def with_hold(self, hold: int) -> Scene:
        """Make views 0, hold, 2 hold, ... in name order test views, the others training views; skipped views count.

        Raises InputError unless hold is at least 2 and leaves a view to train on and one to test.
        """
        if hold < 2 or len(self.views) < 2:
            found = f"hold {hold} for {len(self.views)} view{'s' if len(self.views) != 1 else ''}"
            raise InputError(self.root, found, "hold of at least 2 and two views or more: one to train, one to test")
        places = range(len(self.views)) if self.places is None else self.places
        views = tuple(
            replace(view, split="test" if place % hold == 0 else "train")
            for place, view in zip(places, self.views, strict=True)
        )
        if len({view.split for view in views}) < 2:
            found = f"hold {hold}, which leaves {views[0].split} views alone of the images that are here"
            raise InputError(self.root, found, "another --hold: one view at least to train, one to test")
        return replace(self, views=views)

    def with_half_trained(self) -> Scene:
        """Make every second test view, from the second, a training view. Raises InputError for fewer than two."""
        test = self.test_views()
        moved = {view.name for view in test[1::2]}
        if not moved:
            raise InputError(self.root, "fewer than two test views", "some to train on, and some to test")
        views = tuple(replace(view, split="train") if view.name in moved else view for view in self.views)
        return replace(self, views=views).noted(f"{len(moved)} of {len(test)} test views are trained on as well")

    def require_points(self, need: str) -> PointCloud:
        """The sparse points. need: what they are for. Raises InputError, with the command that finds some, where there
        are none."""
        if self.points is None or len(self.points) == 0:
            cure = f"points for {need}: dofbench reconstruct {self.root} --out SCENE keeps the poses and finds them"
            raise InputError(self.root, "no sparse points", cure)
        return self.points

    def training_set(self) -> TrainingSet:
        """The training views, read now, and the points seen in them (all points where tracks are unknown). Raises
        InputError for an unreadable image."""
        training = [index for index, view in enumerate(self.views) if view.split == "train"]
        views = tuple(
            TrainingView(view.name, view.camera, view.image(), view.exif, None if view.mask is None else view.mask())
            for view in (self.views[index] for index in training)
        )
        points = None if self.points is None else self.points.seen_by(training)
        return TrainingSet(
            views, unmasked_points(points, [view.camera for view in views], [view.mask for view in views]), self.offset
        )

    def unmasked(self) -> Scene:
        """The scene without sightings of points at masked pixels, and without points seen nowhere else."""
        masks = [None if view.mask is None else view.mask() for view in self.views]
        return replace(self, points=unmasked_points(self.points, [view.camera for view in self.views], masks))

    def test_views(self) -> tuple[SceneView, ...]:
        """The test views, sorted by name."""
        return tuple(view for view in self.views if view.split == "test")
