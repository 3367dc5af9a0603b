"""The paper's table layouts, filled with scores measured here; the paper's figures are in separate columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from dofbench.evaluation.results.columns import COLUMNS, COST
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting import standing, table_cells
from dofbench.reporting.boards import Board, Variant, by_kind, mean_lines
from dofbench.reporting.footnotes import one_line
from dofbench.reporting.paper import NOTHING_PRINTED, OF_THEIR_SSIM, Figures, names_their_ssim, paper_figures
from dofbench.reporting.score_table import not_shown
from dofbench.reporting.summary import Line, best_texts, empty_columns, scene_mean
from dofbench.reporting.view import Cell, Heading, Paragraph, Section, Table

_CHANGED = "the paper's figures are of the method as it is, not with these options"
_HERE, _THEIRS = "measured here", "the paper's, on other data"  # group headings of the columns
_SIDEWAYS = 6  # number of methods above which the table of scenes has a row instead of columns for each method


@dataclass(frozen=True)
class Layout:
    """One of the paper's tables. sharp: for methods trained on sharp photographs. columns: scores that it shows.
    scene_columns: scores that its table of scenes shows."""

    id: str
    title: str
    about: str
    sharp: bool
    columns: tuple[str, ...]
    scene_columns: tuple[str, ...]


@dataclass(frozen=True)
class _Over:
    """What the cells of a table average over: the seeds of a single board, or several boards. unchanged: variants in
    which the user changed no option."""

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
        ("psnr", "ssim", "ssim_uniform7", "flip", "delta_a", "delta_f", "delta_r"),
        ("psnr", "ssim", "ssim_uniform7", "delta_a", "delta_f", "delta_r"),
    ),
    Layout(
        "main",
        "Sharp views from shallow photographs",
        "Trained on photographs with shallow depth of field, rendered all in focus, against the sharp original.",
        False,
        ("aif_psnr", "aif_ssim", "aif_ssim_uniform7", "aif_flip"),
        ("aif_psnr", "aif_ssim", "aif_ssim_uniform7"),
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
        ("aif_psnr", "aif_ssim", "aif_ssim_uniform7", "aif_flip"),
        ("aif_psnr", "aif_ssim", "aif_ssim_uniform7"),
    ),
)


def layout_sections(boards: Sequence[Board]) -> tuple[Section, ...]:
    """One section for each layout and each kind of board that has scores for it."""
    sections = []
    for layout in LAYOUTS:
        for kind, members in by_kind([board for board in boards if board.sharp is layout.sharp]).items():
            if any(_has(members, variant, column) for variant in _variants(members) for column in layout.columns):
                sections.append(_section(layout, kind, members))
    return (*sections, *(_time_section(kind, members) for kind, members in by_kind(boards).items()))


def _section(layout: Layout, kind: str, boards: list[Board]) -> Section:
    over, figures = _over(boards), paper_figures().get(layout.id, NOTHING_PRINTED)
    lines = _lines(boards, layout.columns)
    single = figures.of_scene(boards[0].scene) if over.single else {}
    theirs = single or figures.means
    where = f"{boards[0].scene}, {figures.data}" if single else figures.data
    blocks: list[Paragraph | Table] = [Paragraph(layout.about)]
    has_mean = any(line.cells[column].value is not None for line in lines.values() for column in layout.columns)
    if has_mean or over.single:
        caption = f"{layout.title}: {over.words}"
        nothing = _nothing(boards, layout.columns)
        blocks.append(_mean_table(lines, nothing, layout.columns, over, theirs, figures, where, caption))
    else:
        blocks.append(Paragraph(f"No {over.words}: no row has a score on each of them."))
    if not over.single:
        blocks.append(_scene_table(layout, boards, figures))
    return Section(f"{layout.title}, {kind}", tuple(blocks))


def _time_section(kind: str, boards: list[Board]) -> Section:
    """Processing time and frames per second, as in the paper's supplement; also CPU time, cold start and memory."""
    figures, over = paper_figures()["time"], _over(boards)
    said = "Training is wall time with the clock stopped while scoring. Peak memory is the whole process's."
    caption = f"Processing time, {kind}: {over.words}"
    lines = _lines(boards, COST)
    table = _mean_table(lines, None, COST, over, figures.means, figures, figures.data, caption)
    return Section(f"Processing time and frames a second, {kind}", (Paragraph(said), table))


def _over(boards: list[Board]) -> _Over:
    single = len(boards) == 1
    unchanged = {entry.variant for board in boards for entry in board.members if not entry.spec.overrides}
    return _Over(single, boards[0].name if single else f"mean over {len(boards)} scenes", frozenset(unchanged))


