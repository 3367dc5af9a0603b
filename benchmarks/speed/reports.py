"""How `dofbench report` grows with the number of results: time, memory, sizes of pages, and how fast they open.

    tar xf reports/boards/results/attic-quick.tar.xz -C RESULTS
    python -m benchmarks.speed.reports RESULTS --out reports/speed

Results are copies of those in RESULTS with changed scenes, options, seeds and scores. `--shape scenes`: 16 rows, five
seeds, and as many scenes as it takes; `rows`: four scenes, two seeds, and as many rows. One in 250 runs failed. With
`--data`, a dataset, each has pictures too, in the size of its images. Pages are opened in headless Chromium, the best
of three: milliseconds to the end of the load event. reports.csv has a row for each number of results, growth.csv the
exponents between the two largest.
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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from dofbench.core.digests import write_with_digest
from dofbench.core.files import sha256_file, write_csv, write_json
from dofbench.datasets.format.schema import MANIFEST
from dofbench.evaluation.results.result import RESULT_FILE, Spec
from tests.chromium import browser

COLUMNS = """shape results pictures wall_s processor_s peak_mib files page_mb page_names opened_ms slowest
    markdown_mb csv_mb""".split()
ROWS, SEEDS = 16, 5  # of the shape "scenes"
SCENES, FEW_SEEDS = 4, 2  # of the shape "rows"
SCORED = "train_s train_cpu_s cold_start_s steps peak_mb".split()  # what a failed run still has
KINDS = ("refocus", "refocus_error", "all_in_focus", "all_in_focus_error", "resolved")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    results: tyro.conf.Positional[Path]
    """Folder with results to copy, all of one dataset."""
    out: Path
    """Folder for reports-SHAPE.csv."""
    counts: tuple[int, ...] = (10, 100, 500, 1000, 2500, 5000)
    """Numbers of results."""
    shape: Literal["scenes", "rows"] = "scenes"
    """What there is more of where there are more results."""
    data: Path | None = None
    """Dataset whose images stand for pictures; without one there are none."""
    work: Path = Path("/tmp/reports-speed")
    """Scratch folder; what is in it is deleted."""


def size_of(shape: str, count: int) -> tuple[int, int, int]:
    """(scenes, rows, seeds) that make about so many results."""
    if shape == "scenes":
        return max(1, math.ceil(count / (ROWS * SEEDS))), min(ROWS, count), SEEDS
    return SCENES, max(2, math.ceil(count / (SCENES * FEW_SEEDS))), FEW_SEEDS


def changed_rows(bases: list[dict[str, Any]], rows: int) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(result to copy, options that differ) of each row: each result as it is, then as rows of ablations."""
    every = ((base, {} if turn == 0 else {"means_lr": turn * 1e-5}) for turn in range(rows) for base in bases)
    return [next(every) for _ in range(rows)]


def copies(settings: Settings, count: int, folder: Path) -> None:
    """Write `count` results below `folder`/results, and datasets below `folder`/data."""
    bases = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(settings.results.rglob(RESULT_FILE))]
    scenes, rows, seeds = size_of(settings.shape, count)
    left = count
    for scene in range(scenes):
        name = f"scene{scene:03}"
        checksum = f"{scene:064x}" if settings.data is None else linked_dataset(settings.data, folder / "data" / name)
        for row, (base, overrides) in enumerate(changed_rows(bases, rows)):
            for seed in range(seeds):
                if left == 0:
                    return
                left -= 1
                own = changed(base, name, checksum, row, overrides, seed)
                place = folder / "results" / Spec.model_validate(own["spec"]).folder
                own["data"] = str(folder / "data" / name)
                if settings.data is not None and own["views"]:
                    own["predictions"] = dict(pictures(folder / "data" / name, place, seed == 0, own["views"]))
                place.mkdir(parents=True)
                write_with_digest(place / RESULT_FILE, own)


def changed(
    base: dict[str, Any], scene: str, checksum: str, row: int, overrides: dict[str, Any], seed: int
) -> dict[str, Any]:
    """A copy of a result as of another scene, row and seed, with other scores."""
    chance, own = random.Random(f"{scene} {row} {seed}"), json.loads(json.dumps(base))
    own["spec"] |= {"dataset": scene, "dataset_checksum": checksum, "seed": seed, "overrides": overrides}
    own["spec"]["options"] |= overrides
    own |= {"key": Spec.model_validate(own["spec"]).key, "scene": scene, "choices": f"{row:064x}", "data_from_here": ""}
    for scores in (own["scores"], *(one["scores"] for one in (*own["views"], *own["curve"]))):
        for column in scores:
            scores[column] *= 1 + 0.02 * chance.random()
    if chance.random() < 1 / 250:
        own |= {"status": "crashed", "message": f"RuntimeError: no memory at step {chance.randrange(3000)}"}
        own |= {"views": [], "lens": [], "predictions": {}, "model": {}}
        own["scores"] = {column: value for column, value in own["scores"].items() if column in SCORED}
    return own


