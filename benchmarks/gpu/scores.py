"""Compare scores of trainings on a GPU with those on a CPU: scores.csv.

    dofbench run --method METHODS --preset cpu --budget 1000it --device cuda --data data/fern252 --out results/gpu
    dofbench run --method METHODS --preset cpu --budget 1000it --device cpu --seeds 3 --data data/fern252 \\
        --out results/cpu
    python -m benchmarks.gpu.scores --gpu results/gpu --cpu results/cpu --out reports/gpu

A row for every method and score: what the GPU's training reached, the CPU's with the same seed, and the least and the
most of all of the CPU's seeds. Rounding differs between the two, and a training amplifies it, so they needn't agree
better than two seeds do.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from dofbench.core.errors import InputError, Status
from dofbench.core.files import write_csv
from dofbench.evaluation.results.collecting import Entry, collect

SCORES = ("psnr", "aif_psnr", "aif_ssim", "delta_a", "delta_f", "gaussians")
COLUMNS = ("method", "score", "gpu", "cpu", "difference", "cpu_least", "cpu_most", "cpu_seeds")


@dataclass(frozen=True)
class Settings:
    """Results to compare."""

    gpu: Path
    """Folder of the results of trainings on a GPU."""
    cpu: Path
    """Folder of the same trainings on a CPU, with the same seeds and more."""
    out: Path
    """Folder of scores.csv."""


def finished(folder: Path) -> list[Entry]:
    """The results below a folder that ended well, the latest last. Raises InputError where there are no results."""
    ended = [entry for entry in collect(folder).entries if entry.status is Status.OK]
    return sorted(ended, key=lambda one: one.result.started if one.result else "")


def trained_alike(one: Entry, other: Entry) -> bool:
    """Whether two runs differ by device, seed and code alone."""
    alike = ("method", "preset", "options", "budget", "dataset_checksum", "protocol")
    return all(getattr(one.spec, name) == getattr(other.spec, name) for name in alike)


def rows(gpu: list[Entry], cpu: list[Entry]) -> list[dict[str, object]]:
    """A row for every score of every run on the GPU that the CPU has with the same seed. Of runs of one seed that
    differ in their code alone the last one counts."""
    found: list[dict[str, object]] = []
    for entry in sorted(gpu, key=lambda one: (one.spec.method, one.spec.seed)):
        seeds = {one.spec.seed: one for one in cpu if trained_alike(one, entry)}
        if entry.spec.seed not in seeds:
            continue
        for score in (name for name in SCORES if name in entry.scores):
            here, there = entry.scores[score], seeds[entry.spec.seed].scores[score]
            others = [one.scores[score] for one in seeds.values()]
            values = (here, there, here - there, min(others), max(others), len(others))
            found.append(dict(zip(COLUMNS, (entry.spec.method, score, *values), strict=True)))
    return found


def main(settings: Settings) -> None:
    """Compare and write."""
    write_csv(settings.out / "scores.csv", COLUMNS, rows(finished(settings.gpu), finished(settings.cpu)))


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
