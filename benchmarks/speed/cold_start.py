"""Time of the first run on a machine, without installation, and what of it is JIT compilation: cold-start.csv.

    python -m benchmarks.speed.cold_start before=CHECKOUT after=CHECKOUT --out reports/speed

README's first command with two steps instead of a whole training, in an empty folder, with an empty cache of kernels
(cold) and once more (warm), for each checkout in turn. Columns: wall and processor seconds of the whole command, the
processor's of all processes; wall seconds of imports and of warm-up as the result has them; kernels compiled; load of
the machine before.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import tyro

from dofbench.core.files import read_json, write_csv

FIELDS = ("sources", "cache", "threads", "wall_s", "processor_s", "import_s", "warm_up_s", "kernels", "load")
COMMAND = ("-m", "dofbench", "run", "--method", "lensselect", "--budget", "2it", "--rerun")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    sources: tyro.conf.Positional[tuple[str, ...]]
    """Checkouts, NAME=FOLDER."""
    out: Path
    """Folder for cold-start.csv."""
    times: int = 1
    """How often each is measured."""
    threads: int = 2
    """Threads of the kernels, and processes that compile."""


def measured(name: str, sources: Path, folder: Path, cache: str, threads: int) -> dict[str, object]:
    """A row of one run in `folder`, where the kernels of an earlier one are."""
    environment = os.environ | {
        "PYTHONPATH": str(sources),
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "OMP_NUM_THREADS": str(threads),
        "NUMBA_NUM_THREADS": str(threads),
    }
    load, before, started = os.getloadavg()[0], _processor_seconds(), perf_counter()
    subprocess.run([sys.executable, *COMMAND], cwd=folder, env=environment, check=True, capture_output=True)
    wall, processor = perf_counter() - started, _processor_seconds() - before
    (file,) = folder.rglob("result.json")
    result = read_json(file)
    stages = result["stages"]
    row = (name, cache, threads, wall, processor, stages["import"]["wall"], stages["warm up"]["wall"])
    return dict(zip(FIELDS, (*row, result["kernels_compiled"], round(load, 1)), strict=True))


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(settings: Settings) -> None:
    rows = []
    for _ in range(settings.times):
        for source in settings.sources:
            name, _, sources = source.partition("=")
            with tempfile.TemporaryDirectory() as folder:
                for cache in ("cold", "warm"):
                    rows.append(measured(name, Path(sources).resolve(), Path(folder), cache, settings.threads))
                    print(rows[-1], flush=True)
    write_csv(settings.out / "cold-start.csv", FIELDS, rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
