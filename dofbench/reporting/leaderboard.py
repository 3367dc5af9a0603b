"""All scores by dataset and as means over scenes, and the figures that authors published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting import table_cells
from dofbench.reporting.boards import Board, by_kind, mean_lines
from dofbench.reporting.held_out import asked_section
from dofbench.reporting.pairwise import Pair, pairwise_section
from dofbench.reporting.paper import OF_THEIR_SSIM, names_their_ssim
from dofbench.reporting.points_seen import with_points_note
from dofbench.reporting.report_view import BoardView, CurveView
from dofbench.reporting.score_table import score_table
from dofbench.reporting.summary import sorted_lines
from dofbench.reporting.view import Heading, Items, Paragraph, Picture, Section, Table

Names = dict[tuple[str, ...], tuple[str, str]]


def board_view(
    board: Board,
    columns: Sequence[str],
    names: Names,
    pairs: Sequence[Pair],
    curves: tuple[CurveView, ...],
    strip: Picture | None,
) -> BoardView:
    """The view of one board: its scores, its pictures, and the comparison of its rows."""
    lines = [*board.lines.values(), *([board.nothing] if board.nothing is not None else [])]
    trained = "trained on the sharp originals" if board.sharp else board.lenses
    about = f"Scene {board.scene}; dataset checksum {board.checksum}{'; ' if board.lenses else ''}"
    groups = [(board.lines[variant], seeds) for variant, seeds in board.variants.items()]
    photographed = "" if board.sharp else f" {PHOTOGRAPHER_SAYS[board.photographer]}"
    evidence = f"{ROLE_SAYS[board.role]}{photographed}"
    return BoardView(
        board.title,
        Paragraph(f"{evidence} {about}{trained if board.lenses else ''}."),
        with_points_note(score_table(sorted_lines(lines), columns, board.title), board.members),
        pairwise_section(pairs, names, board.title, {variant: line.signs for variant, line in board.lines.items()}),
        asked_section(groups, board.title) if board.held_out else None,
        curves,
        strip,
    )


def mean_sections(
    boards: Sequence[Board], columns: Sequence[str], names: Names, pairs: Mapping[str, Sequence[Pair]]
) -> tuple[Section, ...]:
    """Means over the boards of each kind that has several. pairs: `mean_pairs`."""
    sections = []
    for kind, scenes in by_kind(boards).items():
        if kind not in pairs:
            continue
        title = f"Means over scenes, {kind}"
        means = mean_lines(scenes, columns)
        lines = sorted_lines(list(means.values()))
        signs = {variant: line.signs for variant, line in means.items()}
        compared = pairwise_section(pairs[kind], names, title, signs)
        over = Paragraph(f"Scenes: {', '.join(board.name for board in scenes)}.")
        blocks = (over, score_table(lines, columns, title), *((compared,) if compared else ()))
        sections.append(Section(title, blocks))
    return tuple(sections)


def claims_section(entries: Sequence[Entry]) -> Section | None:
    """The figures that authors published for their methods, in a separate table because data and metrics differ from
    ours."""
    installed = method_files()
    used = sorted({entry.spec.method for entry in entries})
    cards = {method: find_method(method).card for method in used if method in installed}
    claims = {method: card.claims for method, card in cards.items() if card.claims is not None}
    if not claims:
        return None
    columns = list(dict.fromkeys(column for claim in claims.values() for row in claim.rows.values() for column in row))
    rows = []
    for method, claim in claims.items():
        silent = f"{claim.source} gives no such figure"
        for measured_on, values in claim.rows.items():
            figures = [
                table_cells.number(values[column], f"{values[column]:g}")
                if column in values
                else table_cells.gap(silent)
                for column in columns
            ]
            names = (table_cells.words(method), table_cells.words(measured_on))
            rows.append((*names, *figures, table_cells.words(claim.source)))
    headings = (
        *table_cells.word_headings("method", "measured on"),
        *(table_cells.score_heading(COLUMNS[column]) if column in COLUMNS else Heading(column) for column in columns),
        *table_cells.word_headings("source"),
    )
    title = "Published by the authors, on their own data"
    of_ssim = f" {OF_THEIR_SSIM}" if names_their_ssim(columns) else ""
    said = Paragraph(f"Not measured here, and not comparable with the tables above digit by digit.{of_ssim}")
    return Section(title, (said, Table(title, headings, tuple(rows), names=2)))


def added_section(entries: Sequence[Entry]) -> Section | None:
    """Which scores were computed after their runs, and by which code."""
    by_code: dict[str, dict[str, None]] = {}
    for entry in entries:
        for column, score in (entry.added.scores if entry.added else {}).items():
            by_code.setdefault(score.code, {})[column] = None
    if not by_code:
        return None
    said = Paragraph("From the pictures and models that they kept, by `dofbench score`.")
    items = Items(tuple(f"{', '.join(columns)}: by code {code}." for code, columns in by_code.items()))
    return Section("Added after the runs", (said, items))


def column_section(columns: Sequence[str]) -> Section:
    """Section that explains each score."""
    known = [COLUMNS[column] for column in columns]
    return Section("What the columns say", (Items(tuple(f"{one.label} ({one.id}): {one.note}." for one in known)),))
