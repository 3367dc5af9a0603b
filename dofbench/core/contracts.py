"""What a method sees, what it gives back, and what the harness tells it. Read this to add a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dofbench.core.budget import Budget
from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.errors import Status
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import check_floats
from dofbench.core.lens import PhysicalLens
from dofbench.core.masks import filled
from dofbench.core.stored_image import StoredField, StoredImage


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Sparse points of structure from motion.

    xyz: (P, 3) float64, scene units. rgb: (P, 3) float32, encoded, [0, 1]. error: (P,) float32,
    reprojection error in pixels, NaN where unknown. views: per point, the indices of the views
    that saw it (sorted as the scene's views are), or None where tracks are unknown.
    """

    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray
    views: tuple[np.ndarray, ...] | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points, {'with' if self.views is not None else 'without'} tracks)"

    def moved(self, by: Offset) -> PointCloud:
        """The points at their positions plus `by`, scene units; itself for no offset."""
        return self if by == NO_OFFSET else replace(self, xyz=self.xyz + np.array(by))

    def kept(self, keep: np.ndarray) -> PointCloud:
        """The points where `keep`, (P,) bool, is true, with their tracks."""
        tracks = self.views and tuple(track for track, kept in zip(self.views, keep, strict=True) if kept)
        return PointCloud(self.xyz[keep], self.rgb[keep], self.error[keep], tracks)

    def seen_from(self, view: int) -> np.ndarray:
        """(M,) indices of the points that view number `view` saw, in order. Raises ValueError where tracks are
        unknown."""
        if self.views is None:
            raise ValueError("points: expected tracks, found none")
        starts, points = self._by_view
        return points[starts[view] : starts[view + 1]] if 0 <= view < len(starts) - 1 else points[:0]

    @cached_property
    def _by_view(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each view's points begin, and after the last view's; the points of all views, one view after another.
        Looking through all points anew for each view would take a time that grows with the square of a scene."""
        tracks = self.views or ()
        views = np.concatenate([np.empty(0, np.int64), *tracks]).astype(np.int64)
        points = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
        count = int(views.max(initial=-1)) + 1
        found = np.unique(views * len(tracks) + points)
        return np.searchsorted(found, np.arange(count + 1) * len(tracks)), found % max(len(tracks), 1)

    def with_sightings(self, seen: Sequence[np.ndarray]) -> PointCloud:
        """The points with other tracks. seen: of each view, the indices of the points that it saw."""
        views = np.repeat(np.arange(len(seen)), [len(points) for points in seen])
        points = np.concatenate([np.empty(0, np.int64), *seen])
        views = views[np.argsort(points, kind="stable")]
        tracks = np.split(views, np.cumsum(np.bincount(points, minlength=len(self)))[:-1]) if len(self) else ()
        return replace(self, views=tuple(tracks))

    def seen_by(self, views: Sequence[int]) -> PointCloud:
        """The points that at least one of these views saw, with tracks that index into `views`.

        Where tracks are unknown: all points, as they are.
        """
        if self.views is None:
            return self
        found = self.with_sightings([self.seen_from(view) for view in views])
        assert found.views is not None
        return found.kept(np.array([len(track) > 0 for track in found.views], dtype=bool))


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One training photograph: image (H, W, 3) float32, encoded, [0, 1]. exif: what its camera wrote down, if any.

    An image of an 8-bit file is kept as its levels: each access to `image` makes the same floats anew, so read it once
    where it is used, and never hold all views' at once. stored: what is kept.

    mask: (H, W) bool, True for the pixels to train on; None where all are. Masked pixels of `image` are replaced by
    their nearest valid ones, so a method never receives what was under a mask. Raises ValueError for an image that
    isn't floats, and for a mask of another size or without a valid pixel.
    """

    name: str
    camera: Camera
    image: np.ndarray = StoredField()  # type: ignore[assignment]  # the descriptor reads as the image
    exif: Exif | None = None
    mask: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.stored.table is None:  # levels come from floats
            check_floats(f"image of view {self.name}", self.image)
        if self.mask is None:
            return
        mask, size = np.asarray(self.mask, bool), self.stored.values.shape[:2]
        if mask.shape != size or not mask.any():
            found = "no valid pixel" if mask.shape == size else f"shape {mask.shape}"
            raise ValueError(f"mask of view {self.name}: expected valid pixels, {size}, found {found}")
        object.__setattr__(self, "mask", None if mask.all() else mask)
        if self.mask is not None:
            object.__setattr__(self, "image", filled(self.image, mask))

    @property
    def stored(self) -> StoredImage:
        """The image as it is kept."""
        found: StoredImage = vars(self)["image"]
        return found

    def __repr__(self) -> str:
        height, width = self.stored.values.shape[:2]
        masked = "" if self.mask is None else ", masked"
        return f"TrainingView({self.name!r}, {width} x {height} px{masked})"


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """All that a method may see: never the true lens, the true depth, a test view's photograph or its camera.

    points: where tracks are known, those that at least one of `views` saw, and points.views index into `views`. Where
    they are unknown, all points of the scene, those that only test views saw among them. Points and the cameras' poses
    usually come from structure from motion on the sharp photographs of all views, test views included, as is usual in
    the field; a dataset's manifest says where its own come from (`dofbench.datasets.format.points_record`).
    offset: add it to coordinates here for those of the scene's files; zero unless these are far from their origin.
    """

    views: tuple[TrainingView, ...]
    points: PointCloud | None
    offset: Offset = NO_OFFSET

    def __repr__(self) -> str:
        points = "no points" if self.points is None else f"{len(self.points)} points"
        return f"TrainingSet({len(self.views)} views, {points})"


@dataclass(frozen=True)
class NonFinite:
    """A NaN or infinity, at the step where it appeared first."""

    step: int
    view: str
    stage: str
    detail: str


LENS_MEASURED = "lens_measured"  # stage of the decision whether a learned aperture may be stated as a number


@dataclass(frozen=True)
class Decision:
    """What training decided for itself, and the plan left open. stage: what the plan calls it. runs: whether it goes
    on. reason: why, with figures. figures: the same by name, unrounded (`gaussians/trials.py` says which)."""

    stage: str
    runs: bool
    reason: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FitOutcome:
    """How training ended: its status, with a message where that isn't `ok`, after so many steps. nonfinite: where a NaN
    or an infinity appeared. stages: wall seconds by part of the step, for the time table. left_out: parts of the method
    that were switched off by themselves, each with its reason. decisions: how training revised the plan. peak_mb: of
    resident memory of other processes that trained, MB."""

    status: Status
    steps: int
    message: str = ""
    nonfinite: tuple[NonFinite, ...] = ()
    stages: dict[str, float] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    decisions: tuple[Decision, ...] = ()
    peak_mb: float = 0.0


@dataclass(frozen=True, eq=False)
class Rendering:
    """image: (H, W, 3) float32, encoded. depth: (H, W) float32, scene units, 0 where empty.

    Raises InputError for an image that isn't floats.
    """

    image: np.ndarray
    depth: np.ndarray

    def __post_init__(self) -> None:
        check_floats("rendered image", self.image)

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        return f"Rendering({width} x {height} px)"

    def _repr_html_(self) -> str:
        from dofbench.core.notebook import as_html, disparity_picture

        return as_html(repr(self), [("image", self.image), ("disparity", disparity_picture(self.depth))])


class Observer(Protocol):
    """The harness's side of training: it owns the clock and stops it while it evaluates."""

    def seconds(self) -> float:
        """Training seconds so far, evaluation excluded: of wall or processor time, as the budget counts them."""

    def after_step(self, step: int, loss: float) -> bool:
        """Call after every step (1-based). Evaluates when one is due. False means: stop now.

        loss: of this step; a training on a device may tell that of an earlier one, so as not to wait for every step.
        """

    def stage(self, name: str, done: int, total: int) -> None:
        """Call where something takes long before the first step, or between steps: `done` of its `total` units are
        finished.

        0 says that it begins. Nobody has to wait for longer than a unit without a sign.
        """


@runtime_checkable
class Resumes(Protocol):
    """A method whose training can go on in another process, as after a machine was taken away."""

    def training_state(self) -> object:
        """Everything that training has changed so far; asked for within `Observer.after_step`, and pickled at once."""

    def constant_state(self) -> object:
        """What training made before its first step and keeps as it is, such as a depth prior; None without. Asked for
        and pickled once, as it may be large."""

    def resume_from(self, state: Any, constant: Any) -> None:
        """Let the next `fit`, on the same training set, go on from what the two gave. On a CPU the rest of the training
        is the same to the bit."""


class Method(Protocol):
    """What `methods/<id>/` must offer under the class name given in its method.toml."""

    def fit(self, training_set: TrainingSet, budget: Budget, observer: Observer) -> FitOutcome:
        """Train; may be interrupted by the observer at any step and must stay renderable."""

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render at the camera; lens None means all in focus. Raises ValueError if it can't refocus."""

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of every training view by name, or None for a method without a lens."""

    def describe(self) -> dict[str, float]:
        """Numbers about the model for the result; at least `gaussians` where that has a meaning."""

    def save(self, folder: Path) -> None:
        """Write the trained model into `folder`."""

    def load(self, folder: Path) -> None:
        """Read what `save` wrote."""


@runtime_checkable
class RendersAhead(Protocol):
    """What a method offers beside `Method` if it makes all pictures together, as another program does."""

    def render_ahead(self, views: Sequence[tuple[Camera, PhysicalLens | None]]) -> None:
        """Make what `render` will be asked for; called after training, again with the same views too."""


@runtime_checkable
class Sketches(Protocol):
    """What a method offers beside `Method` if its photographs through a lens take long."""

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """About the photograph through `lens` that `render` would make, from the rendering without a lens at the same
        camera; quick, so that a lens can be searched for by it."""


@runtime_checkable
class PredictsPhotographs(Protocol):
    """What a method offers besides `Method` if it can predict its training views, to be scored on held-out pixels."""

    def predict_photograph(self, name: str, pixels: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32, encoded: training view `name` by all that was learned of it: lens or blur, and colours.

        pixels: (H, W) bool; only where it is true need the prediction be right. Called after `fit`, before `load`."""


class MethodOption(Protocol):
    """One option of a method, for its users."""

    @property
    def name(self) -> str:
        """As `--set` takes it."""

    @property
    def group(self) -> str:
        """What the option steers, in a word or two."""

    @property
    def type(self) -> str:
        """In words; of a few choices these, with commas."""

    @property
    def default(self) -> bool | int | float | str:
        """What holds without a preset."""

    @property
    def meaning(self) -> str:
        """What the option does, in a sentence."""

    @property
    def unit(self) -> str:
        """The unit of its value, "" where there is none."""

    @property
    def source(self) -> str:
        """Where the choice or its default comes from."""


@runtime_checkable
class ListsOptions(Protocol):
    """What a method's class may offer beside `Method`, so that `dofbench methods ID` can list its options."""

    @classmethod
    def available_options(cls) -> Sequence[MethodOption]:
        """Every option that a user may set, those of a group one after the other."""


@runtime_checkable
class ReadsOptions(Protocol):
    """An optional part of a method's class: options are checked before any training, without building the method."""

    @classmethod
    def read_options(cls, options: Mapping[str, Any]) -> Any:
        """All options with their defaults, a dataclass. Raises InputError for an unknown name or a wrong value."""
