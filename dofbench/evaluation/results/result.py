"""The schema of result.json: the settings of a run, its scores, and its provenance.

Non-finite numbers are stored as NaN, Infinity and -Infinity, so that a score of NaN stays visible.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from dofbench.core.digests import FIELD, require_digest, write_with_digest
from dofbench.core.errors import InputError, Status
from dofbench.core.evidence import Photographer, Role
from dofbench.core.files import canonical_json, sha256_text
from dofbench.core.names import InsideName, InsidePath
from dofbench.core.readable import parse_json, read_text
from dofbench.datasets.format.points_record import PointsRecord

SCHEMA_VERSION = 6
RESULT_FILE = "result.json"
# Folders beside result.json: files that the method saved, and predicted pictures
MODEL_FOLDER, PREDICTIONS_FOLDER = "model", "predictions"

# Version -> function that converts the plain JSON data of a result of that version to the next version. Every increase
# of SCHEMA_VERSION needs an entry here, so that old results stay readable.
MIGRATIONS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {}


def _from_1(data: dict[str, Any]) -> dict[str, Any]:
    """Version 2 has CPU seconds and cold start as scores, CPU seconds along the curve, the model's checksums, and how
    many kernels were compiled. Stages had CPU seconds before; scores that version 1 didn't measure are listed in
    left_out with the reason.
    """
    training = data["stages"].get("train")
    scores = data["scores"] | ({"train_cpu_s": training["cpu"]} if training else {})
    left_out = data["left_out"] | {"cold_start_s": "a result of schema version 1, when nobody measured it"}
    curve = [point | {"train_cpu_s": None} for point in data["curve"]]
    return data | {"scores": scores, "left_out": left_out, "curve": curve, "model": {}, "kernels_compiled": None}


MIGRATIONS[1] = _from_1


def _from_2(data: dict[str, Any]) -> dict[str, Any]:
    """Version 3 adds the fits by which photographs of unknown lens are predicted, and learned apertures with their
    f-numbers; older results have none of these."""
    return data | {"fits": [], "apertures": []}


MIGRATIONS[2] = _from_2


def _from_3(data: dict[str, Any]) -> dict[str, Any]:
    """Version 4 adds the role of the scene, what took the photographs, and the digest of all that was chosen; nobody
    recorded them for older results."""
    return data | {"role": None, "role_by": "", "photographer": None, "choices": None}


MIGRATIONS[3] = _from_3


def _from_4(data: dict[str, Any]) -> dict[str, Any]:
    """Version 5 adds learned foci with the distances in EXIF; older results have none."""
    return data | {"foci": []}


MIGRATIONS[4] = _from_4


def _from_5(data: dict[str, Any]) -> dict[str, Any]:
    """Version 6 adds the digest of the file's own text, and where the dataset is relative to the result; older results
    have neither."""
    return data | {"digest": None, "data_from_here": ""}


MIGRATIONS[5] = _from_5


class Stored(BaseModel):
    """Base of the records in stored files: unknown keys are refused, records are immutable, NaN and infinities are
    allowed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True, protected_namespaces=())


# Seconds, bytes, steps, counts: what a run took is measured, so it is finite, whatever became of its scores.
_LARGEST = 1e15
Amount = Annotated[float, Field(ge=0, le=_LARGEST, allow_inf_nan=False)]
_READING = "reading"
_AMOUNTS = ("train_s", "train_cpu_s", "cold_start_s", "steps", "render_fps", "peak_mb", "gaussians")


