"""The CSV files of a report: every number of every run, without averages and unrounded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.results.collecting import Entry, added_columns, board_names, grouped, variant_names
from dofbench.evaluation.results.columns import FILE_SCORES, IDENTITY, PER_VIEW, STANDING
from dofbench.reporting.boards import frozen_state, role_of
from dofbench.reporting.sections import commit_text, machine_text

Row = dict[str, object]

CURVE_COLUMNS = """method preset dataset protocol seed train_s steps psnr ssim aif_psnr aif_ssim delta_a delta_f delta_r
    loss train_cpu_s photo_psnr photo_ssim across_psnr across_ssim role""".split()
COMPARISON_COLUMNS = """dataset protocol method preset against_method against_preset column pairs seeds difference low
    high p verdict reason role groups above below spread""".split()
REACH_COLUMNS = """method preset dataset scene protocol seed score level reached_s not_before_s held status
    role clock""".split()
FRONT_COLUMNS = "dataset protocol score train_s value method preset role clock".split()
TIMES_COLUMNS = "method preset dataset scene protocol seed within stage wall_s cpu_s role".split()
MADE_COLUMNS = (*IDENTITY, *"budget device key code started ended command commit machine message".split())


def run_tables(entries: Sequence[Entry]) -> dict[str, tuple[Sequence[str], Iterator[Row]]]:
    """Name -> (columns, rows) of the files that have rows for single runs."""
    return {
        "leaderboard": (run_columns(entries), run_rows(entries)),
        "per_view": (view_columns(entries), view_rows(entries)),
        "curves": (CURVE_COLUMNS, curve_rows(entries)),
        "times": (TIMES_COLUMNS, time_rows(entries)),
        "runs": (MADE_COLUMNS, made_rows(entries)),
    }


def run_columns(entries: Sequence[Entry]) -> tuple[str, ...]:
    """The columns of `run_rows`."""
    return (*IDENTITY, *FILE_SCORES, *added_columns(entries), *STANDING)


def run_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row per run. A cell is empty when the run lacks the score; the pages give the reason."""
    for entry, who in _identified(entries):
        yield {**who, **entry.scores, "frozen": frozen_state(entry)}


def view_columns(entries: Sequence[Entry]) -> tuple[str, ...]:
    """The columns of `view_rows`."""
    return (*PER_VIEW, *added_columns(entries), "role")


def view_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every test view (its scores) and every training view (its lens and the errors)."""
    for entry, who in _identified(entries):
        if entry.result is not None:
            yield from ({**who, "view": view, "split": "test", **scores} for view, scores in entry.views.items())
            for lens in entry.result.lens:
                yield {**who, "split": "train", **lens.model_dump(exclude={"name"}), "view": lens.name}


def curve_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every moment of training that was scored."""
    for entry, who in _identified(entries):
        for point in entry.result.curve if entry.result else ():
            times = {name: getattr(point, name) for name in ("train_s", "steps", "loss", "train_cpu_s")}
            yield {**who, **point.scores, **times}


def made_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row per run: how it was made, and on which machine."""
    for entry, who in _identified(entries):
        spec, result = entry.spec, entry.result
        row = {**who, "budget": spec.budget, "device": spec.device, "key": spec.key, "code": spec.code}
        if result is not None:
            row |= {name: getattr(result, name) for name in ("started", "ended", "command")}
            row |= {"commit": commit_text(result), "machine": machine_text(result)}
        yield {**row, "message": entry.message}


def time_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every stage of every run, and for every part of training that the method times itself (within
    "train", wall time alone)."""
    names = variant_names(tuple(entries))
    for entry, who in _identified(entries):
        if entry.result is not None:
            who["preset"] = names[entry.variant][1]
            for stage, time in entry.result.stages.items():
                yield {**who, "stage": stage, "wall_s": time.wall, "cpu_s": time.cpu}
            for stage, wall in entry.result.method_stages.items():
                yield {**who, "within": "train", "stage": stage, "wall_s": wall}


def _identified(entries: Sequence[Entry]) -> Iterator[tuple[Entry, Row]]:
    """Each run with its identity columns. A dataset's name has its checksum if two datasets have the same name."""
    boards = board_names(tuple(entries))
    roles = {board: role_of(members) for board, members in grouped(tuple(entries), "board").items()}
    for entry in entries:
        yield (
            entry,
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
            },
        )
