"""The outcomes of planned runs, read from their folders."""

from __future__ import annotations

from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.evaluation.results.collecting import Entry, dead_entry, entry_of
from dofbench.evaluation.results.result import RESULT_FILE, read_result
from dofbench.evaluation.results.run_lock import at_work
from dofbench.running.plan import Plan


class Ended:
    """The runs that have ended, each read once."""

    def __init__(self) -> None:
        self._entries: dict[str, Entry] = {}

    def find(self, run: Plan) -> Entry | None:
        """How the run ended; None when it hasn't been made, or is at work."""
        key = run.spec.key
        if key not in self._entries and (entry := _read(run.folder, key)) is not None:
            self._entries[key] = entry
        return self._entries.get(key)

    def forget(self, run: Plan) -> None:
        """Read it anew next time."""
        self._entries.pop(run.spec.key, None)

    def finished(self, run: Plan) -> bool:
        """Whether making the run again would only repeat it."""
        entry = self.find(run)
        return entry is not None and entry.result is not None and entry.result.finished

    def words(self, run: Plan) -> str:
        """One or a few words: finished, and if so how; at work; or to be run, and why again."""
        entry = self.find(run)
        if entry is not None and self.finished(run):
            return "cached" if entry.status == "ok" else f"cached, {entry.status}"
        if at_work(run.folder):
            return "at work in another process"
        return "to be run" if entry is None else f"to be run again, {entry.status}"


def _read(folder: Path, key: str) -> Entry | None:
    """None also for a result that can't be read: the run is then made again, and writes it anew."""
    if (folder / RESULT_FILE).is_file():
        try:
            result = read_result(folder)
        except InputError:
            return None
        return entry_of(folder, result) if result.key == key else None
    if at_work(folder):
        return None
    try:
        entry = dead_entry(folder)
    except InputError:  # killed while it wrote its record
        return None
    return entry if entry is not None and entry.spec.key == key else None
