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
from dofbench.core.files import TEMPORARY, read_json, refuse_links_outside, write_json

RECORD = "reconstruct.json"
_WORK, _STATE, _TIMES, _MOVED = ".work", "state.json", "seconds.json", "moved.json"


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
        refuse_links_outside(self.root)
        record = self.root / RECORD
        if record.is_file():
            found = read_json(record)
            if not isinstance(found, dict) or found.get("identity") != identity:
                raise InputError(
                    self.root,
                    "another reconstruction",
                    "the same one (photographs, settings, version), or another --out",
                )
            if self._begun():
                shutil.rmtree(self.folder)
            return "complete"
        moved = read_json(self.folder / _MOVED) if (self.folder / _MOVED).is_file() else []
        others = [entry.name for entry in self.root.iterdir() if entry.name != _WORK and entry.name not in moved]
        if any(not name.startswith(".") for name in others) or (others and not self._begun()):
            raise InputError(self.root, "files that are no reconstruction", "an empty or a new folder")
        if self._begun():
            if read_json(self.folder / _STATE) == {"identity": identity}:
                return "open"
            shutil.rmtree(self.folder)
        elif self.folder.is_dir() and any(not entry.name.startswith(TEMPORARY) for entry in self.folder.iterdir()):
            raise InputError(self.folder, "a folder that reconstruct didn't make", "an empty or a new folder")
        write_json(self.folder / _STATE, {"identity": identity})
        return "open"

    def finish(self) -> None:
        """Move the result to its place, the record last, and take the rest away."""
        paths = sorted(self.scene.iterdir(), key=lambda path: path.name == RECORD)
        write_json(self.folder / _MOVED, [path.name for path in paths])
        for path in paths:
            _move(path, self.root / path.name)
        shutil.rmtree(self.folder)

    def _begun(self) -> bool:
        """Whether the work folder is a reconstruction's."""
        file = self.folder / _STATE
        if not file.is_file():
            return False
        state = read_json(file)
        return isinstance(state, dict) and state.keys() == {"identity"}

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


def _move(path: Path, place: Path) -> None:
    """Move a file or folder to its place; a folder that a run which was cut off moved in part is completed."""
    if path.is_dir() and place.is_dir():
        for below in sorted(path.iterdir()):
            _move(below, place / below.name)
    else:
        path.replace(place)