def linked_dataset(data: Path, folder: Path) -> str:
    """A copy of the dataset by hard links, of another name; returns its checksum."""
    shutil.copytree(data, folder, copy_function=os.link)
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    (folder / MANIFEST).unlink()  # the link to the other's
    write_json(folder / MANIFEST, manifest | {"name": folder.name})
    return sha256_file(folder / MANIFEST)


def pictures(data: Path, place: Path, there: bool, views: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """(name, sha256) of a run's pictures, images of the dataset with other bytes behind their end; files are written
    if `there`, as reports show one seed."""
    images = sorted((data / "images").rglob("*.png"))
    for number, view in enumerate(views):
        content = images[number % len(images)].read_bytes()
        for kind in KINDS if there else ():
            file = place / "predictions" / kind / f"{view['name']}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content + f"{place.name}{kind}".encode())
            yield file.relative_to(place).as_posix(), sha256_file(file)


def report(folder: Path, options: tuple[str, ...]) -> dict[str, float]:
    """Make the report in a process of its own: wall and processor seconds, and largest resident memory."""
    command = (sys.executable, "-m", "dofbench", "report", str(folder / "results"), "--out", str(folder / "report"))
    started = time.perf_counter()
    process = subprocess.Popen((*command, *options), stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    assert status == 0, f"dofbench report: status {status}"
    return {
        "wall_s": time.perf_counter() - started,
        "processor_s": used.ru_utime + used.ru_stime,
        "peak_mib": used.ru_maxrss / 1024,
    }


def opened(page: Path) -> float:
    """Milliseconds until the page is loaded; the best of three."""
    times = []
    for _ in range(3):
        with browser() as chromium:
            chromium.size(1280, 900)
            chromium.open(page)
            chromium.wait("performance.timing.loadEventEnd > 0")
            times.append(chromium.run("performance.getEntriesByType('navigation')[0].loadEventEnd"))
            assert chromium.errors == [], chromium.errors
    return min(times)


def measure(settings: Settings, count: int) -> dict[str, Any]:
    """A row of the file."""
    folder = settings.work / f"{settings.shape}-{count}"
    shutil.rmtree(folder, ignore_errors=True)
    copies(settings, count, folder)
    used = report(folder, () if settings.data else ("--no-pictures",))
    out = folder / "report"
    sizes = {
        suffix: {file: file.stat().st_size / 1e6 for file in out.rglob(f"*{suffix}")}
        for suffix in (".html", ".md", ".csv")
    }
    scenes = sorted((out / "scenes").iterdir())[:1] if (out / "scenes").is_dir() else []
    times = {page: opened(page) for place in (out, *scenes) for page in place.glob("*.html")}
    largest, slowest = (
        max(sizes[".html"], key=lambda page: sizes[".html"][page]),
        max(times, key=lambda page: times[page]),
    )
    row = {
        "shape": settings.shape,
        "results": count,
        "pictures": "yes" if settings.data else "no",
        **used,
        "files": sum(file.is_file() for file in out.rglob("*")),
        "page_mb": sizes[".html"][largest],
        "page_names": largest.relative_to(out).as_posix(),
        "opened_ms": times[slowest],
        "slowest": slowest.relative_to(out).as_posix(),
        "markdown_mb": max(sizes[".md"].values()),
        "csv_mb": sum(sizes[".csv"].values()),
    }
    print(
        ", ".join(
            f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items()
        )
    )
    return row


def main(settings: Settings) -> None:
    """Measure every number of results, and write the file."""
    rows = [measure(settings, count) for count in settings.counts]
    write_csv(settings.out / f"reports-{settings.shape}.csv", COLUMNS, rows)
    large = [row for row in rows if 10 * row["results"] >= max(settings.counts)]
    for column in ("processor_s", "peak_mib"):
        logs = [[math.log(float(row[name])) for row in large] for name in ("results", column)]
        print(f"{column}: grows as results to the power of {statistics.linear_regression(*logs).slope:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
