"""Scores that were computed after a run was over, kept beside its result.json, which never changes."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file, write_json
from dofbench.evaluation.results.result import RESULT_FILE, Git, Stored

ADDED_FILE = "added.json"
ADDED_VERSION = 1


class AddedScore(Stored):
    """The score of one column. value: mean of `views`, which maps test view -> value. of: the data that the score was
    computed from, the stored "predictions" or a rendering of the stored "model". note: the metric's settings. code:
    `provenance.code_version` of the code that computed the score. scored: time of the computation."""

    value: float
    views: dict[str, float]
    of: str
    note: str
    code: str
    git: Git | None
    scored: str


class Added(Stored):
    """The content of added.json. key: the result's key. result_sha256: sha256 of the result.json that the scores belong
    to. scores: by column. left_out: column -> why it couldn't be computed."""

    schema_version: int
    key: str
    result_sha256: str
    scores: dict[str, AddedScore]
    left_out: dict[str, str]


def write_added(folder: Path, added: Added) -> None:
    """Write `folder`/added.json, atomically."""
    write_json(folder / ADDED_FILE, added.model_dump(mode="python"))


def read_added(folder: Path) -> Added | None:
    """The scores added to the result in `folder`; None if there are none.

    Raises InputError for a file that is damaged, or that belongs to another result.json than the one beside it.
    """
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
