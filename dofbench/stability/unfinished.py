"""What a run that isn't finished has measured, so that the same command goes on; a finished run leaves nothing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import dofbench
from dofbench.core.content import content_folder, method_folders
from dofbench.stability.case import Found
from dofbench.stability.stability_options import GROUPS

FILE = ".unfinished.jsonl"
# What arranges and judges, and measures nothing.
_NEVER_MEASURES = (
    "catalogue.py",
    "limits.py",
    "limits.toml",
    "measure.py",
    "stability_options.py",
    "unfinished.py",
    "stability_table.py",
)


class Unfinished:
    """What was found, in a folder, by case and setting, as far as the same code found it: a line of JSON each."""

    def __init__(self, out: Path):
        self._file = out / FILE
        self._code = {group: code_of(group) for group in GROUPS}

    def read(self) -> dict[str, Found]:
        """What is kept; nothing of other code, and no line that was cut short."""
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
        """Add what was found under a name that begins with the group."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        entry = {"code": self._code[name.partition("/")[0]], "name": name, "found": asdict(found)}
        with open(self._file, "a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")

    def forget(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)


def code_of(group: str) -> str:
    """A hash of every source that can change what a group's cases find: all but the other groups' modules."""
    others = {f"{other}_cases.py" for other in GROUPS if other != group}
    digest, package = hashlib.sha256(), Path(dofbench.__file__).resolve().parent
    for root in (package, content_folder("kernels"), *method_folders()):
        for file in sorted(root.rglob("*")):
            aside = file.parent == package / "stability" and file.name in {*_NEVER_MEASURES, *others}
            if file.suffix in (".py", ".toml") and file.is_file() and not aside:
                digest.update(f"{file.relative_to(root).as_posix()}\0".encode())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
