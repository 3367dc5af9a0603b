"""Pins of results that a refactoring must not change: bytes of datasets, bits of trainings, scores, tables of stored
results.

    python benchmarks/pins.py make PINS --code CHECKOUT [--scenes SCENES]     # some five minutes
    python benchmarks/pins.py compare PINS --code CHECKOUT [--scenes SCENES]

`make` runs commands of one checkout and stores their results in the folder PINS; `compare` runs the commands of another
checkout, prints what differs, and ends with status 1 if anything does. Run both on one machine, because bits may differ
between machines. Parts that are in PINS (or in its comparison) aren't made again, so an interrupted call can be
repeated. This file uses only the standard library and `dofbench` commands, so it works with any checkout.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

# Columns that depend on a clock or on the state of the machine, and so differ in every run.
TIMED = {"train_s", "train_cpu_s", "cold_start_s", "render_fps", "peak_mb", "fit_s"}
SMALL = ("--width", "96", "--depth", "sfm")
# name -> options of make-dataset after the scene; {scenes} is the folder of real scenes.
DATASETS = {
    "builtin": (),
    "fixed": ("{code}/datasets/tabletop", "--width", "96", "--assign", "fixed", "--focus", "0.3", "--aperture", "0.7"),
    "held-out": (
        "{code}/datasets/tabletop",
        "--width",
        "96",
        "--assign",
        "held-out",
        "--focus",
        "0.2,0.8",
        "--test-focus",
        "0.5",
    ),
    "continuous": ("{code}/datasets/tabletop", "--width", "96", "--assign", "continuous", "--focus", "0.2,0.8"),
    "layered": (
        "{code}/datasets/tabletop",
        "--width",
        "96",
        "--renderer",
        "layered",
        "--shape",
        "6-gon",
        "--photons",
        "500",
        "--bits",
        "16",
    ),
    "fern": ("{scenes}/llff_fern", "--width", "126", "--focus", "0.2,0.8", "--aperture", "1.0", "--depth", "sfm"),
    "chessking": ("{scenes}/shallow_chessking", "--photographs", "shallow", "--layout", "colmap", "--width", "125"),
}
_STEPS = ("--budget", "200it")
# name -> (dataset, options of run)
TRAININGS = {
    "scatter": ("builtin", ("--set", "lens_trials=", *_STEPS)),
    "own blur": ("builtin", ("--set", "lens_trials=", "lens_model=samples", "lens_rings=0", *_STEPS)),
    "samples": ("builtin", ("--set", "lens_trials=", "lens_model=samples", "lens_rings=1", *_STEPS)),
    "trials": ("held-out", _STEPS),
    "colours": ("chessking", ("--force-all", *_STEPS)),
    **{
        f"prior {name}": ("continuous", ("--set", f"depth_prior={name}", "start_points=0", "lens_trials=", *_STEPS))
        for name in ("sparse", "stereo", "network", "tuned")
    },
    "paper": ("held-out", ("--preset", "paper", "--set", "depth_prior=sparse", *_STEPS)),
    "released": ("held-out", ("--preset", "released", "--set", "depth_prior=sparse", *_STEPS)),
}
GROUPS = ("lens", "light", "invariants", "gaussians", "images", "files", "datasets", "training", "gradients")


@dataclass(frozen=True)
class Place:
    """The checkout and the folders of a call. code: the checkout. work: the folder to write to. scenes: the folder of
    real scenes, or None."""

    code: Path
    work: Path
    scenes: Path | None

    def call(self, *words: str) -> None:
        """One dofbench command; a failure is printed and ends the program."""
        print("dofbench", *words, flush=True)
        environment = {**os.environ, "PYTHONPATH": str(self.code)}
        done = subprocess.run(
            [sys.executable, "-m", "dofbench", *words],
            cwd=self.work,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        if done.returncode:
            sys.exit(f"{done.stdout[-3000:]}\nexit status {done.returncode}")


def datasets(place: Place) -> Iterator[tuple[str, Callable[[], dict[str, object]]]]:
    """Checksums of every file of each dataset."""
    for name, words in DATASETS.items():
        if place.scenes is None and any("{scenes}" in word for word in words):
            continue
        yield f"dataset {name}", lambda name=name: _files(_dataset(place, name))


def _dataset(place: Place, name: str) -> Path:
    folder = place.work / "data" / name
    if not (folder / "dataset.json").is_file():
        words = [word.format(code=place.code, scenes=place.scenes) for word in DATASETS[name]]
        place.call("make-dataset", *words, "--out", f"data/{name}")
    return folder


def trainings(place: Place) -> Iterator[tuple[str, Callable[[], dict[str, object]]]]:
    """Scores, and checksums of model and predictions, of short trainings."""
    for name, (dataset, words) in TRAININGS.items():
        if place.scenes is None and "{scenes}" in "".join(DATASETS[dataset]):
            continue
        yield f"training {name}", lambda name=name, dataset=dataset, words=words: _training(place, name, dataset, words)


def _training(place: Place, name: str, dataset: str, words: tuple[str, ...]) -> dict[str, object]:
    _dataset(place, dataset)
    out = place.work / "results" / name.replace(" ", "-")
    if not list(out.glob("*/*/result.json")):
        place.call("run", "--method", "dofgaussian", "--data", f"data/{dataset}", *words, "--out", str(out))
    (file,) = out.glob("*/*/result.json")
    result = json.loads(file.read_text())
    scores = {f"score {key}": value for key, value in result["scores"].items() if key not in TIMED}
    return {**_files(file.parent, skip={"result.json"}), **scores, "status": result["status"]}


def reports(place: Place, kept: Path) -> Iterator[tuple[str, Callable[[], dict[str, object]]]]:
    """The CSVs of a report of the results that `make` stored, so that both checkouts report on the same results."""

    def report() -> dict[str, object]:
        out = place.work / "report"
        place.call("report", str(kept), "--out", str(out), "--no-pictures")
        return {path.name: _sum(path) for path in sorted(out.glob("*.csv"))}

    yield "report", report


def stability(place: Place) -> Iterator[tuple[str, Callable[[], dict[str, object]]]]:
    """Every error of the stability table."""
    for group in GROUPS:
        yield f"stability {group}", lambda group=group: _stability(place, group)


def _stability(place: Place, group: str) -> dict[str, object]:
    place.call("stability", "--group", group, "--out", f"stability/{group}")
    with (place.work / "stability" / group / "stability.csv").open() as stream:
        return {
            " ".join((row["case"], row["backend"], row["precision"])): f"{row['error']} {row['verdict']}"
            for row in csv.DictReader(stream)
        }


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _files(folder: Path, skip: frozenset[str] | set[str] = frozenset()) -> dict[str, object]:
    return {
        str(path.relative_to(folder)): _sum(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in skip
    }


def made(place: Place, file: Path, kept: Path) -> dict[str, dict[str, object]]:
    """All parts, each written to the file as soon as it is finished; parts that are in the file aren't made again."""
    found = json.loads(file.read_text()) if file.is_file() else {}
    place.work.mkdir(parents=True, exist_ok=True)
    for name, part in (*datasets(place), *trainings(place), *reports(place, kept), *stability(place)):
        if name not in found:
            found[name] = part()
            unfinished = file.with_suffix(".part")
            unfinished.write_text(json.dumps(found, indent=1))
            unfinished.rename(file)
    return found