class _Recorded(BaseModel):
    """Base of the records in `plan` and `machine` that reports read; other entries are kept as they are."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False, protected_namespaces=())


class _PlannedStage(_Recorded):
    name: str
    runs: bool
    reason: str


class _PlannedLenses(_Recorded):
    assign: str
    train: dict[str, tuple[float, float] | None]
    test: dict[str, tuple[float, float] | None]


class _Plan(_Recorded):
    train_views: int = Field(ge=0, le=_LARGEST)
    test_views: int = Field(ge=0, le=_LARGEST)
    stages: list[_PlannedStage]
    lenses: _PlannedLenses | None = None
    points: PointsRecord | None = None


class _Machine(_Recorded):
    cpu: str
    cores: int
    memory_gib: float
    os: str
    python: str


class Spec(Stored):
    """Exactly the settings that decide a result; their hash is the cache key.

    options: those of the preset with the changes of plan and user; overrides: the user's changes. budget: in the form
    of `--budget`. dataset: its name. dataset_checksum: sha256 over its files. code: `<version>+<sha256>` of the sources
    (`provenance.code_version`). content: option -> sha256 of the files that it names
    (`dofbench.training.common.options`); none where no option names any, and before version 6.
    """

    method: InsideName
    preset: InsideName
    overrides: dict[str, Any]
    options: dict[str, Any]
    budget: str
    dataset: InsidePath
    dataset_checksum: str
    protocol: str
    seed: int
    device: str
    code: str
    content: dict[str, str] = {}

    @property
    def key(self) -> str:
        """sha256 of the spec as canonical JSON."""
        return sha256_text(canonical_json(self.model_dump(mode="json", exclude=set() if self.content else {"content"})))

    @property
    def folder(self) -> Path:
        """The folder of this spec's result, relative to the folder of results."""
        return Path(self.dataset) / f"{self.method}-{self.preset}-seed{self.seed}-{self.key[:8]}"


class StageTime(Stored):
    """Seconds that one stage took: wall, and CPU over all threads."""

    wall: Amount
    cpu: Amount


class CurvePoint(Stored):
    """Scores (column -> value) at one moment of training.

    train_s, train_cpu_s: training seconds, wall and CPU, evaluation excluded; train_cpu_s is None in results older than
    schema version 2. loss: mean training loss since the previous point; None if no step was taken in between.
    """

    train_s: Amount
    train_cpu_s: Amount | None
    steps: int = Field(ge=0, le=_LARGEST)
    loss: float | None
    scores: dict[str, float]


class ViewScores(Stored):
    """Scores (column -> value) of one test view."""

    name: InsidePath
    scores: dict[str, float]


class ViewLens(Stored):
    """True and estimated lens of one training view, in the dataset's units, and their errors."""

    name: InsidePath
    aperture: float
    focus: float
    aperture_estimated: float
    focus_estimated: float
    delta_a: float
    delta_f: float
    delta_r: float


class HalfFitted(Stored):
    """The fit on one half of a photograph (0 or 1), by which the other half is predicted. aperture: pixels * scene unit
    at the photograph's width; focus_disparity: 1 / scene unit; both None for a method without a lens. sigma: px, of the
    Gaussian blur that replaces the lens or is compared with it, None without. renders: number of renderings. error:
    mean squared error on the fitted half, encoded."""

    fitted_on: int
    aperture: float | None
    focus_disparity: float | None
    sigma: float | None
    renders: int
    error: float


class ViewFit(Stored):
    """The fits of one test view that is a photograph of unknown lens. seconds: wall time of the fits, which isn't
    training time."""

    name: str
    seconds: Amount
    halves: list[HalfFitted]


class ViewAperture(Stored):
    """Learned aperture of one training view, pixels * scene unit, and the f-number in its EXIF."""

    name: str
    aperture: float
    f_number: float


class ViewFocus(Stored):
    """Learned focus of one training view, 1 / scene unit, and the distance in its EXIF, m, infinite for infinity."""

    name: InsidePath
    focus_disparity: float
    distance: float


class Event(Stored):
    """A NaN or infinity, with the step and the stage in which it appeared."""

    step: int
    view: str
    stage: str
    detail: str


class Git(Stored):
    """Commit of the checkout, and whether it had uncommitted changes."""

    commit: str
    dirty: bool


