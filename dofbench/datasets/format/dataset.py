"""Reading a dataset: for methods only what they may see, for the harness everything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.checksums import checksums
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.evidence import Photographer, Role
from dofbench.core.files import files_below, sha256_file
from dofbench.core.held_out import held_out_tiles
from dofbench.core.image_files.exif import EXIF_FILE, Exif, read_exif
from dofbench.core.images import read_exr, read_image
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.core.masks import read_mask
from dofbench.datasets.format import layout
from dofbench.datasets.format.assignment import Assignment
from dofbench.datasets.format.benchmark_dataset import BenchmarkView
from dofbench.datasets.format.inputs import Inputs
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.schema import (
    MANIFEST,
    LensFile,
    Manifest,
    UnknownLensFile,
    ViewRecord,
    read_lens_file,
    read_manifest,
)
from dofbench.scenes.readers import nerfstudio
from dofbench.scenes.scene import Split
from dofbench.scenes.visibility import unmasked_points

_FULL_SIZE = 0.95  # of the longer side: undistortion may crop a border
_HELD_OUT_SEED = 53  # of the held-out tiles: the same for all methods and seeds, other ones than a method's own
_MODELS = ("sparse", "colmap")  # folders in which a COLMAP model is looked for


@dataclass(frozen=True, eq=False)
class DatasetView:
    """One view with its true lens: `lens` in the units of the scene's disparity range, `physical_lens` in scene units.

    max_coc_px: largest CoC radius among the view's pixels. These three are None if the lens is unknown: the view is
    then a real photograph. has_all_in_focus, has_depth: whether the dataset has a sharp image and depth of the view.
    exif: what the camera recorded, None without. has_mask: whether some of its pixels are masked.
    """

    name: str
    split: Split
    camera: Camera
    lens: Lens | None
    physical_lens: PhysicalLens | None
    max_coc_px: float | None
    has_all_in_focus: bool = True
    has_depth: bool = True
    exif: Exif | None = None
    has_mask: bool = False

    def __repr__(self) -> str:
        lens = "lens unknown" if self.lens is None else f"aperture {self.lens.aperture:g}, focus {self.lens.focus:g}"
        return f"DatasetView({self.name!r}, {self.split}, {self.camera.width} x {self.camera.height} px, {lens})"


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset folder, as `make_dataset` writes it. Images and depth are read when asked for.

    views: sorted by name, with their true lenses where these are known. points: sparse points, None without. checksum:
    sha256 of the manifest, which holds the sha256 of every other file.
    """

    folder: Path
    manifest: Manifest
    lenses: LensFile | UnknownLensFile
    views: tuple[DatasetView, ...]
    points: PointCloud | None
    checksum: str

    @staticmethod
    def load(folder: Path | str) -> Dataset:
        """Open a dataset; reads its manifest, lenses, cameras and points, and decodes no image.

        Every file is compared with its checksum in the manifest (`dofbench.core.checksums`), so that `checksum` stands
        for all that is read. Raises InputError, one line, when the folder is no dataset, is unfinished, is of another
        schema version, has a missing, changed or unlisted file, or its parts don't fit together.
        """
        folder = Path(folder)
        manifest = read_manifest(folder)
        _check_files(folder, manifest)
        lenses, offset = read_lens_file(folder), manifest.offset or NO_OFFSET
        scene = nerfstudio.read(folder, width=None, images=None, hold=None, offset=offset)
        views = {view.name: view for view in scene.views}
        records = {record.name: record for record in lenses.views}
        if views.keys() != records.keys():
            different = sorted(views.keys() ^ records.keys())
            raise InputError(
                folder,
                f"views in only one of {layout.TRANSFORMS} and lens.json: {', '.join(different)}",
                "the same views in both",
            )
        moved = [name for name, view in sorted(views.items()) if view.split != records[name].split]
        if moved:
            raise InputError(
                folder,
                f"another split in {layout.TRANSFORMS} than in lens.json for {', '.join(moved)}",
                "the same split in both",
            )
        disparity_range = lenses.range()
        exif, found = read_exif(folder), []
        for name, record in sorted(records.items()):
            camera = views[name].camera
            lens = physical_lens = max_coc_px = None
            if isinstance(record, ViewRecord):
                assert disparity_range is not None  # lens.json has it wherever it has a lens
                lens, max_coc_px = record.lens, record.max_coc_px
                physical_lens = lens.physical(disparity_range, camera.width)
            found.append(
                DatasetView(
                    name=name,
                    split=record.split,
                    camera=camera,
                    lens=lens,
                    physical_lens=physical_lens,
                    max_coc_px=max_coc_px,
                    has_all_in_focus=layout.relative(layout.sharp_path, name) in manifest.files,
                    has_depth=layout.relative(layout.depth_path, name) in manifest.files,
                    exif=exif.get(name),
                    has_mask=layout.relative(layout.mask_path, name) in manifest.files,
                )
            )
        return Dataset(folder, manifest, lenses, tuple(found), scene.points, sha256_file(folder / MANIFEST))

    def __repr__(self) -> str:
        views = f"{len(self.training_views())} training and {len(self.test_views())} test views"
        size = "".join(f" of {view.camera.width} x {view.camera.height} px" for view in self.views[:1])
        return f"Dataset({self.name!r}, {views}{size}, in {self.folder})"

    def _repr_html_(self) -> str:
        from dofbench.core.notebook import as_html, disparity_picture

        pictures = []
        for view in (*self.test_views(), *self.training_views())[:1]:
            pictures.append((f"{view.name}: image", self.image(view)))
            if (sharp := self.all_in_focus(view)) is not None:
                pictures.append(("all in focus", sharp))
            if (depth := self.depth(view)) is not None:
                pictures.append(("disparity", disparity_picture(depth)))
        return as_html(repr(self), pictures)

    @property
    def name(self) -> str:
        """The dataset's name, which is its scene's; `checksum` distinguishes datasets of one scene."""
        return self.manifest.name

    @property
    def scene(self) -> str:
        """Name of the scene that the dataset was made from."""
        return self.manifest.source.scene

    @property
    def role(self) -> Role | None:
        """What the scene may be used for; None where no named dataset states it."""
        return self.manifest.source.role

    @property
    def role_by(self) -> str:
        """ID/SCENE, or ID, of the named dataset that states the role; empty without."""
        return self.manifest.source.role_by or ""

    @property
    def photographer(self) -> Photographer:
        """What took the photographs."""
        return self.lenses.photographer

    @property
    def offset(self) -> Offset:
        """Added to the coordinates of cameras and points here, it gives those of the dataset's files; zero unless the
        scene lies far from its origin."""
        return self.manifest.offset or NO_OFFSET

    @property
    def assign(self) -> Assignment:
        """How the lenses were assigned to the views; "unknown" if no view's lens is known."""
        return self.manifest.settings.get("assign", "per-view") if self.lenses.known else "unknown"

    @property
    def has_exact_depth(self) -> bool:
        """Whether all test views have depth that is the scene's exact depth, not an estimate."""
        given = self.manifest.depth is not None and self.manifest.depth.source == "given"
        return given and all(view.has_depth for view in self.test_views())

    @property
    def disparity_range(self) -> DisparityRange | None:
        """The disparity range that apertures and foci refer to; None if neither a lens nor any depth is known."""
        return self.lenses.range()

    @property
    def full_size(self) -> bool | None:
        """Whether the photographs have their own size, but for a border cropped after undistortion; None where the
        manifest doesn't state that size and a width was chosen."""
        own, camera = self.manifest.source.own_side, self.views[0].camera
        if own is None:
            return True if self.manifest.settings.get("width", 0) is None else None
        return max(camera.width, camera.height) >= _FULL_SIZE * own

    @property
    def blur(self) -> Blur | None:
        """How the lens blurs: all settings except each view's aperture and focus; None if no lens is known."""
        return self.lenses.blur if isinstance(self.lenses, LensFile) else None

    @property
    def points_record(self) -> PointsRecord | None:
        """Where the points and poses come from; None for a dataset that doesn't state it."""
        return self.manifest.points

    def training_points(self) -> PointCloud | None:
        """The points that a method gets, with tracks over the training views: where tracks are known, without those
        that only test views saw; where they are unknown, all. None without points."""
        training = [index for index, view in enumerate(self.views) if view.split == "train"]
        return None if self.points is None else self.points.seen_by(training)

    @property
    def has_points(self) -> bool:
        """Whether there are sparse points."""
        return self.points is not None and len(self.points) > 0

    def view(self, name: str) -> DatasetView:
        """The view of that name. Raises InputError when there is none."""
        for view in self.views:
            if view.name == name:
                return view
        raise InputError(self.folder, f"no view {name!r}", f"one of {len(self.views)}, {self.views[0].name} first")

    def training_views(self) -> tuple[DatasetView, ...]:
        """The views to train on, by name."""
        return tuple(view for view in self.views if view.split == "train")

    def test_views(self) -> tuple[DatasetView, ...]:
        """The test views, by name."""
        return tuple(view for view in self.views if view.split == "test")

    def lens(self, view: BenchmarkView | str) -> Lens | None:
        """The view's true lens, in the units of `disparity_range`; None if it is unknown."""
        return self._view(view).lens

    def image(self, view: BenchmarkView | str) -> np.ndarray:
        """The shallow photograph: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels.

        For a view of unknown lens this is the real photograph, which may be a sharp one for a test view.
        """
        return read_image(layout.shallow_path(self.folder, _name(view)))

    def linear(self, view: BenchmarkView | str) -> np.ndarray | None:
        """The shallow photograph before encoding: (H, W, 3) float32, linear; None for a view of unknown lens."""
        return read_exr(layout.linear_path(self.folder, _name(view))) if self.lens(view) is not None else None

    def all_in_focus(self, view: BenchmarkView | str) -> np.ndarray | None:
        """The sharp original: (H, W, 3) float32, encoded, [0, 1], at 8-bit levels; None without one."""
        known = self._view(view).has_all_in_focus
        return read_image(layout.sharp_path(self.folder, _name(view))) if known else None

    def all_in_focus_linear(self, view: BenchmarkView | str) -> np.ndarray | None:
        """The sharp original as linear light, (H, W, 3) float32, may exceed 1; None where its source is encoded."""
        path = layout.sharp_linear_path(self.folder, _name(view))
        listed = path.relative_to(self.folder).as_posix() in self.manifest.files
        return read_exr(path) if listed else None

    def require_intact(self, view: BenchmarkView | str, part: Literal["image", "all_in_focus"]) -> None:
        """Raise InputError when that picture of a view is missing or isn't what the manifest says."""
        path = (layout.shallow_path if part == "image" else layout.sharp_path)(self.folder, _name(view))
        record = self.manifest.files.get(path.relative_to(self.folder).as_posix())
        if record is None or not path.is_file():
            raise InputError(path, "no such file of the dataset", "a picture that the manifest lists")
        if sha256_file(path) != record.sha256:
            raise InputError(path, "a changed file", f"sha256 {record.sha256[:16]}, as the manifest says")

    def depth(self, view: BenchmarkView | str) -> np.ndarray | None:
        """True z-depth: (H, W) float32, scene units, 0 where unknown; None if the view has no depth."""
        return read_exr(layout.depth_path(self.folder, _name(view))) if self._view(view).has_depth else None

    def confidence(self, view: BenchmarkView | str) -> np.ndarray | None:
        """Confidence of the depth: (H, W) float32, 0 unknown ... 1 certain; None in datasets older than that map."""
        path = layout.confidence_path(self.folder, _name(view))
        return read_image(path)[..., 0] if path.is_file() else None

    def mask(self, view: BenchmarkView | str) -> np.ndarray | None:
        """(H, W) bool: True for the pixels to train on and to score; None for a view without masked pixels.

        Raises InputError for a mask of another size than the view's, or without a valid pixel.
        """
        known = self._view(view)
        if not known.has_mask:
            return None
        path = layout.mask_path(self.folder, known.name)
        mask, size = read_mask(path), (known.camera.height, known.camera.width)
        if mask.shape != size or not mask.any():
            found = f"shape {mask.shape}" if mask.shape != size else "no valid pixel"
            raise InputError(path, found, f"a mask of shape {size} with valid pixels")
        return mask

    def held_out(self, share: float) -> dict[str, np.ndarray]:
        """Training view -> its held-out pixels, (H, W) bool: a `share` of its tiles, without masked pixels.

        None are held out of a view whose other pixels are all masked. Raises ValueError unless 0 < share < 1.
        """
        if not 0 < share < 1:
            raise ValueError(f"held-out pixels: expected a share between 0 and 1, found {share}")
        views = self.training_views()
        return {view.name: _held_out(view, number, self.mask(view), share) for number, view in enumerate(views)}

    def training_set(self, inputs: Inputs = "shallow", *, held_out: float = 0.0) -> TrainingSet:
        """All that a method may see: training photographs, their cameras, `training_points`; no lens, no depth, no
        photograph or camera of a test view. What the points and poses were found in: `points_record`.

        inputs: the shallow photographs, or the sharp originals (a protocol of its own). held_out: masks the pixels of
        `self.held_out(share)` besides; points stay, since they come from the whole images. Raises InputError where a
        training view has no sharp original.
        """
        if inputs not in ("shallow", "all-in-focus"):
            raise InputError("inputs", repr(inputs), "shallow or all-in-focus")
        blurred = [view.name for view in self.training_views() if not view.has_all_in_focus]
        if inputs == "all-in-focus" and blurred:
            found = f"no all-in-focus photograph of {len(blurred)} training views ({blurred[0]} first)"
            raise InputError(self.folder, found, "one of each for --inputs all-in-focus")
        read = self.image if inputs == "shallow" else self.all_in_focus
        views, masks = [], []
        if not 0 <= held_out < 1:
            raise ValueError(f"held-out pixels: expected a share from 0 to below 1, found {held_out}")
        for number, view in enumerate(self.training_views()):
            image, mask = read(view), self.mask(view)
            assert image is not None
            masks.append(mask)
            if held_out > 0:
                held = _held_out(view, number, mask, held_out)
                mask = ~held if mask is None else mask & ~held
            views.append(TrainingView(view.name, view.camera, image, view.exif, mask))
        cameras = [view.camera for view in views]
        return TrainingSet(tuple(views), unmasked_points(self.training_points(), cameras, masks), self.offset)

    def _view(self, view: BenchmarkView | str) -> BenchmarkView:
        return self.view(view) if isinstance(view, str) else view


