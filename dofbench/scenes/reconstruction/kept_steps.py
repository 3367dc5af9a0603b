"""What a reconstruction keeps between its stages, so that one that was cut off goes on."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json

RECORD = "reconstruct.json"
_WORK, _STATE, _TIMES = ".work", "state.json", "seconds.json"


@dataclass(frozen=True)
class Work:
    """The folder of the scene, and within it the one of what isn't finished."""

    root: Path

    @property
    def folder(self) -> Path:
        """Everything that is not the result."""
        return self.root / _WORK

    @property
    def photographs(self) -> Path:
        """The photographs as the stages see them."""
        return self.folder / "photographs"

    @property
    def database(self) -> Path:
        """COLMAP's features and matches."""
        return self.folder / "database.db"

    @property
    def model(self) -> Path:
        """COLMAP's model, complete when it is there."""
        return self.folder / "model"

    @property
    def scene(self) -> Path:
        """The result before it is moved to its place."""
        return self.folder / "scene"

    def begin(self, identity: str) -> Literal["complete", "open"]:
        """Make the folder ready for the reconstruction `identity`, keeping what an earlier run of the same finished.

        What another one left unfinished is thrown away. Raises InputError where the folder holds anything else.
        """
        record = self.root / RECORD
        if record.is_file():
            found = read_json(record)
            if not isinstance(found, dict) or found.get("identity") != identity:
                raise InputError(
                    self.root,
                    "another reconstruction",
                    "the same one (photographs, settings, version), or another --out",
                )
            shutil.rmtree(self.folder, ignore_errors=True)
            return "complete"
        if any(entry.name != _WORK for entry in self.root.iterdir()) and not (self.folder / _STATE).is_file():
            raise InputError(self.root, "files that are no reconstruction", "an empty or a new folder")
        if (self.folder / _STATE).is_file() and read_json(self.folder / _STATE) == {"identity": identity}:
            return "open"
        shutil.rmtree(self.folder, ignore_errors=True)
        write_json(self.folder / _STATE, {"identity": identity})
        return "open"

    def finish(self) -> None:
        """Move the result to its place, the record last, and take the rest away."""
        for path in sorted(self.scene.iterdir(), key=lambda path: path.name == RECORD):
            place = self.root / path.name
            if place.is_dir():  # moved by a run that was cut off right here
                shutil.rmtree(place)
            path.replace(place)
        shutil.rmtree(self.folder)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that the block takes to that stage's; a run that is cut off loses what it spent in a stage."""
        start = time.monotonic()
        yield
        times = self.seconds()
        times[stage] = round(times.get(stage, 0.0) + time.monotonic() - start, 2)
        write_json(self.folder / _TIMES, times)

    def seconds(self) -> dict[str, Any]:
        """Seconds spent, by stage."""
        return read_json(self.folder / _TIMES) if (self.folder / _TIMES).is_file() else {}
