"""The work folder of a reconstruction, by which an interrupted run resumes, and interruptible calls into COLMAP."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from dofbench.core.errors import InputError
from dofbench.core.file_lock import FOLDER_LOCK
from dofbench.core.files import TEMPORARY, read_json, refuse_links_outside, write_json

RECORD = "reconstruct.json"
_WORK, _STATE, _TIMES, _MOVED = ".work", "state.json", "seconds.json", "moved.json"


class Work:
    """Paths of a reconstruction. root: of the scene. folder: of everything unfinished. photographs: as the stages see
    them. database: COLMAP's features and matches. model: COLMAP's model, complete when it exists. scene: the result
    before it is moved to its place."""

    def __init__(self, root: Path):
        self.root, self.folder = root, root / _WORK
        self.photographs, self.database = self.folder / "photographs", self.folder / "database.db"
        self.model, self.scene = self.folder / "model", self.folder / "scene"

    def begin(self, identity: str) -> Literal["complete", "open"]:
        """Prepare the folder for the reconstruction `identity`, keeping finished stages of the same one and deleting
        unfinished ones of another. Raises InputError where the folder holds anything else."""
        refuse_links_outside(self.root)
        record = self.root / RECORD
        if record.is_file():
            found = read_json(record)
            if not isinstance(found, dict) or found.get("identity") != identity:
                expected = "the same one (photographs, settings, version), or another --out"
                raise InputError(self.root, "another reconstruction", expected)
            if self._begun():
                shutil.rmtree(self.folder)
            return "complete"
        moved = read_json(self.folder / _MOVED) if (self.folder / _MOVED).is_file() else []
        ours = {_WORK, FOLDER_LOCK, *moved}
        others = [entry.name for entry in self.root.iterdir() if entry.name not in ours]
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
        """Move the result to its place, the record last, and delete the rest."""
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
        """Add the block's time to that of the stage; an interrupted run loses it."""
        start = time.monotonic()
        yield
        times = self.seconds()
        times[stage] = round(times.get(stage, 0.0) + time.monotonic() - start, 2)
        write_json(self.folder / _TIMES, times)

    def seconds(self) -> dict[str, Any]:
        """Seconds spent, by stage."""
        return read_json(self.folder / _TIMES) if (self.folder / _TIMES).is_file() else {}


def _move(path: Path, place: Path) -> None:
    """Move a file or folder to its place, or the rest of a folder that an interrupted run moved in part."""
    if path.is_dir() and place.is_dir():
        for below in sorted(path.iterdir()):
            _move(below, place / below.name)
    else:
        path.replace(place)


# Seconds between two looks at how far a call is.
_LOOK = 0.2


def wait(call: Callable[[], Any], look: Callable[[], None] | None = None) -> Any:
    """Run `call` in a thread; return its result or raise its exception. look: called from time to time meanwhile.

    An interruption is raised at once and leaves the thread to end with the process, so `call` must tolerate being cut
    off while it writes.
    """
    result: list[Any] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            result.append(call())
        except BaseException as error:  # raised again in the main thread
            failure.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(_LOOK)
        if look is not None:
            look()
    if failure:
        raise failure[0]
    return result[0]
