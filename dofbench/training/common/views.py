"""Training views at each training size, the random order in which training visits them, and outliers among them."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView
from dofbench.core.images import resize
from dofbench.core.masks import PackedMask, shrunk_mask
from dofbench.core.stored_image import StoredImage
from dofbench.training.common.depth_map import DepthMap, DepthSamples
from dofbench.training.common.held_out import held_out_mask
from dofbench.training.common.priors import Prior

VISITS = 2  # latest visits of a view over which its loss is averaged
FAR = 4.0  # distance of an outlier, in robust standard deviations of the losses' logarithms
LEAST_RATIO = 1.4  # of an outlier's loss to the median, so that views of nearly equal losses have no outlier
MOST = 0.25  # largest share of the views that may be outliers
LEAST_VIEWS = 8  # fewest views for which the median is meaningful


@dataclass(frozen=True, eq=False)
class ScaledView:
    """One training view at one size. image: (H, W, 3), encoded. known: its known depth, or None. held_back: (H, W)
    bool, the pixels that no colour loss uses, masked ones among them, or None. used: share of unmasked pixels."""

    index: int
    name: str
    camera: Camera
    image: Tensor
    known: DepthSamples | None
    held_back: Tensor | None
    used: float = 1.0


@dataclass(frozen=True, eq=False)
class _Kept:
    """What is kept of a view for the training on a CPU. known: as the prior keeps it. valid: the pixels whose known
    depth counts, None for all. used: as in `ScaledView`."""

    name: str
    camera: Camera
    image: StoredImage
    known: DepthMap | DepthSamples | None
    valid: PackedMask | None
    held_back: PackedMask | None
    used: float

    def samples(self) -> DepthSamples | None:
        if not isinstance(self.known, DepthMap):
            return self.known
        found = self.known.own_samples()
        return found if self.valid is None else found.within(torch.from_numpy(self.valid.bools()))


class ScaledViews:
    """All training views shrunk by a factor. On a CPU the tensors of a view are made anew whenever it is asked for:
    kept are 8-bit levels where it isn't shrunk, and bits for masks and for which depths are known. On another device
    all tensors stay there, but for images of 8-bit levels, which are a byte a value.

    prior: the depth that supervises, or None. held_back: the share of every view's tiles that no colour loss uses.
    """

    def __init__(
        self, views: Sequence[TrainingView], factor: int, prior: Prior | None, held_back: float, seed: int, device: str
    ):
        self._kept = [_kept(view, index, factor, prior, held_back, seed) for index, view in enumerate(views)]
        self.cameras = [kept.camera for kept in self._kept]
        self._device = device
        self._there: list[tuple[ScaledView, Tensor | None]] = []
        if torch.device(device).type != "cpu":
            self._there = [self._sent(index) for index in range(len(views))]
            self._kept = []

    def __len__(self) -> int:
        return len(self.cameras)

    def __getitem__(self, index: int) -> ScaledView:
        if self._there:
            view, table = self._there[index]
            return view if table is None else replace(view, image=table[view.image.int()])
        kept = self._kept[index]
        held = None if kept.held_back is None else torch.from_numpy(kept.held_back.bools())
        image = torch.from_numpy(np.ascontiguousarray(kept.image.floats()))
        return ScaledView(index, kept.name, kept.camera, image, kept.samples(), held, kept.used)

    def _sent(self, index: int) -> tuple[ScaledView, Tensor | None]:
        """A view on the device, with its image as it is kept, and the table of its levels."""
        kept, device = self._kept[index], self._device
        known, held, table = kept.samples(), kept.held_back, kept.image.table
        image = torch.from_numpy(np.ascontiguousarray(kept.image.values)).to(device)
        on_device = None if known is None else known.on(device)
        held_there = None if held is None else torch.from_numpy(held.bools()).to(device)
        view = ScaledView(index, kept.name, kept.camera, image, on_device, held_there, kept.used)
        return view, None if table is None else torch.from_numpy(table).to(device)


def _kept(view: TrainingView, index: int, factor: int, prior: Prior | None, held_back: float, seed: int) -> _Kept:
    width, height = view.camera.width // factor, view.camera.height // factor
    camera = view.camera if factor == 1 else view.camera.resized(width, height)
    image = view.stored
    if image.values.shape[:2] != (height, width):
        image = StoredImage.of(resize(view.image, width, height))
    known = None if prior is None else prior.kept(index, camera)
    held = held_out_mask(view.camera.height, view.camera.width, (height, width), held_back, seed, index)
    used, valid = 1.0, None
    if view.mask is not None:
        mask = shrunk_mask(view.mask, width, height)
        if isinstance(known, DepthSamples):
            known = known.within(torch.from_numpy(mask))
        elif known is not None and (known.known & ~mask).any():
            valid = PackedMask.of(mask)
        held = ~mask if held is None else held | ~mask
        used = float(torch.from_numpy(mask).double().mean())
    if isinstance(known, DepthSamples):
        known = known.on("cpu")
    return _Kept(view.name, camera, image, known, valid, None if held is None else PackedMask.of(held), used)


@dataclass(frozen=True)
class OutlierOptions:
    """Whether views may be excluded, and from when on."""

    outlier_views: bool = False
    """Whether views whose loss stays far above the others' are excluded. Unit: none. Source: own."""
    outliers_from: float = 0.3
    """When the search for such views begins. Unit: share of the training. Source: own."""