class Result(Stored):
    """One run.

    scores: the leaderboard's columns that were measured, column -> value. left_out: the columns that were not, column
    -> reason. left_out_stages: parts of the method that were switched off or not needed, with the reason. do_nothing:
    errors of a predictor that always estimates A = F = 0.5. stages: the harness's stages; method_stages: the method's
    own, wall seconds within "train". kernels_compiled: number of kernels compiled during the run, 0 if all were cached
    on disk; None before schema version 2. predictions, model: file, relative to the result's folder -> sha256; model is
    empty before version 2. data: the dataset's folder as the user gave it; data_from_here: the same relative to the
    result's folder, "" before version 6. role, role_by, photographer: of the dataset
    (`dofbench.core.evidence`); None, "" and None before version 4, role also where it isn't stated. choices: digest of
    all that preset and call chose (`dofbench.methods.frozen_presets`), None before version 4. plan, protocol: as plain
    data. fits, apertures: empty before version 3, foci before version 5. git is None outside a checkout.
    digest: of result.json's own text (`dofbench.core.digests`); None before version 6, and of a result that isn't
    written yet.
    """

    schema_version: int
    key: str
    spec: Spec
    protocol: dict[str, Any]
    plan: dict[str, Any]
    status: Status
    message: str
    traceback: str
    scene: str
    data: str
    data_from_here: str
    role: Role | None
    role_by: str
    photographer: Photographer | None
    choices: str | None
    command: str
    started: str
    ended: str
    scores: dict[str, float]
    left_out: dict[str, str]
    left_out_stages: dict[str, str]
    do_nothing: dict[str, float]
    views: list[ViewScores]
    lens: list[ViewLens]
    fits: list[ViewFit]
    apertures: list[ViewAperture]
    foci: list[ViewFocus]
    curve: list[CurvePoint]
    stages: dict[str, StageTime]
    method_stages: dict[str, Amount]
    description: dict[str, float]
    kernels_compiled: int | None
    nonfinite: list[Event]
    predictions: dict[InsidePath, str]
    model: dict[InsidePath, str]
    git: Git | None
    machine: dict[str, str | int | float]
    packages: dict[str, str]
    digest: str | None = None

    @field_validator("plan", "machine")
    @classmethod
    def _as_reports_read_it(cls, value: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        # Not while a run writes its result, which may state whatever became of it.
        if info.context == _READING:
            (_Plan if info.field_name == "plan" else _Machine).model_validate(value)
        return value

    @field_validator("scores")
    @classmethod
    def _measured_amounts(cls, scores: dict[str, float], info: ValidationInfo) -> dict[str, float]:
        for column in _AMOUNTS if info.context == _READING else ():
            if column in scores and not 0 <= scores[column] <= _LARGEST:  # NaN compares false
                raise ValueError(f"{column} = {scores[column]}, expected a finite amount")
        return scores

    @property
    def finished(self) -> bool:
        """Whether the spec alone decided the outcome, so that another run would only repeat it. A crash, or a lack of
        memory or time, may be due to the machine."""
        return self.status in (Status.OK, Status.DIVERGED)


def write_result(folder: Path, result: Result) -> None:
    """Write `folder`/result.json, atomically."""
    write_with_digest(folder / RESULT_FILE, result.model_dump(mode="python"))


def read_result(path: Path) -> Result:
    """Read a result.json, or the one in a folder; an older schema is migrated.

    Raises InputError when the file is missing, incomplete, not JSON, of a newer schema, or was changed later.
    """
    path = Path(path)
    path = path / RESULT_FILE if path.is_dir() else path
    data = parse_json(read_text(path, "a result that `dofbench run` wrote"), path)
    if isinstance(data, dict):
        version = data.get("schema_version")
        if FIELD in data or version == SCHEMA_VERSION:
            require_digest(path, data, expected="the result as `dofbench run` wrote it")
        if FIELD in data and isinstance(version, int) and version < SCHEMA_VERSION:
            raise InputError(path, f"a digest in schema_version {version}", f"schema_version {SCHEMA_VERSION}")
    try:
        return Result.model_validate(migrate(data, path), context=_READING)
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, e['loc'])) or 'the whole'}: {e['msg']}" for e in error.errors()]
        raise InputError(path, "; ".join(problems), f"a result of schema version {SCHEMA_VERSION}") from None


def migrate(data: Any, path: Path) -> dict[str, Any]:
    """Apply `MIGRATIONS` until the data are of `SCHEMA_VERSION`. Raises InputError if that isn't possible."""
    version = data.get("schema_version") if isinstance(data, dict) else None
    expected = f"schema_version 1 ... {SCHEMA_VERSION}"
    if not isinstance(version, int):
        raise InputError(path, "no schema_version", expected)
    if version > SCHEMA_VERSION:
        raise InputError(path, f"schema_version {version}, written by a newer dofbench", expected)
    while version < SCHEMA_VERSION:
        if version not in MIGRATIONS:
            raise InputError(path, f"schema_version {version}", expected)
        try:
            data = MIGRATIONS[version](data)
        except (KeyError, TypeError, AttributeError) as error:
            raise InputError(
                path,
                f"schema_version {version}, and in it {type(error).__name__}: {error}",
                "what a result of that version holds",
            ) from None
        version += 1
        data["schema_version"] = version
    return data
