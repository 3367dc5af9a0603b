"""The page of an ablation table as JSON: written by `ablate`, and shown unchanged by `report --ablation`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.reporting.view import Document

SCHEMA = "dofbench.ablation"
VERSION = 1
_WHAT = "a table that `dofbench ablate` wrote"
_DOCUMENT = TypeAdapter(Document)


def write_document(folder: Path, document: Document) -> Path:
    """Write `folder`/`document.id`.json atomically and return its path."""
    path = folder / f"{document.id}.json"
    write_json(path, {"schema_name": SCHEMA, "version": VERSION, "document": asdict(document)})
    return path


def read_documents(folder: Path) -> tuple[Document, ...]:
    """All tables of a folder, by name. Raises InputError without a table, or if a file isn't a table of this
    version."""
    files = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not files:
        expected = "tables that `dofbench ablate` wrote; calling it again writes them without running what is finished"
        raise InputError(folder, "no *.json", expected)
    return tuple(_read(file) for file in files)


def _read(file: Path) -> Document:
    data = read_json(file)
    if not isinstance(data, dict) or data.get("schema_name") != SCHEMA:
        raise InputError(file, "something else", _WHAT)
    if data.get("version") != VERSION:
        raise InputError(file, f"version {data.get('version')!r}", f"version {VERSION}, as `dofbench ablate` writes it")
    try:
        return _DOCUMENT.validate_python(data.get("document"))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise InputError(file, f"{place}: {first['msg']}", _WHAT) from None