def differences(before: dict[str, dict[str, object]], after: dict[str, dict[str, object]]) -> list[str]:
    """One line for each difference; NaN equals NaN."""
    lines = []
    for part in (*before, *(name for name in after if name not in before)):
        one, two = before.get(part, {}), after.get(part, {})
        lines += [
            f"{part}: {key}: {one.get(key, 'absent')} -> {two.get(key, 'absent')}"
            for key in dict.fromkeys((*one, *two))
            if repr(one.get(key)) != repr(two.get(key))
        ]
    return lines


def main() -> None:
    """Make the pins, or compare with them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "compare"))
    parser.add_argument("pins", type=Path)
    parser.add_argument("--code", type=Path, required=True)
    parser.add_argument("--scenes", type=Path)
    asked = parser.parse_args()
    pins, scenes = asked.pins.resolve(), asked.scenes.resolve() if asked.scenes else None
    place = Place(asked.code.resolve(), pins / ("made" if asked.what == "make" else "compared"), scenes)
    kept = pins / "made" / "results"
    if asked.what == "make":
        made(place, pins / "pins.json", kept)
        return
    shutil.rmtree(place.work / "report", ignore_errors=True)
    lines = differences(json.loads((pins / "pins.json").read_text()), made(place, pins / "compared.json", kept))
    print("\n".join(lines) or "no difference")
    sys.exit(1 if lines else 0)


if __name__ == "__main__":
    main()
