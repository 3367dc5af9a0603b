"""The paper's table layouts, filled with what was measured here; its own figures stand in columns of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from dofbench.reporting.html.boards import Board, Variant, by_kind
from dofbench.reporting.html.markup import (
    Notes,
    Td,
    Th,
    gap_cell,
    number_cell,
    score_cell,
    score_heading,
    table,
    text_cell,
)
from dofbench.reporting.paper import NOTHING_PRINTED, Figures, paper_figures
from dofbench.reporting.summary import Line, best_texts, empty_columns, scene_mean
from dofbench.results.columns import COLUMNS, COST, Column
from dofbench.running.method_cards import find_method, method_files

_PAPER_DIGITS = 3  # of a printed SSIM
_CHANGED = "the paper's figures are of the method as it is, not with these options"
_SIDEWAYS = 6  # methods; with more of them the table of scenes has a row for each method


@dataclass(frozen=True)
class Layout:
    """One of the paper's tables. sharp: of methods trained on sharp photographs. columns: that it shows. scene_columns:
    that its table of scenes shows."""

    id: str
    title: str
    about: str
    sharp: bool
    columns: tuple[str, ...]
    scene_columns: tuple[str, ...]


@dataclass(frozen=True)
class _Over:
    """What a table's cells are of: a single board, over its seeds, or a mean over several. unchanged: variants in which
    the user changed no option."""

    single: bool
    words: str
    unchanged: frozenset[Variant]


LAYOUTS = (
    Layout(
        "synthetic",
        "Refocusing, and the lens that was learned",
        "Test views rendered through their own lens, "
        "against the shallow photograph; and how far the learned aperture and focus are off.",
        False,
        ("psnr", "ssim", "flip", "delta_a", "delta_f", "delta_r"),
        ("psnr", "ssim", "delta_a", "delta_f"),
    ),
    Layout(
        "main",
        "Sharp views from shallow photographs",
        "Trained on photographs with shallow depth of field, rendered all in focus, against the sharp original.",
        False,
        ("aif_psnr", "aif_ssim", "aif_flip"),
        ("aif_psnr", "aif_ssim"),
    ),
    Layout(
        "photographs",
        "Photographs of unknown lens",
        "Held-out photographs, predicted by a lens (or of a method "
        "without one by a blur) and colours that were fitted on half of each, scored on the other half.",
        False,
        ("photo_psnr", "photo_ssim", "photo_blur_psnr"),
        ("photo_psnr", "photo_ssim"),
    ),
    Layout(
        "across",
        "Photographs of another aperture",
        "Predicted by the learned aperture times the ratio of the f-numbers, by the same unchanged, and without any.",
        False,
        ("across_psnr", "across_ssim", "across_blurred_psnr", "unscaled_blurred_psnr", "in_focus_blurred_psnr"),
        ("across_psnr", "across_blurred_psnr"),
    ),
    Layout(
        "all_in_focus",
        "All-in-focus inputs",
        "Trained on the sharp originals and rendered sharp.",
        True,
        ("aif_psnr", "aif_ssim", "aif_flip"),
        ("aif_psnr", "aif_ssim"),
    ),
)


def layout_sections(boards: Sequence[Board], notes: Notes) -> list[str]:
    """The sections, one for each layout and kind of board that has any of its scores."""
    sections = []
    for layout in LAYOUTS:
        for kind, members in by_kind([board for board in boards if board.sharp is layout.sharp]).items():
            sections += _section(layout, kind, members, notes)
    return [*sections, *_time_sections(boards, notes)]


def _section(layout: Layout, kind: str, boards: list[Board], notes: Notes) -> list[str]:
    lines = _means(boards, layout.columns)
    if not any(
        board.lines[variant].cells[column].value is not None or board.lines[variant].cells[column].failure
        for board in boards
        for variant in board.lines
        for column in layout.columns
    ):
        return []
    figures, caption = paper_figures().get(layout.id, NOTHING_PRINTED), f"{layout.title}: {_over(boards).words}"
    over = _over(boards)
    single = figures.of_scene(boards[0].scene) if len(boards) == 1 else {}
    theirs = single or figures.means
    where = f"{boards[0].scene}, {figures.data}" if single else figures.data
    nothing = _nothing(boards, layout.columns)
    html = [f"<h3>{escape(layout.title)} <small>{escape(kind)}</small></h3>", f"<p>{escape(layout.about)}</p>"]
    has_mean = any(line.cells[column].value is not None for line in lines.values() for column in layout.columns)
    if has_mean or len(boards) == 1:
        html += [
            _mean_table(lines, nothing, layout.columns, over, theirs, figures, caption, notes),
            _paper_note(figures, where) if theirs else "",
        ]
    else:
        html += [f'<p class="left-out">No {escape(over.words)}: no row has a score on each of them.</p>']
    if len(boards) > 1:
        html += [_scene_table(layout, boards, figures, notes)]
    return ['<section class="layout">', *html, "</section>"]


def _over(boards: list[Board]) -> _Over:
    single = len(boards) == 1
    unchanged = {entry.variant for board in boards for entry in board.members if not entry.spec.overrides}
    return _Over(single, boards[0].name if single else f"mean over {len(boards)} scenes", frozenset(unchanged))


def _means(boards: list[Board], columns: Sequence[str]) -> dict[Variant, Line]:
    """A line for each variant: its own on one board, its mean over several."""
    if len(boards) == 1:
        return boards[0].lines
    scenes = [board.name for board in boards]
    found: dict[Variant, dict[str, Line]] = {}
    for board in boards:
        for variant, line in board.lines.items():
            found.setdefault(variant, {})[board.name] = line
    means = {}
    for variant, own in found.items():
        some = next(iter(own.values()))
        cells = {column: scene_mean(own, scenes, column) for column in columns}
        means[variant] = Line(some.method, some.preset, f"{len(own)} of {len(scenes)}", cells)
    return means


def _nothing(boards: list[Board], columns: Sequence[str]) -> Line | None:
    lines = {board.name: board.nothing for board in boards if board.nothing is not None}
    if not lines:
        return None
    some = next(iter(lines.values()))
    cells = {column: scene_mean(lines, [board.name for board in boards], column) for column in columns}
    if not any(cell.value is not None for cell in cells.values()):
        return None
    return Line(some.method, some.preset, "", cells, competes=False)


def _mean_table(
    means: dict[Variant, Line],
    nothing: Line | None,
    columns: Sequence[str],
    over: _Over,
    theirs: dict[str, dict[str, float]],
    figures: Figures,
    caption: str,
    notes: Notes,
) -> str:
    """Rows are methods; the paper's figures, of the methods that it has, come behind ours. They are of the methods as
    they are, so a row with options changed has none."""
    lines = list(means.values())
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    best = best_texts(lines, [column for column in shown if column in COLUMNS]) | dict.fromkeys(
        column for column in shown if column not in COLUMNS
    )
    headings = [
        Th("method", words=True),
        Th("preset", words=True),
        Th("seeds" if over.single else "scenes", words=True),
    ]
    headings += [score_heading(COLUMNS[column], f"measured here, {over.words}") for column in shown]
    paper = [column for column in figures.columns if any(column in row for row in theirs.values())]
    headings += [score_heading(COLUMNS[column], "the paper's, on other data") for column in paper]
    of_it = f"{figures.source} has no such figure of it"
    rows = []
    as_it_is = [line for variant, line in means.items() if variant in over.unchanged]
    for line in [*_sorted(lines, shown), *([nothing] if nothing else [])]:
        printed = theirs.get(_card_name(line.method), {}) if line in as_it_is else {}
        silent = of_it if line in as_it_is or not line.competes else _CHANGED
        rows.append(
            [
                text_cell(line.method),
                text_cell(line.preset),
                text_cell(line.seeds),
                *(
                    score_cell(line.cells[column], COLUMNS[column], best[column] if line.competes else None, notes)
                    for column in shown
                ),
                *(_paper_cell(printed, column, silent, notes) for column in paper),
            ]
        )
    here = {_card_name(line.method) for line in as_it_is}
    for method, printed in theirs.items():
        if method not in here:
            rows.append(
                [
                    text_cell(method),
                    text_cell("the paper's only"),
                    text_cell(""),
                    *(gap_cell("not run here", notes) for _ in shown),
                    *(_paper_cell(printed, column, of_it, notes) for column in paper),
                ]
            )
    return table(headings, rows, caption, left=1) + not_shown(empty)


def _scene_table(layout: Layout, boards: list[Board], figures: Figures, notes: Notes) -> str:
    """The paper's table of scenes: a row for each scene and columns for each method; the other way round where there
    are many methods."""
    variants = list(dict.fromkeys(variant for board in boards for variant in board.lines))
    some = {variant: board.lines[variant] for board in boards for variant in board.lines}
    empty = empty_columns([line for board in boards for line in board.lines.values()], layout.scene_columns)
    shown = [column for column in layout.scene_columns if column not in empty]
    best = {board.name: best_texts(list(board.lines.values()), shown) for board in boards}
    caption = f"{layout.title}: scene by scene"

    def cell(board: Board, variant: Variant, column: str) -> Td:
        if variant not in board.lines:
            return gap_cell(f"not run on {board.name}", notes)
        return score_cell(board.lines[variant].cells[column], COLUMNS[column], best[board.name][column], notes)

    if len(variants) > _SIDEWAYS:
        headings = [Th("method", words=True), Th("preset", words=True)]
        absent = {board.name: empty_columns(list(board.lines.values()), shown) for board in boards}
        kept = [(board, column) for board in boards for column in shown if column not in absent[board.name]]
        headings += [score_heading(COLUMNS[column], board.name) for board, column in kept]
        rows = [
            [
                text_cell(some[variant].method),
                text_cell(some[variant].preset),
                *(cell(board, variant, column) for board, column in kept),
            ]
            for variant in variants
        ]
        missing = "".join(
            not_shown(columns, f"Not shown of {name}, as no row has it") for name, columns in absent.items()
        )
        return table(headings, rows, caption, left=1) + not_shown(empty) + missing

    theirs = {board.name: figures.of_scene(board.scene) for board in boards}
    printed = list(
        dict.fromkeys(
            (method, column)
            for found in theirs.values()
            for method, row in found.items()
            for column in figures.columns
            if column in row and column in shown
        )
    )
    there = [(variant, column) for variant in variants for column in shown if _has(boards, variant, column)]
    headings = [Th("scene", words=True)]
    headings += [score_heading(COLUMNS[column], _name(some[variant])) for variant, column in there]
    headings += [score_heading(COLUMNS[column], f"the paper's {method}, on other data") for method, column in printed]
    silent = f"{figures.source} has no such figure of this scene"
    rows = [
        [
            text_cell(board.name),
            *(cell(board, variant, column) for variant, column in there),
            *(_paper_cell(theirs[board.name].get(method, {}), column, silent, notes) for method, column in printed),
        ]
        for board in boards
    ]
    left_out = {
        variant: {column: some[variant].cells[column].reason for column in shown if (variant, column) not in there}
        for variant in variants
    }
    missing = "".join(
        not_shown(columns, f"Not shown of {_name(some[variant])}, as it has it nowhere")
        for variant, columns in left_out.items()
    )
    return (
        table(headings, rows, caption, left=1)
        + not_shown(empty)
        + missing
        + (_paper_note(figures, figures.data) if printed else "")
    )


def _has(boards: list[Board], variant: Variant, column: str) -> bool:
    """Whether a method has a score, or a failure in its place, on any board."""
    cells = [board.lines[variant].cells[column] for board in boards if variant in board.lines]
    return any(cell.value is not None or cell.failure for cell in cells)


def _name(line: Line) -> str:
    return f"{line.method} {line.preset}".strip()


def _time_sections(boards: Sequence[Board], notes: Notes) -> list[str]:
    """Processing time and frames a second, as the supplement has them; CPU time, cold start and memory beside it."""
    figures = paper_figures()["time"]
    sections = []
    for kind, members in by_kind(boards).items():
        lines = _means(members, COST)
        over = _over(members)
        sections += [
            '<section class="layout">',
            f"<h3>Processing time and frames a second <small>{escape(kind)}</small></h3>",
            "<p>Training is wall time with the clock stopped while scoring. Peak memory is the whole process's.</p>",
            _mean_table(
                lines, None, COST, over, figures.means, figures, f"Processing time, {kind}: {over.words}", notes
            ),
            _paper_note(figures, figures.data),
            "</section>",
        ]
    return sections


def _paper_note(figures: Figures, where: str) -> str:
    source = f"{figures.source}: {where}"
    return f'<p class="paper">The paper\'s columns are of {escape(source)}. Not measured here.</p>'


def _paper_cell(printed: dict[str, float], column: str, silent: str, notes: Notes) -> Td:
    if column not in printed:
        return gap_cell(silent, notes)
    return paper_number(printed[column], COLUMNS[column])


def paper_number(value: float, column: Column) -> Td:
    """A figure of the paper, with the digits that it prints."""
    return number_cell(value, f"{value:.{min(column.digits, _PAPER_DIGITS)}f}", kind="theirs")


def not_shown(empty: dict[str, str], said: str = "Not shown, as no row has it") -> str:
    """Which columns a table has not, as no row has them, and why; empty where it has all."""
    reasons: dict[str, list[str]] = {}
    for column, reason in empty.items():
        if reason:
            reasons.setdefault(" ".join(reason.split()), []).append(COLUMNS[column].label)
    if not reasons:
        return ""
    parts = "; ".join(f"{', '.join(labels)} ({reason})" for reason, labels in reasons.items())
    return f'<p class="left-out">{escape(said)}: {escape(parts)}.</p>'


def _sorted(lines: list[Line], shown: Sequence[str]) -> list[Line]:
    """Best of the first score first; costs by the least."""
    if not shown:
        return lines
    down = bool(COLUMNS[shown[0]].higher_is_better)

    def place(line: Line) -> tuple[bool, float, str, str]:
        value = line.cells[shown[0]].value
        gap = value is None or math.isnan(value)
        return gap, 0.0 if gap else -value if down else value, line.method, line.preset

    return sorted(lines, key=place)


def _card_name(method: str) -> str:
    """What the method's card calls it; its id where it isn't installed here."""
    return find_method(method).card.name if method in method_files() else method
