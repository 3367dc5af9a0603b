"""The CSV files: every number of every run, nothing averaged, nothing rounded away."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from dofbench.core.files import write_text
from dofbench.results.collecting import Entry, added_columns, board_names
from dofbench.results.columns import ALL_IN_FOCUS, DEPTH, FILE_SCORES, IDENTITY, LENS, PHOTOGRAPH, REFOCUS

CURVE_SCORES = ("psnr", "ssim", "aif_psnr", "aif_ssim", "delta_a", "delta_f")
CURVE_COLUMNS = (
    "method",
    "preset",
    "dataset",
    "protocol",
    "seed",
    "train_s",
    "steps",
    *CURVE_SCORES,
    "loss",
    "train_cpu_s",
    "photo_psnr",
    "photo_ssim",
    "across_psnr",
    "across_ssim",
)
_LENS_VALUES = ("aperture", "aperture_estimated", "focus", "focus_estimated")
VIEW_COLUMNS = (
    "method",
    "preset",
    "dataset",
    "scene",
    "protocol",
    "seed",
    "view",
    "split",
    *REFOCUS,
    *ALL_IN_FOCUS,
    *_LENS_VALUES,
    *LENS,
    *DEPTH,
    *PHOTOGRAPH,
)


def write_leaderboard_csv(path: Path, entries: tuple[Entry, ...]) -> None:
    """One row a run. A cell is empty when the run has no such score; the Markdown says why."""
    identities = _identities(entries)
    rows = [{**identity, **entry.scores} for entry, identity in zip(entries, identities, strict=True)]
    write_csv(path, (*IDENTITY, *FILE_SCORES, *added_columns(entries)), rows)


def write_per_view_csv(path: Path, entries: tuple[Entry, ...]) -> None:
    """One row for every test view (its scores) and every training view (its lens and the errors)."""
    rows = []
    for entry, identity in zip(entries, _identities(entries), strict=True):
        if entry.result is None:
            continue
        rows += [{**identity, "view": view, "split": "test", **scores} for view, scores in entry.views.items()]
        rows += [
            {**identity, "split": "train", **view.model_dump(exclude={"name"}), "view": view.name}
            for view in entry.result.lens
        ]
    write_csv(path, (*VIEW_COLUMNS, *added_columns(entries)), rows)


def write_curves_csv(path: Path, entries: tuple[Entry, ...]) -> None:
    """One row for every moment of training that was scored."""
    rows = []
    for entry, identity in zip(entries, _identities(entries), strict=True):
        for point in entry.result.curve if entry.result else ():
            rows.append(
                {
                    **identity,
                    **point.scores,
                    "train_s": point.train_s,
                    "steps": point.steps,
                    "loss": point.loss,
                    "train_cpu_s": point.train_cpu_s,
                }
            )
    write_csv(path, CURVE_COLUMNS, rows)


def _identities(entries: tuple[Entry, ...]) -> list[dict[str, object]]:
    """The identity columns of each entry; the dataset's name carries its checksum where one name means two."""
    boards = board_names(entries)
    return [
        {
            "method": entry.spec.method,
            "preset": entry.preset,
            "dataset": boards[entry.board],
            "scene": entry.scene,
            "protocol": entry.spec.protocol,
            "seed": entry.spec.seed,
            "status": str(entry.status),
        }
        for entry in entries
    ]


def write_csv(path: Path, columns: tuple[str, ...], rows: Iterable[dict]) -> None:
    """Write rows, column -> value, whole or not at all; a column that a row lacks is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_cell(row.get(column)) for column in columns])
    write_text(path, stream.getvalue())


def _cell(value: object) -> object:
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else f"{value:.8g}"
    return "" if value is None else value
