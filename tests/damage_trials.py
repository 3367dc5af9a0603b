"""Damaged files tried in a process of their own, since a library's native code may crash, hang or take all memory.

Run as a program, `python damage_trials.py FOLDER KIND FIRST COUNT`, it tries seeds FIRST, FIRST + 1, ... and writes a
JSON line before and after each; `tried` starts it, watches it, and starts it again behind a seed that ended it.
"""

from __future__ import annotations

import json
import os
import random
import resource
import select
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

# Seconds for one input of a few kilobytes; a hang is caught by it, a slow machine isn't.
LONGEST = 30.0
# Address space that one input may take beyond what the imported libraries have: 10^9 float32 values and a copy of a
# part (docs/datasets.md, "What is read").
MEMORY = 5 * 2**30


@dataclass(frozen=True)
class Tried:
    """One damaged input. verdict: "read", "refused", or what went wrong, with a traceback."""

    kind: str
    seed: int
    done: str
    verdict: str
    message: str


def tried(folder: Path, kind: str, first: int, count: int) -> Iterator[Tried]:
    """Damage the files of a kind `count` times and use them; the results in order of the seeds."""
    end = first + count
    while first < end:
        command = [sys.executable, "-P", __file__, str(folder), kind, str(first), str(end - first)]
        path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
        environment = {**os.environ, "PYTHONPATH": path}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as child:
            assert child.stdout is not None and child.stderr is not None
            os.set_blocking(child.stderr.fileno(), False)
            begun, said, buffer = "", b"", b""
            since = time.monotonic()
            while True:
                ready, _, _ = select.select([child.stdout, child.stderr], [], [], LONGEST)
                if child.stderr in ready:
                    said = (said + (child.stderr.read() or b""))[-4000:]
                if child.stdout in ready:
                    chunk = os.read(child.stdout.fileno(), 1 << 16)
                    buffer += chunk
                    *lines, buffer = buffer.split(b"\n")
                    for line in lines:
                        since = time.monotonic()
                        note = json.loads(line)
                        if "begun" in note:
                            begun = note["begun"]
                        else:
                            yield Tried(kind, first, begun, note["verdict"], note["message"])
                            first, begun = first + 1, ""
                    if not chunk:
                        break
                if time.monotonic() - since > LONGEST:
                    child.kill()
                    said += f"\nnothing for {LONGEST} seconds".encode()
                    break
            child.kill()
            status = child.wait()
        if first < end:
            yield Tried(kind, first, begun, f"ended with {status}", said.decode(errors="replace"))
            first += 1


def _try_all(folder: Path, kind: str, first: int, count: int) -> None:
    from damaged_files import KINDS, damage

    from dofbench.core.errors import InputError

    make, use = KINDS[kind]
    whole, copy = folder / "whole", folder / "damaged"
    if not whole.is_dir():
        make(whole)
        use(whole)  # undamaged files are read; this imports what is needed, too
    else:
        use(whole)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    out = os.fdopen(os.dup(1), "w")
    for seed in range(first, first + count):
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(whole, copy)
        out.write(json.dumps({"begun": damage(copy, random.Random(f"{kind} {seed}"))}) + "\n")
        out.flush()
        message = ""
        try:
            use(copy)
            verdict = "read"
        except InputError as error:
            verdict, message = "refused", str(error)
            if len(message.splitlines()) != 1 or not message.isprintable():
                verdict = "refused in several lines"
        except Exception as error:
            verdict, message = f"{type(error).__name__}: {error}"[:200], traceback.format_exc()[-2500:]
        out.write(json.dumps({"verdict": verdict, "message": message}) + "\n")
        out.flush()


if __name__ == "__main__":
    _try_all(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
