"""Measurements of an unfinished run on disk, so that the same command can continue; removed when the run is
finished."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from dofbench.core.content import method_folders
from dofbench.core.import_closure import closure_digest, own_sources
from dofbench.core.source_graph import Sources
from dofbench.stability.case import Found
from dofbench.stability.stability_options import GROUPS

FILE = ".unfinished.jsonl"


class Unfinished:
    """Measurements by case and setting in a folder, one line of JSON each; those by other code are ignored."""

    def __init__(self, out: Path):
        self._file = out / FILE
        self._code = {group: code_of(group) for group in GROUPS}

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
                if entry["code"] == self._code[entry["name"].partition("/")[0]]:
                    found[entry["name"]] = Found(**entry["found"])
            except (ValueError, KeyError, TypeError, AttributeError):
                continue
        return found

    def keep(self, name: str, found: Found) -> None:
        """Store a measurement under a name that begins with the group's."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        entry = {"code": self._code[name.partition("/")[0]], "name": name, "found": asdict(found)}
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")

    def forget(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)


def code_of(group: str) -> str:
    """A digest of all code that can change a group's measurements: the code that its cases reach, and for training the
    methods."""
    found = (card.parent for root in method_folders() for card in sorted(root.glob("*/method.toml")))
    folders = list(found) if group == "training" else []
    methods = {f"method{index}": folder for index, folder in enumerate(folders)}
    entries = [f"dofbench.stability.{group}_cases", *(f"{name}." for name in methods)]
    cards = [(folder / "method.toml").read_bytes() for folder in folders]
    return closure_digest(entries, Sources(methods, beside=own_sources()), cards)
