"""What dataset.json and lens.json hold, checked on the way in and out."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, PositiveInt, Tag, ValidationError

from dofbench.core.blur import Blur
from dofbench.core.digests import FIELD, require_digest
from dofbench.core.errors import InputError
from dofbench.core.evidence import Photographer, Role
from dofbench.core.files import read_json
from dofbench.core.lens import LAYERS, ApertureShape, Defocus, DisparityRange, Energy, Lens, PhysicalLens
from dofbench.core.names import InsidePath
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.sensor import Sensor
from dofbench.scenes.scene import Photograph, Split

SCHEMA: Final = "dofbench-dataset"
# Schema versions. 1: the lens, depth and sharp image of every view are known. 2: some may be unknown, and are marked
# so. 3: as 2, and where points and poses come from is stated, and the role of the scene if it has one. 4: as 3, and the
# manifest holds a digest of itself. Older datasets are read as they are.
ALL_KNOWN, SOME_UNKNOWN, STATED, SIGNED = 1, 2, 3, 4
VERSIONS = (ALL_KNOWN, SOME_UNKNOWN, STATED, SIGNED)
MANIFEST = "dataset.json"
LENS_FILE = "lens.json"

Checksum = Field(pattern=r"^[0-9a-f]{64}$")


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ShapeRecord(_Record):
    """The aperture's shape, as `ApertureShape`: rotation in radians."""

    blades: int
    rotation: FiniteFloat
    curvature: FiniteFloat
    obstruction: FiniteFloat

    def shape(self) -> ApertureShape:
        """The value type. Raises InputError for an impossible shape."""
        return ApertureShape(self.blades, self.rotation, self.curvature, self.obstruction)


class AssignedLensRecord(_Record):
    """Only with a per-view normaliser: the lens as it was assigned, and the disparity range that it refers to."""

    disparity_range: tuple[FiniteFloat, FiniteFloat]
    aperture: FiniteFloat
    focus: FiniteFloat


class ViewRecord(_Record):
    """One view's lens. aperture and focus always refer to the scene's disparity range.

    k_px: CoC radius in pixels per unit of normalised disparity. aperture_scene: pixels * scene unit.
    focus_scene: scene units. max_coc_px: largest CoC radius among the
    view's pixels; unknown depth counts as infinitely far, as it does for the blur. noise_rms_linear,
    noise_psnr_db: of a photograph by the renderer "thinlens", as in a rendered scene's scene.json.
    """

    name: InsidePath
    split: Split
    aperture: FiniteFloat = Field(ge=0)
    focus: FiniteFloat
    k_px: FiniteFloat = Field(ge=0)
    aperture_scene: FiniteFloat = Field(ge=0)
    focus_scene: FiniteFloat = Field(gt=0)
    max_coc_px: FiniteFloat = Field(ge=0)
    dealt: AssignedLensRecord | None = None
    noise_rms_linear: FiniteFloat | None = Field(default=None, ge=0)
    noise_psnr_db: FiniteFloat | None = None

    @property
    def lens(self) -> Lens:
        """The view's lens in the units of the scene's disparity range."""
        return Lens(aperture=self.aperture, focus=self.focus)

    def physical(self, width: int) -> PhysicalLens:
        """The view's lens in scene units, for its image `width` pixels wide."""
        return PhysicalLens(aperture=self.aperture_scene, focus_disparity=1.0 / self.focus_scene, width=width)


class UnknownLens(_Record):
    """A view of unknown lens: its image is a real photograph."""

    name: InsidePath
    split: Split
    lens: Literal["unknown"]


# Tags by which pydantic chooses the kind of view. They aren't fields, so messages about a view leave them out.
_KNOWN, _UNKNOWN = "(known)", "(unknown)"


def _which(view: Any) -> str:
    return _UNKNOWN if isinstance(view, UnknownLens) or (isinstance(view, dict) and "lens" in view) else _KNOWN


AnyView = Annotated[Annotated[ViewRecord, Tag(_KNOWN)] | Annotated[UnknownLens, Tag(_UNKNOWN)], Discriminator(_which)]


