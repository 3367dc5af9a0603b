"""Sections of a report: boards, means over scenes, held-out focus, published figures, explanations of the scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from dofbench.core.errors import Status
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.datasets.format.points_record import points_in_words
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import AIF_PREFIX, arithmetic_mean
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting.boards import Board, Line, Names, by_kind, mean_and_spread, mean_lines, sorted_lines
from dofbench.reporting.pairs import Pair, pair_sections
from dofbench.reporting.paper import ssim_note
from dofbench.reporting.tables import (
    Extra,
    Heading,
    Section,
    Table,
    cells,
    gap,
    number,
    score_headings,
    score_table,
    word_headings,
    words,
)

ASKED_HEADING = "Held-out focus, by the test views' lens"
_ASKED_COLUMNS = ("psnr", "ssim", "flip")  # metrics that all-in-focus renderings have too


def board_section(board: Board, columns: Sequence[str], names: Names, pairs: Sequence[Pair]) -> Section:
    """One board: its scores, the comparison of its rows, and where focus was held out, scores by the test views'
    lens."""
    lines = sorted_lines([*board.lines.values(), *([board.nothing] if board.nothing is not None else [])])
    trained = "trained on all-in-focus images" if board.sharp else board.lenses
    photographed = () if board.sharp else (PHOTOGRAPHER_SAYS[board.photographer],)
    about = f"Scene {board.scene}; dataset checksum {board.checksum}{f'; {trained}' if board.lenses else ''}."
    scores = score_table(lines, columns, board.title)
    scores = replace(scores, below=(*scores.below, points_in_words(board.points)))
    signs = {variant: line.signs for variant, line in board.lines.items()}
    groups = [(board.lines[variant], seeds) for variant, seeds in board.variants.items()]
    return Section(
        board.title,
        (" ".join((ROLE_SAYS[board.role], *photographed, about)),),
        (scores,),
        sections=(
            *pair_sections(pairs, names, board.title, signs),
            *(asked_sections(groups, board.title) if board.held_out else ()),
        ),
    )


def mean_sections(
    boards: Sequence[Board], columns: Sequence[str], names: Names, pairs: Mapping[str, Sequence[Pair]]
) -> tuple[Section, ...]:
    """Means over the boards of each kind that has several. pairs: `mean_pairs`."""
    sections = []
    for kind, scenes in by_kind(boards).items():
        if kind in pairs:
            title, means = f"Means over scenes, {kind}", mean_lines(scenes, columns)
            table = score_table(sorted_lines(list(means.values())), columns, title)
            compared = pair_sections(pairs[kind], names, title, {one: line.signs for one, line in means.items()})
            over = f"Scenes: {', '.join(board.name for board in scenes)}."
            sections.append(Section(title, (over,), (table,), sections=compared))
    return tuple(sections)


def asked_sections(groups: Iterable[tuple[Line, Sequence[Entry]]], dataset: str) -> tuple[Section, ...]:
    """Scores by the lens of the test views, and all in focus. groups: (line of all scores, its seeds); those with a
    failed run are skipped, as the table of all scores shows them."""
    lines = [line for whole, seeds in groups for line in _asked_lines(whole, seeds)]
    names = Extra(
        word_headings("method", "lens of the test views"),
        lambda line: (words(line.name, line.signs), words(line.seeds)),
    )
    table = score_table(lines, _ASKED_COLUMNS, f"{ASKED_HEADING}: {dataset}", before=names)
    return (Section(ASKED_HEADING, tables=(table,)),) if lines else ()


def _asked_lines(whole: Line, seeds: Sequence[Entry]) -> list[Line]:
    results = [entry.result for entry in seeds if entry.status is Status.OK and entry.result is not None]
    if not results or len(results) < len(seeds):
        return []
    test = results[0].plan["lenses"]["test"]
    asked: dict[tuple[float, float], list[str]] = {}
    for view, lens in test.items():
        if lens is not None and lens[0] > 0:  # None: an unknown lens
            asked.setdefault((lens[1], lens[0]), []).append(view)
    rows = [(f"F {focus:g}, A {aperture:g}", views, "") for (focus, aperture), views in sorted(asked.items())]
    lines = []
    for name, views, prefix in (*rows, ("A 0, all in focus", list(test), AIF_PREFIX)):
        by_seed = [[view.scores for view in result.views if view.name in views] for result in results]
        found = {}
        for column in _ASKED_COLUMNS:
            one = prefix + column
            known = all(one in scores for run in by_seed for scores in run)
            values = [arithmetic_mean([scores[one] for scores in run]) for run in by_seed] if known else []
            found[column] = mean_and_spread(values, results[0].left_out.get(one, "no such score"))
        if any(cell.value is not None for cell in found.values()):
            count = f"{len(views)} view{'s' if len(views) > 1 else ''}"
            lines.append(replace(whole, seeds=f"{name} ({count})", cells=found, competes=False))
    return lines


def claims_section(entries: Sequence[Entry]) -> Section | None:
    """The figures that authors published for their methods, apart because data and metrics differ from ours."""
    installed = method_files()
    used = sorted({entry.spec.method for entry in entries} & installed.keys())
    claims = {method: claim for method in used if (claim := find_method(method).card.claims) is not None}
    if not claims:
        return None
    columns = list(dict.fromkeys(column for claim in claims.values() for row in claim.rows.values() for column in row))
    rows = []
    for method, claim in claims.items():
        silent = gap(f"{claim.source} gives no such figure")
        for measured_on, values in claim.rows.items():
            figures = [number(values[one], f"{values[one]:g}") if one in values else silent for one in columns]
            rows.append(cells(method, measured_on, *figures, claim.source))
    scores = [score_headings([one])[0] if one in COLUMNS else Heading(one) for one in columns]
    headings = (*word_headings("method", "measured on"), *scores, *word_headings("source"))
    title = "Published by the authors, on their own data"
    said = f"Not measured here, and not directly comparable with the tables above.{ssim_note(columns)}"
    return Section(title, (said,), (Table(title, headings, tuple(rows), names=2),))


def added_section(entries: Sequence[Entry]) -> Section | None:
    """Which scores were computed after their runs, and by which code."""
    by_code: dict[str, dict[str, None]] = {}
    for entry in entries:
        for column, score in (entry.added.scores if entry.added else {}).items():
            by_code.setdefault(score.code, {})[column] = None
    items = tuple(f"{', '.join(columns)}: by code {code}." for code, columns in by_code.items())
    said = "Computed by `dofbench score` from the kept renderings and models."
    return Section("Added after the runs", (said,), items=items) if items else None


def column_section(columns: Sequence[str]) -> Section:
    """An explanation of each score."""
    known = [COLUMNS[column] for column in columns]
    return Section("Scores", items=tuple(f"{one.label} ({one.id}): {one.note}." for one in known))
