"""What a run that isn't finished has measured, so that the same command goes on; a finished run leaves nothing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import dofbench
from dofbench.content import content_folder, method_folders
from dofbench.stability.case import Found

FILE = ".unfinished.jsonl"
# What arranges and judges, and measures nothing.
_NEVER_MEASURES = ("catalogue.py", "limits.py", "limits.toml", "run.py", "settings.py", "store.py", "tables.py")


class Unfinished:
    """What was found, in a folder, by name, as far as the same code found it: a line of JSON each."""

    def __init__(self, out: Path):
        self._file = out / FILE
        self._code = _code()

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
                if entry["code"] == self._code:
                    found[entry["name"]] = Found(**entry["found"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def keep(self, name: str, found: Found) -> None:
        """Add what was found."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        with open(self._file, "a", encoding="utf-8") as stream:
            stream.write(json.dumps({"code": self._code, "name": name, "found": asdict(found)}) + "\n")

    def forget(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)


def _code() -> str:
    """A hash of every source that can change what is found."""
    digest, package = hashlib.sha256(), Path(dofbench.__file__).resolve().parent
    for root in (package, content_folder("kernels"), *method_folders()):
        for file in sorted(root.rglob("*")):
            arranges = file.parent == package / "stability" and file.name in _NEVER_MEASURES
            if file.suffix in (".py", ".toml") and file.is_file() and not arranges:
                digest.update(f"{file.relative_to(root).as_posix()}\0".encode())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
