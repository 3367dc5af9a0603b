"""The stiff and extreme cases of `dofbench stability` in the GPU's kernels, by Triton's interpreter.

    python -m benchmarks.gpu.stability --out reports/gpu

Kernel cases only, on the pretended device of tests/pretended_device.py. The interpreter is slow, so a case is given up
after `--seconds`, and its row says so. Rows go into stability.csv one by one, and the same command resumes. Ends with
status 1 where a bound isn't met and dofbench/evaluation/stability/limits.toml has no reason for it.
"""

from __future__ import annotations

import csv
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

os.environ["TRITON_INTERPRET"] = "1"  # Triton reads it when it is imported

from dofbench.runtime.threads import configure_threads

configure_threads()

import pytest  # noqa: E402
import tyro  # noqa: E402

from dofbench.core.files import write_csv  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from pretended_device import pretended  # noqa: E402

GROUPS = ("gradients", "images", "gaussians", "light", "lens", "fields", "invariants")
FIELDS = ("case", "kernel", "error", "bound", "outcome", "note", "seconds")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder of stability.csv."""
    seconds: float = 120.0
    """Seconds after which a case is given up."""
    case: tuple[str, ...] = ()
    """Cases to measure, as group/name; all by default."""


class TooSlow(BaseException):
    """A case took longer than it may. No Exception, since the interpreter wraps those into its own."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """A block that ends with TooSlow after so many seconds."""

    def stop(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def cases() -> Iterator[tuple[Any, Any]]:
    """Every case with its setting on the GPU; within `pretended`, since what this machine has is asked at import."""
    for group in GROUPS:
        for case in import_module(f"dofbench.evaluation.stability.{group}_cases").CASES:
            for setting in case.settings:
                if (setting.backend, setting.device) == ("gpu", "cuda"):
                    yield case, setting


def measured(case: Any, setting: Any, seconds: float) -> dict[str, str]:
    """The row of a case."""
    from dofbench.evaluation.stability.catalogue import limit_of, read_limits

    start, row = time.monotonic(), {"case": case.id, "kernel": case.subject}
    try:
        with limited(seconds):
            found = case.measure(setting)
    except TooSlow:
        return row | {"outcome": "too slow for the interpreter", "seconds": f"{seconds:.0f}"}
    except Exception as error:
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return row | {"outcome": "failed", "note": words[:200], "seconds": f"{time.monotonic() - start:.1f}"}
    known = limit_of(case, setting, read_limits())
    outcome = "met" if found.met else "not met" if known is None else "known limit"
    return row | {
        "error": f"{found.error:.6g}",
        "bound": f"{found.bound:.6g}",
        "outcome": outcome,
        "note": found.note,
        "seconds": f"{time.monotonic() - start:.1f}",
    }


def main(settings: Settings) -> int:
    """Measure what isn't in the table yet."""
    file = settings.out / "stability.csv"
    rows = list(csv.DictReader(file.open(encoding="utf-8"))) if file.is_file() else []
    done = {row["case"] for row in rows}
    with pytest.MonkeyPatch.context() as patch, pretended(patch):
        for case, setting in cases():
            if case.id in done or (settings.case and case.id not in settings.case):
                continue
            row = measured(case, setting, settings.seconds)
            rows.append({name: row.get(name, "") for name in FIELDS})
            write_csv(file, FIELDS, rows)
            print(*(rows[-1][name] for name in ("case", "outcome", "error", "bound", "seconds")), flush=True)
    wrong = [row["case"] for row in rows if row["outcome"] in ("not met", "failed")]
    for name in wrong:
        print(f"not met: {name}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings, description=__doc__)))