class SensorRecord(_Record):
    """The noise on the photographs, as `Sensor`, and the bits per channel of the encoded ones."""

    photons: FiniteFloat = Field(default=0.0, ge=0)
    read_noise: FiniteFloat = Field(default=0.0, ge=0)
    seed: int = 0
    bits: Literal[8, 16] = 8

    def sensor(self) -> Sensor:
        """The value type."""
        return Sensor(self.photons, self.read_noise, self.seed)


class ThinLensRecord(_Record):
    """How the photographs of the renderer "thinlens" were made: make-scene's recipe and seed; samples per pixel."""

    recipe: str
    seed: int
    samples: PositiveInt
    mitsuba: str
    variant: str


class LightFieldRecord(_Record):
    """The light field whose views were averaged, and what its cameras are by (`dofbench/scenes/light_field/rig.py`).

    grid: sha256 of its files. unit: of positions, the scene unit; step: between neighbouring views. matrix: from a
    position in grid.json to (down, right), row by row; a point of parallax q moves by -q times that. matches,
    epipolar_px: features that the matrix was fitted to, and their median distance from the epipolar lines, pixels of
    the grid's own size. focal_px: by convention. infinity_px: parallax of what is infinitely far, pixels per unit, by
    convention where `registered`, else 0. margin_px: cropped at each border. These three in pixels of this dataset.
    """

    grid: str = Checksum
    unit: str
    step: FiniteFloat = Field(gt=0)
    matrix: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    matches: PositiveInt
    epipolar_px: FiniteFloat = Field(ge=0)
    focal_px: FiniteFloat = Field(gt=0)
    infinity_px: FiniteFloat
    registered: bool
    margin_px: int = Field(ge=0)


class LensFile(_Record):
    """lens.json: all that is needed to blur the all-in-focus images again.

    disparity_range: 1 / scene unit. layers: present with the renderer "layered" alone; thinlens: with "thinlens" alone;
    light_field: with "light-field" alone.
    """

    disparity_range: tuple[FiniteFloat, FiniteFloat]
    normaliser: Literal["scene", "view"]
    gamma: FiniteFloat = Field(gt=0)
    alpha: FiniteFloat = Field(gt=0)
    energy: Energy
    shape: ShapeRecord
    renderer: Defocus
    layers: int | None = Field(default=None, ge=1)
    thinlens: ThinLensRecord | None = None
    light_field: LightFieldRecord | None = None
    sensor: SensorRecord = SensorRecord()
    views: tuple[AnyView, ...]

    @property
    def photographer(self) -> Photographer:
        """What took the photographs."""
        return self.renderer

    def range(self) -> DisparityRange:
        """The scene's disparity range. Raises ValueError when it is empty."""
        return DisparityRange(*self.disparity_range)

    @property
    def blur(self) -> Blur:
        """How the lens blurs: all settings except each view's aperture and focus. Raises InputError for an impossible
        lens."""
        shape, layers = self.shape.shape(), LAYERS if self.layers is None else self.layers
        return Blur(self.gamma, self.alpha, shape, self.energy, self.renderer, layers)

    @staticmethod
    def of_blur(blur: Blur) -> dict[str, Any]:
        """The fields of this record that a blur determines, by name; without those that the blur's renderer doesn't
        use."""
        fields = asdict(blur) | {"shape": ShapeRecord(**asdict(blur.shape))}
        return fields | {"layers": blur.layers if blur.renderer == "layered" else None}

    @property
    def known(self) -> tuple[ViewRecord, ...]:
        """The views whose lens is known: all except test views that are real photographs."""
        return tuple(view for view in self.views if isinstance(view, ViewRecord))


class UnknownLensFile(_Record):
    """lens.json if no view's lens is known. disparity_range: that of the views with depth; absent if none has depth."""

    disparity_range: tuple[FiniteFloat, FiniteFloat] | None = None
    views: tuple[UnknownLens, ...]

    @property
    def photographer(self) -> Photographer:
        """What took the photographs: an unknown lens."""
        return "unknown"

    def range(self) -> DisparityRange | None:
        """The scene's disparity range, None if no view has depth. Raises ValueError when it is empty."""
        return None if self.disparity_range is None else DisparityRange(*self.disparity_range)

    @property
    def known(self) -> tuple[ViewRecord, ...]:
        """No view."""
        return ()


