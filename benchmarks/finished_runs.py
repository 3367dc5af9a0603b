"""Finished runs on one dataset, for benchmarks that look at what was trained."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import Status
from dofbench.dataset.dataset import Dataset
from dofbench.results.collecting import Entry, collect


@dataclass(frozen=True)
class RunsSettings:
    """Which runs to measure."""

    data: Path
    """The dataset, made with --train-f-number and --test-f-number."""
    results: Path
    """Folder of results."""
    out: Path
    """Folder for the CSV file."""


def finished_runs(results: Path, dataset: Dataset) -> Iterator[Entry]:
    """Runs on the dataset that ended well."""
    for entry in collect(results).entries:
        if entry.status is Status.OK and entry.spec.dataset_checksum == dataset.checksum:
            yield entry
