"""What running and scoring a method need of a dataset, wherever it comes from: `Dataset` reads one from a folder."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet
from dofbench.core.evidence import Photographer, Role
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.datasets.format.assignment import Assignment
from dofbench.datasets.format.inputs import Inputs
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.scenes.scene import Split


class BenchmarkView(Protocol):
    """One view. Its lens, in the units of the dataset's disparity range and in scene units, is None if it is unknown.
    exif: what the camera recorded, None without."""

    @property
    def name(self) -> str:
        """Unique in the dataset."""

    @property
    def split(self) -> Split:
        """Whether it is trained on or held out."""

    @property
    def camera(self) -> Camera:
        """The camera, at the size of the view's images."""

    @property
    def lens(self) -> Lens | None:
        """The lens in the units of the dataset's disparity range; None if it is unknown."""

    @property
    def physical_lens(self) -> PhysicalLens | None:
        """The lens in scene units; None if it is unknown."""

    @property
    def has_all_in_focus(self) -> bool:
        """Whether the dataset has a sharp photograph of this view."""

    @property
    def has_depth(self) -> bool:
        """Whether the dataset has depth of this view."""

    @property
    def has_mask(self) -> bool:
        """Whether some of its pixels are masked: neither trained on nor scored."""

    @property
    def exif(self) -> Exif | None:
        """What the camera recorded when the photograph was taken; None without."""


class BenchmarkDataset(Protocol):
    """Views, split into training and test views, with what is known of each. Reading missing data raises InputError, or
    gives None where the function's docstring says so."""

    @property
    def name(self) -> str:
        """The name under which results refer to the dataset; `checksum` distinguishes two datasets of one name."""

    @property
    def scene(self) -> str:
        """The scene that the dataset was made from."""

    @property
    def role(self) -> Role | None:
        """What the scene may be used for; None where that isn't stated."""

    @property
    def role_by(self) -> str:
        """The label of the named dataset that states the role; empty without."""

    @property
    def photographer(self) -> Photographer:
        """What took the photographs."""

    @property
    def checksum(self) -> str:
        """sha256 over all content of the dataset, hexadecimal."""

    @property
    def assign(self) -> Assignment:
        """How the lenses were assigned to the views."""

    @property
    def views(self) -> tuple[BenchmarkView, ...]:
        """All views, by name."""

    @property
    def points(self) -> PointCloud | None:
        """Sparse points, whose tracks, where known, index into `views`."""

    @property
    def points_record(self) -> PointsRecord | None:
        """Where the points and poses come from; None where that isn't stated."""

    @property
    def has_exact_depth(self) -> bool:
        """Whether all test views have depth that is the scene's exact depth, not an estimate."""

    @property
    def disparity_range(self) -> DisparityRange | None:
        """The disparity range that a view's `lens` refers to; None if neither a lens nor any depth is known."""

    @property
    def full_size(self) -> bool | None:
        """Whether photographs of unknown lens have their own size, as they were taken; None where that isn't stated."""

    def training_views(self) -> tuple[BenchmarkView, ...]:
        """The views to train on, by name."""

    def test_views(self) -> tuple[BenchmarkView, ...]:
        """The test views, by name."""

    def image(self, view: BenchmarkView, /) -> np.ndarray:
        """The shallow photograph: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels."""

    def all_in_focus(self, view: BenchmarkView, /) -> np.ndarray | None:
        """The sharp photograph: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels; None without one."""

    def depth(self, view: BenchmarkView, /) -> np.ndarray | None:
        """z-depth: (H, W) float32, scene units, 0 where unknown; None if the view has no depth."""

    def mask(self, view: BenchmarkView, /) -> np.ndarray | None:
        """(H, W) bool: True for the pixels to train on and to score; None for a view without masked pixels."""

    def training_set(self, inputs: Inputs, /) -> TrainingSet:
        """All that a method may see: training photographs, their cameras, and points, where tracks are known without
        those that only test views saw; no lens, no depth, no photograph or camera of a test view."""