class OutlierViews:
    """Finds views that don't belong to the scene, such as those with a wrong pose: their loss stays far above the
    others'. Losses are compared with their median, so a scene that is hard as a whole has no outliers."""

    def __init__(self, count: int):
        self._losses: list[deque[Tensor]] = [deque(maxlen=VISITS) for _ in range(count)]

    def record(self, view: int, loss: Tensor) -> None:
        """Add the loss of a step on view number `view`."""
        self._losses[view].append(loss)

    def found(self) -> set[int]:
        """Numbers of the outliers; none until all views have been visited often enough."""
        if len(self._losses) < LEAST_VIEWS or any(len(losses) < VISITS for losses in self._losses):
            return set()
        logs = np.log([np.mean([float(loss) for loss in losses]) for losses in self._losses])
        above = logs - np.median(logs)
        bound = max(FAR * 1.4826 * float(np.median(np.abs(above))), np.log(LEAST_RATIO))
        worst = np.argsort(-above)[: int(MOST * len(logs))]
        return {int(view) for view in worst if above[view] > bound}


@dataclass(frozen=True, eq=False)
class OrderState:
    """A copy of a `ViewOrder`'s state: the rest of the current round, and the losses."""

    left: list[int]
    outliers: OutlierViews


class ViewOrder:
    """Rounds of all `count` views in random order, without outliers. left_out: the outliers so far."""

    def __init__(self, count: int, options: OutlierOptions):
        self._count, self._options = count, options
        self._left: list[int] = []
        self._outliers = OutlierViews(count)
        self.left_out: set[int] = set()

    def next(self, progress: float, random: np.random.Generator) -> int:
        """The next view's number at `progress`, 0 to 1; a new round is drawn when the last one is over."""
        if not self._left:
            self._left = list(random.permutation(self._count))
            if self._options.outlier_views and progress >= self._options.outliers_from:
                self.left_out |= self._outliers.found()
                self._left = [view for view in self._left if view not in self.left_out]
        return self._left.pop()

    def record(self, view: int, loss: Tensor) -> None:
        """Add the loss of a step on view number `view`."""
        self._outliers.record(view, loss)

    def state(self) -> OrderState:
        """A copy of the current round and the losses, without `left_out`: outliers stay excluded."""
        return OrderState(list(self._left), copy.deepcopy(self._outliers))

    def restore(self, state: OrderState) -> None:
        """Return to an earlier `state`."""
        self._left, self._outliers = list(state.left), copy.deepcopy(state.outliers)
