"""How `dofbench report` grows with the number of results: time, memory, sizes of pages, and how fast they open.

    tar xf reports/boards/results/attic-quick.tar.xz -C RESULTS
    python -m benchmarks.speed.reports RESULTS --out FOLDER

Results are copies of those in RESULTS with changed scenes, options, seeds and scores. `--shape scenes`: 16 rows, five
seeds, and as many scenes as it takes; `rows`: four scenes, two seeds, and as many rows. One in 250 runs failed. There
are no pictures: tests/reporting/test_large_report.py has some. Pages, the overview's and a scene's, are opened in
headless Chromium, the best of three: milliseconds to the end of the load event. Printed last: exponents of the growth
of time and memory over the results, fitted to the counts from a tenth of the largest on; below, start-up is most of it.
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from dofbench.core.digests import write_with_digest
from dofbench.core.files import write_csv
from dofbench.evaluation.results.result import RESULT_FILE, Spec
from tests.chromium import opened_in

COLUMNS = "shape results wall_s processor_s peak_mib files page_mb largest opened_ms slowest markdown_mb csv_mb".split()
ROWS, SEEDS = 16, 5  # of the shape "scenes"
SCENES, FEW_SEEDS = 4, 2  # of the shape "rows"
KEPT = "train_s train_cpu_s cold_start_s steps peak_mb".split()  # scores that a failed run still has


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    results: tyro.conf.Positional[Path]
    """Folder with results to copy, all of one dataset."""
    out: Path
    """Folder for reports-SHAPE.csv."""
    counts: tuple[int, ...] = (10, 100, 500, 1500, 5000)
    """Numbers of results."""
    shape: Literal["scenes", "rows"] = "scenes"
    """What there is more of where there are more results."""
    work: Path = Path("/tmp/reports-speed")
    """Scratch folder; results and report of each count stay in it."""


def size_of(shape: str, count: int) -> tuple[int, int, int]:
    """(scenes, rows, seeds) that make at least so many results."""
    if shape == "scenes":
        return max(1, math.ceil(count / (ROWS * SEEDS))), ROWS, SEEDS
    return SCENES, max(2, math.ceil(count / (SCENES * FEW_SEEDS))), FEW_SEEDS


def copies(settings: Settings, count: int, folder: Path) -> None:
    """Write `count` results below a folder. Rows are the results as they are, then with options as in ablations."""
    bases = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(settings.results.rglob(RESULT_FILE))]
    scenes, rows, seeds = size_of(settings.shape, count)
    every = [(scene, row, seed) for scene in range(scenes) for row in range(rows) for seed in range(seeds)]
    for scene, row, seed in every[:count]:
        turn, base = divmod(row, len(bases))
        own = changed(bases[base], scene, row, seed, {"means_lr": turn * 1e-5} if turn else {})
        write_with_digest(folder / Spec.model_validate(own["spec"]).folder / RESULT_FILE, own)


def changed(base: dict[str, Any], scene: int, row: int, seed: int, overrides: dict[str, float]) -> dict[str, Any]:
    """A copy of a result as of another scene, row and seed, with other scores; perhaps failed."""
    chance, own, name = random.Random(f"{scene} {row} {seed}"), json.loads(json.dumps(base)), f"scene{scene:03}"
    own["spec"] |= {"dataset": name, "dataset_checksum": f"{scene:064x}", "seed": seed, "overrides": overrides}
    own["spec"]["options"] |= overrides
    own |= {"key": Spec.model_validate(own["spec"]).key, "scene": name, "choices": f"{row:064x}"}
    for scores in (own["scores"], *(one["scores"] for one in (*own["views"], *own["curve"]))):
        for column in scores:
            scores[column] *= 1 + 0.02 * chance.random()
    if chance.random() < 1 / 250:
        own |= {"status": "crashed", "message": f"RuntimeError: no memory at step {chance.randrange(3000)}"}
        own |= {"views": [], "lens": [], "predictions": {}, "model": {}}
        own["scores"] = {column: value for column, value in own["scores"].items() if column in KEPT}
    return own


def report(results: Path, out: Path) -> dict[str, float]:
    """Make the report in a process of its own: wall and processor seconds, and largest resident memory."""
    command = (sys.executable, "-m", "dofbench", "report", str(results), "--out", str(out))
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"dofbench report ended with status {os.waitstatus_to_exitcode(status)}")
    wall, processor = time.perf_counter() - started, used.ru_utime + used.ru_stime
    return {"wall_s": wall, "processor_s": processor, "peak_mib": used.ru_maxrss / 1024}


def largest(values: Mapping[Path, float]) -> tuple[float, Path]:
    """The largest value and whose it is."""
    return max((value, page) for page, value in values.items())


def measure(settings: Settings, count: int) -> dict[str, Any]:
    """A row of the file."""
    folder = settings.work / f"{settings.shape}-{count}"
    shutil.rmtree(folder, ignore_errors=True)
    copies(settings, count, folder / "results")
    out = folder / "report"
    row: dict[str, Any] = {"shape": settings.shape, "results": count, **report(folder / "results", out)}
    size = {file: file.stat().st_size / 1e6 for file in out.rglob("*") if file.is_file()}
    scenes = sorted((out / "scenes").iterdir())[:1] if (out / "scenes").is_dir() else []
    page, its = largest({file: own for file, own in size.items() if file.suffix == ".html"})
    slow, whose = largest({page: opened_in(page) for place in (out, *scenes) for page in place.glob("*.html")})
    return row | {
        "files": len(size),
        "page_mb": page,
        "largest": its.relative_to(out).as_posix(),
        "opened_ms": slow,
        "slowest": whose.relative_to(out).as_posix(),
        "markdown_mb": max(own for file, own in size.items() if file.suffix == ".md"),
        "csv_mb": sum(own for file, own in size.items() if file.suffix == ".csv"),
    }


def main(settings: Settings) -> None:
    """Measure every number of results, and write the file after each."""
    rows: list[dict[str, Any]] = []
    for count in settings.counts:
        rows.append(measure(settings, count))
        print(rows[-1], flush=True)
        write_csv(settings.out / f"reports-{settings.shape}.csv", COLUMNS, rows)
    large = [row for row in rows if 10 * row["results"] >= max(settings.counts)]
    for column in ("processor_s", "peak_mib") if len(large) > 1 else ():
        logs = [[math.log(row[name]) for row in large] for name in ("results", column)]
        print(f"{column}: grows as results to the power of {statistics.linear_regression(*logs).slope:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
