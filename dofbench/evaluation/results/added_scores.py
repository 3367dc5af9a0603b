"""Scores computed after a run, stored next to its result.json, which never changes."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file, write_json
from dofbench.evaluation.results.result import RESULT_FILE, Git, Stored

ADDED_FILE = "added.json"
ADDED_VERSION = 1


class AddedScore(Stored):
    """The score of one column. value: mean of `views`, values by test view. of: the source, stored "predictions" or a
    rendering of the stored "model". note: the metric's. code: `provenance.code_version`. scored: time of
    computation. weights: sha256 of a user's weights, "" for a metric without; scores by others aren't compared."""

    value: float
    views: dict[str, float]
    of: str
    note: str
    code: str
    git: Git | None
    scored: str
    weights: str = ""


class Added(Stored):
    """The content of added.json. key, result_sha256: of the result. scores: by column. left_out: reasons by column."""

    schema_version: int
    key: str
    result_sha256: str
    scores: dict[str, AddedScore]
    left_out: dict[str, str]


def write_added(folder: Path, added: Added) -> None:
    """Write `folder`/added.json, atomically."""
    write_json(folder / ADDED_FILE, added.model_dump(mode="python", exclude_defaults=True))


def read_added(folder: Path) -> Added | None:
    """The scores added to the result in `folder`, or None. Raises InputError for a damaged file or another result's."""
    file = folder / ADDED_FILE
    if not file.is_file():
        return None
    try:
        added = Added.model_validate(read_json(file))
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, e['loc'])) or 'the whole'}: {e['msg']}" for e in error.errors()]
        raise InputError(file, "; ".join(problems), f"added scores of version {ADDED_VERSION}") from None
    if added.schema_version != ADDED_VERSION:
        raise InputError(file, f"schema_version {added.schema_version}", f"{ADDED_VERSION}")
    if added.result_sha256 != sha256_file(folder / RESULT_FILE):
        raise InputError(file, f"scores of another {RESULT_FILE} than the one beside it", "dofbench score made again")
    return added
