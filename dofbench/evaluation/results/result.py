"""The schema of result.json: a run's settings, scores and provenance. NaN and infinities are stored as such."""

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

SCHEMA_VERSION = 8
_DIGESTS_SINCE = 6  # the schema version
RESULT_FILE = "result.json"
# Folders next to result.json: the saved model, and predicted images
MODEL_FOLDER, PREDICTIONS_FOLDER = "model", "predictions"

Data = dict[str, Any]


def _from_1(data: Data) -> Data:
    """Version 2 has the scores CPU seconds and cold_start_s, CPU seconds along the curve, checksums of the model,
    and the number of compiled kernels."""
    training = data["stages"].get("train")
    scores = data["scores"] | ({"train_cpu_s": training["cpu"]} if training else {})
    left_out = data["left_out"] | {"cold_start_s": "not measured in schema version 1"}
    curve = [point | {"train_cpu_s": None} for point in data["curve"]]
    return data | {"scores": scores, "left_out": left_out, "curve": curve, "model": {}, "kernels_compiled": None}


def _from_6(fit: Data) -> Data:
    """Version 7 says of every fit whether it is at a bound; there was none before."""
    return fit | {"halves": [half | {"at_bound": False} for half in fit["halves"]]}


# Version -> conversion of a result's JSON data to the next version. Every increase of SCHEMA_VERSION needs an entry.
MIGRATIONS: dict[int, Callable[[Data], Data]] = {
    1: _from_1,
    2: lambda data: data | {"fits": [], "apertures": []},
    3: lambda data: data | {"role": None, "role_by": "", "photographer": None, "choices": None},
    4: lambda data: data | {"foci": []},
    5: lambda data: data | {"digest": None, "data_from_here": ""},
    6: lambda data: data | {"fits": [_from_6(fit) for fit in data.get("fits", [])]},
    7: lambda data: data,  # version 8 has held_out in the spec, which is 0 before
}


class Stored(BaseModel):
    """Base of stored records: immutable, no unknown keys, NaN and infinities allowed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True, protected_namespaces=())


# Seconds, bytes, steps, counts are finite, whatever the scores are.
_LARGEST = 1e15
Amount = Annotated[float, Field(ge=0, le=_LARGEST, allow_inf_nan=False)]
_READING = "reading"
_AMOUNTS = ("train_s", "train_cpu_s", "cold_start_s", "steps", "render_fps", "peak_mb", "gaussians")


class _Recorded(BaseModel):
    """Base of the entries of `plan` and `machine` that reports read; other entries are kept."""

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
    """The settings that decide a result; their hash is the cache key.

    options: the preset's with the changes of plan and user; overrides: the user's. budget: as in `--budget`.
    dataset_checksum: sha256 over its files. code: `provenance.code_version`. content: sha256 of the files that an
    option names, by option (`dofbench.training.common.options`); empty before version 6. held_out: share of the
    training views' pixels that the method didn't receive; 0 before version 8.
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
    held_out: float = 0.0

    @property
    def key(self) -> str:
        """sha256 of the spec as canonical JSON, without newer fields that have their neutral value."""
        neutral = {name for name in ("content", "held_out") if not getattr(self, name)}
        return sha256_text(canonical_json(self.model_dump(mode="json", exclude=neutral)))

    @property
    def folder(self) -> Path:
        """The folder of this spec's result, relative to the folder of results."""
        return Path(self.dataset) / f"{self.method}-{self.preset}-seed{self.seed}-{self.key[:8]}"


class StageTime(Stored):
    """Seconds of one stage: wall, and CPU over all threads."""

    wall: Amount
    cpu: Amount


class CurvePoint(Stored):
    """Scores by column at one moment of training.

    train_s, train_cpu_s: training seconds, wall and CPU (None before version 2), without evaluation. loss: mean since
    the previous point; None without steps.
    """

    train_s: Amount
    train_cpu_s: Amount | None
    steps: int = Field(ge=0, le=_LARGEST)
    loss: float | None
    scores: dict[str, float]


class ViewScores(Stored):
    """Scores of one test view by column."""

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
    """The fit on one half (0 or 1) of a view, by which the other half is predicted. aperture: pixels * scene unit at
    the view's width; focus_disparity: 1 / scene unit; None without a lens. sigma: px, of the Gaussian blur instead of
    the lens or besides it, or None; always None since photographs-v2. at_bound: whether the focus is at the bound of
    what the protocol allows. renders: number of renderings. error: mean squared error on the fitted half,
    encoded."""

    fitted_on: int
    aperture: float | None
    focus_disparity: float | None
    sigma: float | None
    at_bound: bool
    renders: int
    error: float