def _variants(boards: Sequence[Board]) -> list[Variant]:
    return list(dict.fromkeys(variant for board in boards for variant in board.lines))


def _lines(boards: list[Board], columns: Sequence[str]) -> dict[Variant, Line]:
    """A line for each variant: for one board its scores; for several boards the means, with the number of boards that
    it was run on."""
    if len(boards) == 1:
        return boards[0].lines
    counts = {variant: sum(variant in board.lines for board in boards) for variant in _variants(boards)}
    return {
        variant: replace(line, seeds=f"{counts[variant]} of {len(boards)}")
        for variant, line in mean_lines(boards, columns).items()
    }


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
    where: str,
    caption: str,
) -> Table:
    """A table whose rows are methods. The paper's figures stand behind ours, for the methods that the paper has; rows
    with changed options have none, because the paper's figures are for the unchanged methods."""
    lines = list(means.values())
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    best = best_texts(lines, shown)
    paper = [column for column in figures.columns if any(column in row for row in theirs.values())]
    headings = (
        *table_cells.word_headings("method", "preset", "seeds" if over.single else "scenes"),
        *(table_cells.score_heading(COLUMNS[column], f"{_HERE}, {over.words}") for column in shown),
        *(table_cells.score_heading(COLUMNS[column], _THEIRS, published=True) for column in paper),
    )
    of_it = f"{figures.source} has no such figure of it"

    def names(*texts: str) -> list[Cell]:
        return [table_cells.words(text) for text in texts]

    def printed(row: dict[str, float], silent: str) -> list[Cell]:
        return [table_cells.published(row.get(column), COLUMNS[column], silent) for column in paper]

    rows = []
    as_it_is = [line for variant, line in means.items() if variant in over.unchanged]
    absent = [line for line in lines if _silent(line, shown) and _card_name(line.method) not in theirs]
    present = [line for line in lines if line not in absent]
    for line in [*_sorted(present, shown), *([nothing] if nothing else [])]:
        own = theirs.get(_card_name(line.method), {}) if line in as_it_is else {}
        silent = of_it if line in as_it_is or not line.competes else _CHANGED
        scores = [
            table_cells.score(line.cells[column], COLUMNS[column], best[column] if line.competes else None)
            for column in shown
        ]
        who = (table_cells.words(line.method, line.signs), *names(line.preset, line.seeds))
        rows.append((*who, *scores, *printed(own, silent)))
    here = {_card_name(line.method) for line in as_it_is}
    rows += [
        (
            *names(method, "the paper's only", ""),
            *(table_cells.gap("not run here") for _ in shown),
            *printed(row, of_it),
        )
        for method, row in theirs.items()
        if method not in here
    ]
    signs = standing.notes(line.signs for line in present)
    below = (*not_shown(empty), *_absent(absent, shown), *((_paper_note(figures, where),) if theirs else ()), *signs)
    return Table(caption, headings, tuple(rows), below=below)


def _scene_table(layout: Layout, boards: list[Board], figures: Figures) -> Table:
    """The paper's table of scenes: a row for each scene and columns for each method; with many methods, rows and
    columns are exchanged."""
    variants = _variants(boards)
    empty = empty_columns([line for board in boards for line in board.lines.values()], layout.scene_columns)
    shown = [column for column in layout.scene_columns if column not in empty]
    best = {board.name: best_texts(list(board.lines.values()), shown) for board in boards}
    caption = f"{layout.title}: scene by scene"

    def cell(board: Board, variant: Variant, column: str) -> Cell:
        if variant not in board.lines:
            return table_cells.gap(f"not run on {board.name}")
        return table_cells.score(board.lines[variant].cells[column], COLUMNS[column], best[board.name][column])

    if len(variants) > _SIDEWAYS:
        return _methods_by_scene(caption, boards, variants, shown, cell, not_shown(empty))
    return _scenes_by_method(caption, boards, variants, shown, cell, not_shown(empty), figures)