class SourceImage(_Record):
    """The file that a view was made from, identified by its content.

    photograph: true if the view is that photograph itself, taken through an unknown lens. Absent if the view was
    blurred from an all-in-focus image. mask: sha256 of the view's mask as read, at this size, one bit a pixel; absent
    without one. linear: true if the file is linear light; absent if it is encoded.
    """

    view: InsidePath
    sha256: str = Checksum
    photograph: Photograph | None = None
    mask: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    linear: Literal[True] | None = None


class SourceRecord(_Record):
    """The scene that the dataset was made from. geometry: sha256 of its cameras, split and points.

    licence: the licence of the images, as their source states it; terms: details of the licence. citation: one
    reference per entry. origin: where the images come from. role: what the scene may be used for, absent where no named
    dataset states it; role_by: ID/SCENE, or ID, of the named dataset that does. own_side: longer side of the first
    view's photograph as it was taken, pixels; absent unless photographs are of unknown lens, and from older datasets.
    notes: what was chosen, changed or skipped while the scene was read; absent where nothing was.
    """

    scene: str
    layout: str
    images: tuple[SourceImage, ...]
    geometry: str = Checksum
    licence: str = "not stated"
    terms: str = ""
    citation: tuple[str, ...] = ()
    origin: str = ""
    role: Role | None = None
    role_by: str | None = None
    own_side: PositiveInt | None = None
    notes: tuple[str, ...] | None = None


class ConsistencyRecord(_Record):
    """Agreement of a view's depth with its neighbours, rounded to six decimals: `scenes.depth.multi_view`."""

    neighbours: tuple[str, ...]
    compared: FiniteFloat
    consistent: FiniteFloat
    difference: FiniteFloat
    bias: FiniteFloat
    coc_px: FiniteFloat


class DepthViewRecord(_Record):
    """One view's depth. known: share of pixels with depth. confidence: its mean over those pixels, and the share of
    them where it is above 1/2.

    These three are computed from the 8-bit map in confidence/. statistics: numbers that the depth source reports, to
    six digits; their meaning is in the provenance. consistency: absent where no other view sees enough of the same.
    """

    view: InsidePath
    known: FiniteFloat = Field(ge=0, le=1)
    confidence: FiniteFloat = Field(ge=0, le=1)
    confident: FiniteFloat = Field(ge=0, le=1)
    statistics: dict[str, FiniteFloat] = {}
    consistency: ConsistencyRecord | None = None


class DepthRecord(_Record):
    """Where the depth came from, and how it was made.

    confidence: what the maps in confidence/ mean. views: in name order. Both are absent from datasets
    made before there were such maps.
    """

    source: Literal["given", "folder", "splat", "sfm", "onnx", "sweep"]
    provenance: dict[str, Any]
    confidence: str | None = None
    views: tuple[DepthViewRecord, ...] = ()


class FileRecord(_Record):
    """A file of the dataset, identified by its content: size in bytes and sha256."""

    sha256: str = Checksum
    size: int = Field(ge=0)


class Manifest(_Record):
    """dataset.json: written last, so that a folder with a manifest is complete.

    identity: sha256 of everything that decides the content (settings, source, lens plan, version). depth: absent if no
    view has depth. points: where points and poses come from; absent before schema version 3, which is "not stated".
    offset: of cameras and points in the dataset's files, subtracted on reading, scene units; absent where it is zero.
    digest: of the manifest's own text (`dofbench.core.digests`); absent before schema version 4.
    """

    schema_name: Literal["dofbench-dataset"] = Field(alias="schema")
    version: PositiveInt
    name: InsidePath
    dofbench: str
    command: str
    identity: str = Checksum
    seed: int
    settings: dict[str, Any]
    source: SourceRecord
    depth: DepthRecord | None = None
    points: PointsRecord | None = None
    offset: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    files: dict[InsidePath, FileRecord]
    digest: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")