class ViewFit(Stored):
    """The fits of one test view of unknown lens, on one half or on both, by the protocol. seconds: wall time of the
    fits, not part of training."""

    name: str
    seconds: Amount
    halves: list[HalfFitted]


class ViewAperture(Stored):
    """Learned aperture of one training view, pixels * scene unit, and its f-number in EXIF."""

    name: str
    aperture: float
    f_number: float


class ViewFocus(Stored):
    """Learned focus of one training view, 1 / scene unit, and its distance in EXIF, m, may be infinite."""

    name: InsidePath
    focus_disparity: float
    distance: float


class Event(Stored):
    """A NaN or infinity, with its step and stage."""

    step: int
    view: str
    stage: str
    detail: str


class Git(Stored):
    """Commit of the checkout. dirty: with uncommitted changes."""

    commit: str
    dirty: bool


class Result(Stored):
    """One run.

    scores: by column. left_out: reasons for missing scores, by column. left_out_stages: reasons for skipped parts of
    the method. do_nothing: errors of the constant prediction A = F = 0.5. stages: of the run; method_stages: of the
    method, wall seconds within "train". kernels_compiled: during the run, None before version 2. predictions, model:
    sha256 by file, relative to the result's folder. data: the dataset's folder as given; data_from_here: relative to
    the result's folder, "" before version 6. role, role_by, photographer: of the dataset (`dofbench.core.evidence`);
    None, "", None if not stated and before version 4. choices: digest of preset and options
    (`dofbench.methods.frozen_presets`), None before version 4. git: None outside a checkout. digest: of result.json's
    text (`dofbench.core.digests`); None before version 6 and before it is written. no_ranking: why the dataset can't
    rank lenses, by this run's lenses and depth (`evaluation/scoring/photographs/lens_evidence.py`); "" if it can, or if
    that wasn't measured. resumed: the steps after which another process went on with the training.
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
    no_ranking: str = ""
    resumed: list[Annotated[int, Field(ge=0)]] = []

    @field_validator("plan", "machine")
    @classmethod
    def _as_reports_read_it(cls, value: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        # Only when reading: a run may write any outcome.
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

    def __repr__(self) -> str:
        return f"Result({self.line()})"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        from dofbench.core.notebook import as_html

        return as_html(repr(self), scores=self.shown_scores())

    def line(self) -> str:
        """Method, preset, seed, dataset and how it ended, with PSNR where there is one."""
        psnr = f", psnr {self.scores['psnr']:.2f} dB" if "psnr" in self.scores else ""
        return (
            f"{self.spec.method} {self.spec.preset} seed {self.spec.seed} on {self.spec.dataset}: {self.status}{psnr}"
        )

    def shown_scores(self) -> dict[str, str]:
        """The scores of metrics by label, with their units, as tables round them."""
        from dofbench.evaluation.metrics import METRICS

        known = [METRICS[column] for column in self.scores if column in METRICS]
        return {one.label: f"{self.scores[one.id]:.{one.digits}f} {one.unit}".strip() for one in known}

    @property
    def finished(self) -> bool:
        """Whether another run would repeat the outcome. A crash, or a lack of memory or time, may be the machine's."""
        return self.status in (Status.OK, Status.DIVERGED)


def write_result(folder: Path, result: Result) -> None:
    """Write `folder`/result.json, atomically."""
    write_with_digest(folder / RESULT_FILE, result.model_dump(mode="python"))


def read_result(path: Path | str) -> Result:
    """Read a result.json, or the one in a folder; older schemas are migrated.

    Raises InputError if the file is missing, incomplete, not JSON, of a newer schema, or was changed later.
    """
    path = Path(path)
    path = path / RESULT_FILE if path.is_dir() else path
    data = parse_json(read_text(path, "a result that `dofbench run` wrote"), path)
    if isinstance(data, dict):
        version = data.get("schema_version")
        digested = isinstance(version, int) and _DIGESTS_SINCE <= version <= SCHEMA_VERSION
        if FIELD in data or digested:
            require_digest(path, data, expected="the result as `dofbench run` wrote it")
        if FIELD in data and isinstance(version, int) and not digested:
            raise InputError(path, f"a digest in schema_version {version}", f"schema_version {_DIGESTS_SINCE} or newer")
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
            found = f"schema_version {version}, and in it {type(error).__name__}: {error}"
            raise InputError(path, found, "the content of that version") from None
        version += 1
        data["schema_version"] = version
    return data