def _methods_by_scene(
    caption: str,
    boards: list[Board],
    variants: list[Variant],
    shown: list[str],
    cell: Callable[[Board, Variant, str], Cell],
    below: tuple[str, ...],
) -> Table:
    """A table with a row for each method and columns for each scene."""
    some = {variant: board.lines[variant] for board in boards for variant in board.lines}
    absent = {board.name: empty_columns(list(board.lines.values()), shown) for board in boards}
    kept = [(board, column) for board in boards for column in shown if column not in absent[board.name]]
    silent = {
        variant: some[variant]
        for variant in variants
        if all(_silent(board.lines[variant], shown) for board in boards if variant in board.lines)
    }
    headings = (
        *table_cells.word_headings("method", "preset"),
        *(table_cells.score_heading(COLUMNS[column], board.name) for board, column in kept),
    )
    rows = tuple(
        (
            table_cells.words(some[variant].method, _signs(boards, variant)),
            table_cells.words(some[variant].preset),
            *(cell(board, variant, column) for board, column in kept),
        )
        for variant in variants
        if variant not in silent
    )
    below += _absent(list(silent.values()), shown)
    for name, columns in absent.items():
        below += not_shown(columns, f"Not shown of {name}, as no row has it")
    return Table(caption, headings, rows, below=(*below, *_sign_notes(boards)))


def _scenes_by_method(
    caption: str,
    boards: list[Board],
    variants: list[Variant],
    shown: list[str],
    cell: Callable[[Board, Variant, str], Cell],
    below: tuple[str, ...],
    figures: Figures,
) -> Table:
    """A table with a row for each scene and columns for each method: those measured here, then the paper's."""
    some = {variant: board.lines[variant] for board in boards for variant in board.lines}
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
    headings: tuple[Heading, ...] = (
        *table_cells.word_headings("scene"),
        *(
            table_cells.score_heading(COLUMNS[column], table_cells.signed(some[variant].name, _signs(boards, variant)))
            for variant, column in there
        ),
        *(
            table_cells.score_heading(COLUMNS[column], f"the paper's {method}, on other data", published=True)
            for method, column in printed
        ),
    )
    silent = f"{figures.source} has no such figure of this scene"
    rows = tuple(
        (
            table_cells.words(board.name, standing.united(line.signs for line in board.lines.values())),
            *(cell(board, variant, column) for variant, column in there),
            *(
                table_cells.published(theirs[board.name].get(method, {}).get(column), COLUMNS[column], silent)
                for method, column in printed
            ),
        )
        for board in boards
    )
    for variant in variants:
        left_out = {column: some[variant].cells[column].reason for column in shown if (variant, column) not in there}
        below += not_shown(left_out, f"Not shown of {some[variant].name}, as it has it nowhere")
    if printed:
        below += (_paper_note(figures, figures.data),)
    return Table(caption, headings, rows, below=(*below, *_sign_notes(boards)))


def _silent(line: Line, shown: Sequence[str]) -> bool:
    """Whether a line has none of these scores, if there are any, and no failure instead of one."""
    return bool(shown) and all(line.cells[column].value is None and not line.cells[column].failure for column in shown)


def _absent(lines: Sequence[Line], shown: Sequence[str]) -> tuple[str, ...]:
    """A line on which rows a table leaves out, and why; none if it has all."""
    reasons = [f"{line.name} ({one_line(line.cells[shown[0]].reason)})" for line in lines]
    return (f"No row, as they have none of these scores: {'; '.join(reasons)}.",) if reasons else ()


def _signs(boards: list[Board], variant: Variant) -> str:
    """The signs of a variant on any of the boards."""
    return standing.united(board.lines[variant].signs for board in boards if variant in board.lines)


def _sign_notes(boards: list[Board]) -> tuple[str, ...]:
    return standing.notes(line.signs for board in boards for line in board.lines.values())


def _has(boards: list[Board], variant: Variant, column: str) -> bool:
    """Whether a method has a score, or a failure instead of one, on any board."""
    cells = [board.lines[variant].cells[column] for board in boards if variant in board.lines]
    return any(cell.value is not None or cell.failure for cell in cells)


def _paper_note(figures: Figures, where: str) -> str:
    of_ssim = f" {OF_THEIR_SSIM}" if names_their_ssim(figures.columns) else ""
    return f"The paper's columns are of {figures.source}: {where}. Not measured here.{of_ssim}"


def _sorted(lines: list[Line], shown: Sequence[str]) -> list[Line]:
    """The lines sorted by the first column, the best first; a cost is best when it is least."""
    if not shown:
        return lines
    down = bool(COLUMNS[shown[0]].higher_is_better)

    def place(line: Line) -> tuple[bool, float, str, str]:
        value = line.cells[shown[0]].value
        if value is None or math.isnan(value):
            return True, 0.0, line.method, line.preset
        return False, -value if down else value, line.method, line.preset

    return sorted(lines, key=place)


def _card_name(method: str) -> str:
    """The method's name by its card; its id if the method isn't installed here."""
    return find_method(method).card.name if method in method_files() else method