def _held_out(view: DatasetView, number: int, mask: np.ndarray | None, share: float) -> np.ndarray:
    """(H, W) bool: a training view's held-out pixels; none where all its other pixels are masked."""
    height, width = view.camera.height, view.camera.width
    valid = np.ones((height, width), bool) if mask is None else mask
    tiles = held_out_tiles(height, width, share, _HELD_OUT_SEED, number) & valid
    return tiles if (valid & ~tiles).any() else np.zeros_like(tiles)


def _check_files(folder: Path, manifest: Manifest) -> None:
    """Raise InputError unless the files of a dataset are those of its manifest: a missing or changed one is named, and
    one that would be read with them and isn't listed."""
    found = checksums(folder, manifest.files)
    for name, record in manifest.files.items():
        if found[name] is None:
            raise InputError(folder / name, "no such file", f"the file that {MANIFEST} lists")
        if found[name] != record.sha256:
            expected = f"the one that {MANIFEST} lists; make-dataset makes it again"
            raise InputError(folder / name, "a changed file", expected)
    for path in _read_as_well(folder):
        if path.relative_to(folder).as_posix() not in manifest.files:
            raise InputError(path, f"a file that {MANIFEST} doesn't list", "none, as it would be read with the dataset")


def _read_as_well(folder: Path) -> list[Path]:
    """Files at places that are read without being asked for by name."""
    models = [path for place in _MODELS for path in files_below(folder / place, "*")]
    return [path for path in (folder / EXIF_FILE, *models) if path.is_file() and not path.name.startswith(".")]


def _name(view: BenchmarkView | str) -> str:
    return view if isinstance(view, str) else view.name
