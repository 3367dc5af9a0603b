"""Runs a command within its limits; started as a process of its own, with nothing but the standard library.

    python guard.py '{"command": [...], "folder": "...", "log": "...", "seconds": 60, "memory_mb": 4000}'

The command becomes the leader of a session, all processes of which are killed when it has ended, when a limit is
reached, and when standard input closes: whoever started the guard has died or wants no more. Standard output gets one
line of JSON: how it ended ("exit", "time", "memory" or "stopped"), its exit status, and what all its processes took.
"""

import contextlib
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

_EVERY = 0.2  # seconds between two looks
_PATIENCE = 3.0  # seconds between asking a command to end and killing it


def main() -> None:
    """Run the command, then say how it ended."""
    wanted = json.loads(sys.argv[1])
    start = time.monotonic()
    with Path(wanted["log"]).open("ab") as log:
        child = subprocess.Popen(
            wanted["command"],
            cwd=wanted["folder"],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        most, how = 0.0, "exit"
        while child.poll() is None:
            most = max(most, session_mb(child.pid))
            if most > wanted["memory_mb"]:
                how = "memory"
            elif time.monotonic() - start > wanted["seconds"]:
                how = "time"
            elif select.select([sys.stdin], [], [], _EVERY)[0]:
                how = "stopped"
            if how != "exit":
                end(child)
                break
        left_behind(child.pid, signal.SIGKILL)
    took = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        json.dumps(
            {
                "how": how,
                "code": child.returncode,
                "seconds": time.monotonic() - start,
                "peak_mb": max(most, took.ru_maxrss * 1024 / 1e6),
            }
        )
    )


def end(child: "subprocess.Popen[bytes]") -> None:
    """Ask all processes of the session to end, and kill those that don't."""
    left_behind(child.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(_PATIENCE)
    left_behind(child.pid, signal.SIGKILL)
    child.wait()


def left_behind(session: int, number: int) -> None:
    """Send a signal to all processes of a session."""
    for pid in members(session):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, number)


def members(session: int) -> list[int]:
    """The processes of a session."""
    return [int(pid) for pid, fields in _processes() if int(fields[3]) == session]


def session_mb(session: int) -> float:
    """Resident memory of all processes of a session, MB. Pages that several share are counted for each."""
    pages = sum(int(fields[21]) for _, fields in _processes() if int(fields[3]) == session)
    return pages * resource.getpagesize() / 1e6


def _processes() -> "list[tuple[str, list[str]]]":
    """(pid, what /proc/PID/stat has behind the command's name) of every process."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                found.append((folder.name, (folder / "stat").read_text().rpartition(")")[2].split()))
    return found


if __name__ == "__main__":
    main()