Model = TypeVar("Model", bound=BaseModel)


def read_manifest(folder: Path) -> Manifest:
    """Read dataset.json of a dataset folder.

    Raises InputError, one line, when the folder is no dataset, is unfinished, is of another schema
    version, or the manifest is damaged.
    """
    path = folder / MANIFEST
    if not path.is_file():
        if not folder.is_dir():
            raise InputError(folder, "no such folder", "a dataset folder")
        if (folder / ".work").is_dir():
            raise InputError(folder, f"an unfinished dataset (no {MANIFEST})", "a finished one: run make-dataset again")
        raise InputError(folder, f"no {MANIFEST}", "a dataset folder, as make-dataset writes it")
    raw = read_json(path)
    if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
        raise InputError(path, "another kind of JSON", f'a manifest with "schema": "{SCHEMA}"')
    if raw.get("version") not in VERSIONS:
        raise InputError(path, f"schema version {raw.get('version')}", f"version {_versions()}")
    if (raw["version"] >= SIGNED) is not (FIELD in raw):
        found = f"{'a' if FIELD in raw else 'no'} digest in schema version {raw['version']}"
        raise InputError(path, found, f"a digest from {SIGNED} on")
    if FIELD in raw:
        require_digest(path, raw, expected="the manifest that make-dataset wrote")
    manifest = _validate(path, raw, Manifest)
    photographs = [image.view for image in manifest.source.images if image.photograph is not None]
    if manifest.version == ALL_KNOWN and (photographs or manifest.depth is None):
        found = f"view {photographs[0]} of unknown lens" if photographs else "no depth"
        raise InputError(path, f"{found} in schema version {ALL_KNOWN}", f"version {SOME_UNKNOWN}")
    if (manifest.version >= STATED) is (manifest.points is None):
        found = "no points" if manifest.points is None else "points"
        raise InputError(path, f"{found} in schema version {manifest.version}", f"points from {STATED} on")
    return manifest


def read_lens_file(folder: Path) -> LensFile | UnknownLensFile:
    """Read lens.json of a dataset folder. Raises InputError, one line, when it is missing or damaged."""
    path = folder / LENS_FILE
    if not path.is_file():
        raise InputError(path, "no such file", "the lens of every view")
    raw = read_json(path)
    views = raw.get("views") if isinstance(raw, dict) else None
    if isinstance(views, list) and views and all(_which(view) == _UNKNOWN for view in views):
        photographs = _validate(path, raw, UnknownLensFile)
        try:
            photographs.range()
        except ValueError as error:
            raise InputError(path, str(error), "a possible disparity range") from None
        return photographs
    lenses = _validate(path, raw, LensFile)
    if (lenses.renderer == "thinlens") is (lenses.thinlens is None):
        raise InputError(path, f"renderer {lenses.renderer} and thinlens {lenses.thinlens}", "both, or neither")
    if (lenses.renderer == "light-field") is (lenses.light_field is None):
        found = f"renderer {lenses.renderer} and light_field {lenses.light_field}"
        raise InputError(path, found, "both, or neither")
    try:
        lenses.range()
        _ = lenses.blur
    except ValueError as error:
        raise InputError(path, str(error), "a possible lens") from None
    return lenses


def as_json(record: BaseModel) -> dict[str, Any]:
    """The record as plain data for `write_json`, with the names that the files use and without absent parts."""
    return record.model_dump(mode="json", by_alias=True, exclude_none=True)


def _versions() -> str:
    *older, newest = map(str, VERSIONS)
    return f"{', '.join(older)} or {newest}"


def _validate(path: Path, raw: object, model: type[Model]) -> Model:
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(str(part) for part in problem['loc'] if part not in (_KNOWN, _UNKNOWN)) or 'file'}: "
            f"{problem['msg']}"
            for problem in error.errors()
        )
        expected = f"a {path.name} of schema version {_versions()}"
        raise InputError(path, problems, expected) from None
