"""Measurements of an unfinished run on disk, so that the same command can continue; removed when the run is
finished."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from dofbench.core.content import content_folder, method_folders
from dofbench.core.source_digest import PACKAGE, source_digest
from dofbench.evaluation.stability.case import Found

FILE = ".unfinished.jsonl"


class Unfinished:
    """Measurements by case and setting in a folder, one line of JSON each; those by other code are ignored."""

    def __init__(self, out: Path):
        self._file = out / FILE
        self._code = source_digest([PACKAGE, content_folder("kernels"), *method_folders()], (".py", ".toml"))

    def read(self) -> dict[str, Found]:
        """The stored measurements, without those by other code and without a truncated line."""
        found = {}
        try:
            lines = self._file.read_text(encoding="utf-8").splitlines()
        except OSError:
            return {}
        for line in lines:
            try:
                entry = json.loads(line)
                if entry["code"] == self._code:
                    found[entry["name"]] = Found(**entry["found"])
            except (ValueError, KeyError, TypeError, AttributeError):
                continue
        return found

    def keep(self, name: str, found: Found) -> None:
        """Store a measurement."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        entry = {"code": self._code, "name": name, "found": asdict(found)}
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")

    def forget(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)
