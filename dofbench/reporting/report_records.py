"""The content of a report's CSV files: every number of every run, without averages."""

from __future__ import annotations

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.results.collecting import Entry, added_columns, board_names, grouped, variant_names
from dofbench.evaluation.results.columns import (
    ALL_IN_FOCUS,
    DEPTH,
    FILE_SCORES,
    IDENTITY,
    LENS,
    PHOTOGRAPH,
    REFOCUS,
    STANDING,
)
from dofbench.reporting.records import Records
from dofbench.reporting.standing import frozen_state, role_of

CURVE_SCORES = ("psnr", "ssim", "aif_psnr", "aif_ssim", "delta_a", "delta_f", "delta_r")
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
    "role",
)
TIMES_COLUMNS = (
    "method",
    "preset",
    "dataset",
    "scene",
    "protocol",
    "seed",
    "within",
    "stage",
    "wall_s",
    "cpu_s",
    "role",
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


def run_records(entries: tuple[Entry, ...]) -> Records:
    """One row per run. A cell is empty when the run lacks the score; the pages give the reason."""
    rows = tuple(
        {**who, **entry.scores, "frozen": frozen_state(entry)}
        for entry, who in zip(entries, _identities(entries), strict=True)
    )
    return Records("leaderboard.csv", (*IDENTITY, *FILE_SCORES, *added_columns(entries), *STANDING), rows)


def view_records(entries: tuple[Entry, ...]) -> Records:
    """One row for every test view (its scores) and every training view (its lens and the errors)."""
    rows: list[dict[str, object]] = []
    for entry, who in zip(entries, _identities(entries), strict=True):
        if entry.result is None:
            continue
        rows += [{**who, "view": view, "split": "test", **scores} for view, scores in entry.views.items()]
        rows += [
            {**who, "split": "train", **view.model_dump(exclude={"name"}), "view": view.name}
            for view in entry.result.lens
        ]
    return Records("per_view.csv", (*VIEW_COLUMNS, *added_columns(entries), "role"), tuple(rows))


def curve_records(entries: tuple[Entry, ...]) -> Records:
    """One row for every moment of training that was scored."""
    rows = tuple(
        {
            **who,
            **point.scores,
            "train_s": point.train_s,
            "steps": point.steps,
            "loss": point.loss,
            "train_cpu_s": point.train_cpu_s,
        }
        for entry, who in zip(entries, _identities(entries), strict=True)
        for point in (entry.result.curve if entry.result else ())
    )
    return Records("curves.csv", CURVE_COLUMNS, rows)


def time_records(entries: tuple[Entry, ...]) -> Records:
    """One row for every stage of every run, and one for every part of the training that the method times itself (within
    "train", wall time alone)."""
    names = variant_names(entries)
    rows: list[dict[str, object]] = []
    for entry, identity in zip(entries, _identities(entries), strict=True):
        if entry.result is None:
            continue
        who = {**identity, "preset": names[entry.variant][1]}
        rows += [
            {**who, "stage": stage, "wall_s": time.wall, "cpu_s": time.cpu}
            for stage, time in entry.result.stages.items()
        ]
        rows += [
            {**who, "within": "train", "stage": stage, "wall_s": wall}
            for stage, wall in entry.result.method_stages.items()
        ]
    return Records("times.csv", TIMES_COLUMNS, tuple(rows))


def _identities(entries: tuple[Entry, ...]) -> list[dict[str, object]]:
    """The identity columns of each entry; the dataset's name includes its checksum if two datasets have the same
    name."""
    boards = board_names(entries)
    roles = {board: role_of(members) for board, members in grouped(entries, "board").items()}
    return [
        {
            "method": entry.spec.method,
            "preset": entry.preset,
            "dataset": boards[entry.board],
            "scene": entry.scene,
            "protocol": entry.spec.protocol,
            "seed": entry.spec.seed,
            "status": str(entry.status),
            "role": roles[entry.board] or ROLE_NOT_STATED,
            "photographer": entry.result.photographer if entry.result else None,
        }
        for entry in entries
    ]
