"""Running a user's command within limits of time and memory."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench.core.errors import Ended, InputError, Status

_GUARD = Path(__file__).parent / "guard.py"
_EVERY = 1.0  # seconds between two signs of life
_LAST_LINES = 3  # of the log, in a message
_NOTED = 20_000  # characters of the log that a failed run keeps
# Words by which programs say that memory, of the machine or of an accelerator, was not enough.
_NO_MEMORY = ("out of memory", "MemoryError", "DefaultCPUAllocator", "bad_alloc")


@dataclass(frozen=True)
class Limits:
    """Limits of a command. seconds: wall time. memory_mb: resident memory of all its processes, MB."""

    seconds: float
    memory_mb: float


@dataclass(frozen=True)
class Taken:
    """Use of a command with all its processes. seconds: wall time. peak_mb: resident memory, MB."""

    seconds: float
    peak_mb: float


def run_command(
    command: Sequence[str], folder: Path, log: Path, limits: Limits, alive: Callable[[float], None]
) -> Taken:
    """Run a command in `folder`, its output added to `log`. alive: called every second with the seconds so far.

    Raises `Ended` with a typed status and the log's last lines, more of them as a note, if it fails or runs into a
    limit; InputError if it can't be started. In any case, also after KeyboardInterrupt, none of its processes is left.
    """
    wanted = {
        "command": list(command),
        "folder": str(folder),
        "log": str(log),
        "seconds": limits.seconds,
        "memory_mb": limits.memory_mb,
    }
    start = time.monotonic()
    guard = subprocess.Popen(
        [sys.executable, "-I", "-S", str(_GUARD), json.dumps(wanted)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C reaches this process, which then ends the command in order
    )
    assert guard.stdin is not None and guard.stdout is not None and guard.stderr is not None
    try:
        while True:
            try:
                guard.wait(_EVERY)
                break
            except subprocess.TimeoutExpired:
                alive(time.monotonic() - start)
    finally:
        guard.stdin.close()  # the guard then ends what still runs
        guard.wait()
        said, trouble = guard.stdout.read(), guard.stderr.read()
        guard.stdout.close()
        guard.stderr.close()
    if guard.returncode:
        last = trouble.strip().splitlines()
        if last and last[-1].startswith(("FileNotFoundError", "PermissionError")):
            raise InputError(command[0], "no program that can be started", "one on the path, or with its folder")
        raise RuntimeError(f"the guard of {command[0]} died: {' '.join(last[-1:])}")
    end = json.loads(said)
    taken = Taken(end["seconds"], end["peak_mb"])
    text = log.read_text(encoding="utf-8", errors="replace")
    if (failure := _failure(end, command[0], limits, text)) is not None:
        failure.add_note(f"The end of what it printed:\n{text[-_NOTED:]}")
        raise failure
    return taken


def _failure(end: dict[str, Any], program: str, limits: Limits, text: str) -> Ended | None:
    """The guard's report as an exception; None if all went well. text: the command's output."""
    if end["how"] == "time":
        return Ended(Status.OUT_OF_TIME, f"{program} was ended after {limits.seconds:.0f} s, its limit")
    if end["how"] == "memory":
        found = f"{program} was ended at {end['peak_mb']:.0f} MB, its limit is {limits.memory_mb:.0f} MB"
        return Ended(Status.OUT_OF_MEMORY, found)
    if not end["code"]:
        return None
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    status = Status.OUT_OF_MEMORY if any(word in text for word in _NO_MEMORY) else Status.CRASHED
    how = f"exit status {end['code']}" if end["code"] > 0 else f"killed by signal {-end['code']}"
    return Ended(status, f"{program}: {how}: {' | '.join(lines[-_LAST_LINES:]) or 'it printed nothing'}")
