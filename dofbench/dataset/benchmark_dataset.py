"""What running and scoring a method need of a dataset, wherever it comes from: `Dataset` reads one from a folder."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet
from dofbench.core.exif import Exif
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.dataset.dealing import Dealt
from dofbench.dataset.inputs import Inputs
from dofbench.scenes.scene import Split


class BenchmarkView(Protocol):
    """One view. Its lens, in the units of the dataset's disparity range and in scene units, is None where nobody knows
    it. exif: what its camera wrote down, if it did."""

    @property
    def name(self) -> str:
        """Unique in the dataset."""

    @property
    def split(self) -> Split:
        """Whether it is trained on or held back."""

    @property
    def camera(self) -> Camera:
        """At the size of its pictures."""

    @property
    def lens(self) -> Lens | None:
        """In the units of the dataset's disparity range."""

    @property
    def physical_lens(self) -> PhysicalLens | None:
        """In scene units."""

    @property
    def has_all_in_focus(self) -> bool:
        """Whether there is a sharp photograph of it."""

    @property
    def has_depth(self) -> bool:
        """Whether there is depth of it."""

    @property
    def exif(self) -> Exif | None:
        """What its camera wrote down."""


class BenchmarkDataset(Protocol):
    """Views, split into training and test views, with what is known of each. Reading what is missing raises
    InputError, or gives None where it says so."""

    @property
    def name(self) -> str:
        """What results call it; `checksum` tells apart two of one name."""

    @property
    def scene(self) -> str:
        """The scene that it was made from."""

    @property
    def checksum(self) -> str:
        """sha256 over all that it holds, hexadecimal."""

    @property
    def assign(self) -> Dealt:
        """How its lenses were dealt over the views."""

    @property
    def views(self) -> tuple[BenchmarkView, ...]:
        """All views, by name."""

    @property
    def points(self) -> PointCloud | None:
        """Sparse points, whose tracks index into `views`."""

    @property
    def has_exact_depth(self) -> bool:
        """Whether all test views have depth, and it is the scene's own and no estimate."""

    @property
    def disparity_range(self) -> DisparityRange | None:
        """What `lens` of a view refers to; None where neither a lens nor any depth is known."""

    def training_views(self) -> tuple[BenchmarkView, ...]:
        """The views to train on, by name."""

    def test_views(self) -> tuple[BenchmarkView, ...]:
        """The views held back, by name."""

    def image(self, view: BenchmarkView, /) -> np.ndarray:
        """The shallow photograph: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels."""

    def all_in_focus(self, view: BenchmarkView, /) -> np.ndarray | None:
        """The sharp photograph: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels; None where there is none."""

    def depth(self, view: BenchmarkView, /) -> np.ndarray | None:
        """z-depth: (H, W) float32, scene units, 0 where unknown; None where there is none."""

    def training_set(self, inputs: Inputs, /) -> TrainingSet:
        """All that a method may see: training photographs, cameras, points; no lens, no depth, no test view."""
