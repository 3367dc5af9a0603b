"""The paper's table layouts, filled with scores measured here; the paper's own figures stand apart, as such."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dofbench.evaluation.comparing.means import scene_mean
from dofbench.evaluation.results.collecting import grouped
from dofbench.evaluation.results.columns import COLUMNS, COST, HELD_OUT_SCORES
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting.boards import (
    Board,
    Line,
    Variant,
    best_texts,
    empty_columns,
    mean_lines,
    united,
)
from dofbench.reporting.paper import NOTHING_PRINTED, Figures, paper_figures, ssim_note
from dofbench.reporting.tables import (
    NAMES,
    Cell,
    Extra,
    Section,
    Table,
    cells,
    gap,
    not_shown,
    one_line,
    published,
    score,
    score_headings,
    score_table,
    word_headings,
    words,
)

_CHANGED = "the paper's figures are of the method as it is, not with these options"
_THEIRS = "the paper's, on other data"


@dataclass(frozen=True)
class Layout:
    """One of the paper's tables. sharp: for methods trained on all-in-focus images. columns, scene_columns: scores that
    it and its table of scenes show."""

    id: str
    title: str
    about: str
    sharp: bool
    columns: tuple[str, ...]
    scene_columns: tuple[str, ...]


def _layout(id: str, title: str, about: str, columns: str, scene_columns: str, *, sharp: bool = False) -> Layout:
    return Layout(id, title, about, sharp, tuple(columns.split()), tuple(scene_columns.split()))


LAYOUTS = (
    _layout(
        "synthetic",
        "Refocusing, and the learned lens",
        "Test views rendered through their own lens, against the test image; errors of the learned aperture and focus.",
        "psnr ssim ssim_uniform7 flip delta_a delta_f delta_r",
        "psnr ssim ssim_uniform7 delta_a delta_f delta_r",
    ),
    _layout(
        "main",
        "All-in-focus views from images with defocus",
        "Trained on images with shallow depth of field, rendered all in focus, against the all-in-focus image.",
        "aif_psnr aif_ssim aif_ssim_uniform7 aif_flip",
        "aif_psnr aif_ssim aif_ssim_uniform7",
    ),
    _layout(
        "photographs",
        "Photographs of unknown lens",
        "Held-out photographs, rendered with the learned aperture (methods without one: all in focus), focus and "
        "colours fitted on half of each, scored on the other half.",
        "photo_psnr photo_sharp_psnr photo_fit_psnr photo_ssim photo_sharp_ssim photo_blur photo_sharp_blur",
        "photo_psnr photo_ssim",
    ),
    _layout(
        "across",
        "Photographs of another aperture",
        "Rendered with the learned aperture times the ratio of the f-numbers, with it unchanged, and without any.",
        "across_psnr in_focus_psnr photo_fit_psnr across_ssim "
        "across_blurred_psnr unscaled_blurred_psnr in_focus_blurred_psnr",
        "across_psnr across_blurred_psnr",
    ),
    _layout(
        "all_in_focus",
        "All-in-focus inputs",
        "Trained on the all-in-focus images and rendered all in focus.",
        "aif_psnr aif_ssim aif_ssim_uniform7 aif_flip",
        "aif_psnr aif_ssim aif_ssim_uniform7",
        sharp=True,
    ),
)


def layout_sections(boards: Sequence[Board], *, by_scene: bool = True) -> tuple[Section, ...]:
    """One section for each layout and each kind of board that has scores for it; last, times and frame rates.
    by_scene: whether the scenes of a mean have a table too."""
    sections = []
    for layout in LAYOUTS:
        for kind, members in grouped([board for board in boards if board.sharp is layout.sharp], "kind").items():
            if _shows(layout, members):
                sections.append(_section(layout, kind, members, by_scene))
    return (*sections, *(_time_section(kind, members) for kind, members in grouped(boards, "kind").items()))


def _section(layout: Layout, kind: str, boards: Sequence[Board], by_scene: bool) -> Section:
    figures, over, single = paper_figures().get(layout.id, NOTHING_PRINTED), _over(boards), len(boards) == 1
    lines = _lines(boards, layout.columns)
    of_scene = figures.of_scene(boards[0].scene) if single else {}
    where = f"{boards[0].scene}, {figures.data}" if of_scene else figures.data
    text, tables = [layout.about], []
    if single or any(line.cells[column].value is not None for line in lines.values() for column in layout.columns):
        caption = f"{layout.title}: {over}"
        printed = of_scene or figures.means
        tables.append(_mean_table(boards, lines, layout.columns, printed, figures, where, caption))
    else:
        text.append(f"No {over}: no row has a score on each of them.")
    if by_scene and not single:
        tables.append(_scene_table(layout, boards, figures))
    return Section(f"{layout.title}, {kind}", tuple(text), tuple(tables))


def _time_section(kind: str, boards: Sequence[Board]) -> Section:
    """Training time and frame rate, as in the paper's supplement; also CPU time, start-up and memory."""
    figures, title = paper_figures()["time"], f"Training time and frame rate, {kind}"
    # The first column ranks
    costs = sorted(COST, key=lambda column: column != "train_cpu_s") if boards[0].by_cpu else COST
    columns = (*costs, *HELD_OUT_SCORES)
    caption, lines = f"{title}: {_over(boards)}", _lines(boards, columns)
    table = _mean_table(boards, lines, columns, figures.means, figures, figures.data, caption, nothing=False)
    said = "Training is wall time; the clock is stopped while scoring. Peak memory is the whole process's."
    return Section(title, (said,), (table,))


def _over(boards: Sequence[Board]) -> str:
    return boards[0].name if len(boards) == 1 else f"mean over {len(boards)} scenes"


def _variants(boards: Sequence[Board]) -> list[Variant]:
    return list(dict.fromkeys(variant for board in boards for variant in board.lines))


def _lines(boards: Sequence[Board], columns: Sequence[str]) -> dict[Variant, Line]:
    """A line for each variant: of one board its scores; of several the means, with the number of boards in place of the
    seeds."""
    if len(boards) == 1:
        return boards[0].lines
    counts = {variant: sum(variant in board.lines for board in boards) for variant in _variants(boards)}
    means = mean_lines(boards, columns)
    return {variant: replace(line, seeds=f"{counts[variant]} of {len(boards)}") for variant, line in means.items()}


def _nothing(boards: Sequence[Board], columns: Sequence[str]) -> list[Line]:
    """The line of the predictor that learns nothing, over these boards."""
    lines, scenes = {one.name: one.nothing for one in boards if one.nothing is not None}, [one.name for one in boards]
    found = {column: {name: line.cells[column] for name, line in lines.items()} for column in columns}
    means = {column: scene_mean(own, scenes) for column, own in found.items()}
    return [replace(line, seeds="", cells=means) for line in list(lines.values())[:1]]


def _mean_table(
    boards: Sequence[Board],
    means: Mapping[Variant, Line],
    columns: Sequence[str],
    theirs: Mapping[str, Mapping[str, float]],
    figures: Figures,
    where: str,
    caption: str,
    *,
    nothing: bool = True,
) -> Table:
    """A table whose rows are methods, with the paper's figures behind ours for the methods as they are (changed options
    have none), and rows for the paper's other methods. theirs: method -> score -> figure."""
    lines = list(means.values())
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    paper = [column for column in figures.columns if any(column in row for row in theirs.values())]
    of_it = f"{figures.source} has no such figure of it"
    changed = {entry.variant for board in boards for entry in board.members if entry.changed}
    methods = {line.method: _card_name(line.method) for line in lines}
    here = {methods[line.method] for variant, line in means.items() if variant not in changed}
    changed_lines = {id(line) for variant, line in means.items() if variant in changed}
    silent = {id(line): _silent(line, shown) and methods[line.method] not in theirs for line in lines}
    absent = [line for line in lines if silent[id(line)]]
    present = _sorted([line for line in lines if not silent[id(line)]], shown)

    def printed(row: Mapping[str, float], silent: str) -> list[Cell]:
        return [published(row.get(column), COLUMNS[column], silent) for column in paper]

    def of_line(line: Line) -> list[Cell]:
        if id(line) in changed_lines:
            return printed({}, _CHANGED)
        return printed(theirs.get(methods.get(line.method, ""), {}), of_it)

    more = [
        (*cells(method, "the paper's only", ""), *(gap("not run here") for _ in shown), *printed(row, of_it))
        for method, row in theirs.items()
        if method not in here
    ]
    counted = word_headings("method", "preset", "seeds" if len(boards) == 1 else "scenes")
    return score_table(
        [*present, *(_nothing(boards, columns) if nothing else ())],
        shown,
        caption,
        before=Extra(counted, NAMES.cells),
        after=Extra(score_headings(paper, _THEIRS, published=True), of_line),
        group=f"measured here, {_over(boards)}",
        more=more,
        below=(*not_shown(empty), *_absent(absent, shown), *(_paper_note(figures, where) if theirs else ())),
    )


def _scene_table(layout: Layout, boards: Sequence[Board], figures: Figures) -> Table:
    """The scores scene by scene: a row for each method and columns for each scene; last, the paper's own rows."""
    variants = _variants(boards)
    some = {variant: board.lines[variant] for board in boards for variant in board.lines}
    lines = [line for board in boards for line in board.lines.values()]
    signs = {one: united(board.lines[one].signs for board in boards if one in board.lines) for one in variants}
    theirs = {board.name: figures.of_scene(board.scene) for board in boards}
    everywhere = empty_columns(lines, layout.scene_columns)
    shown = [column for column in layout.scene_columns if column not in everywhere]
    best = {board.name: best_texts(list(board.lines.values()), shown) for board in boards}
    absent = {board.name: empty_columns(list(board.lines.values()), shown) for board in boards}
    kept = [(board, column) for board in boards for column in shown if column not in absent[board.name]]
    silent = {
        one: None for one in variants if all(_silent(board.lines[one], shown) for board in boards if one in board.lines)
    }

    def cell(board: Board, variant: Variant, column: str) -> Cell:
        if variant not in board.lines:
            return gap(f"not run on {board.name}")
        return score(board.lines[variant].cells[column], COLUMNS[column], best[board.name][column])

    def printed(board: Board, method: str, column: str) -> Cell:
        of_it = f"{figures.source} has no such figure of this scene"
        return published(theirs[board.name].get(method, {}).get(column), COLUMNS[column], of_it)

    rows = [
        (
            words(some[one].method, signs[one]),
            words(some[one].preset),
            *(cell(board, one, column) for board, column in kept),
        )
        for one in variants
        if one not in silent
    ]
    methods = dict.fromkeys(method for found in theirs.values() for method in found)
    more = [
        (*cells(method, _THEIRS), *(printed(board, method, column) for board, column in kept)) for method in methods
    ]
    more = [row for row in more if any(one.kind == "published" for one in row)]
    headings = word_headings("method", "preset")
    for board, column in kept:
        headings += score_headings([column], board.name)
    below = [*not_shown(everywhere), *_absent([some[variant] for variant in silent], shown)]
    for name, columns in absent.items():
        below += not_shown(columns, f"Not shown of {name}, as no row has it")
    below += _paper_note(figures, figures.data) if more else ()
    caption = f"{layout.title}: scene by scene"
    return Table(caption, headings, (*rows, *more), below=tuple(below), theirs=len(more), rest="leaderboard.csv")


def _silent(line: Line, shown: Sequence[str]) -> bool:
    """Whether a line has none of these scores, if there are any, and no failure instead of one."""
    return bool(shown) and all(line.cells[column].value is None and not line.cells[column].failure for column in shown)


def _absent(lines: Sequence[Line], shown: Sequence[str]) -> tuple[str, ...]:
    """A line on which rows a table omits, and why; none if it has all."""
    reasons = [f"{line.name} ({one_line(line.cells[shown[0]].reason)})" for line in lines]
    return (f"No row, as they have none of these scores: {'; '.join(reasons)}.",) if reasons else ()


def _shows(layout: Layout, boards: Sequence[Board]) -> bool:
    """Whether any row has a score for it. Failures show where nothing else does: a failed run lacks scores of every
    layout, also of those that its dataset isn't for."""
    cells = [line.cells for board in boards for line in board.lines.values()]
    if any(own[column].value is not None for own in cells for column in layout.columns):
        return True
    scored = any(own[column].value is not None for own in cells for one in LAYOUTS for column in one.columns)
    return not scored and any(own[column].failure for own in cells for column in layout.columns)


def _paper_note(figures: Figures, where: str) -> tuple[str]:
    return (f"The paper's columns are of {figures.source}: {where}. Not measured here.{ssim_note(figures.columns)}",)


def _sorted(lines: list[Line], shown: Sequence[str]) -> list[Line]:
    """The lines sorted by the first column, the best first; a cost is best when it is least."""
    if not shown:
        return lines
    down = bool(COLUMNS[shown[0]].higher_is_better)

    def place(line: Line) -> tuple[bool, float, str, str]:
        value = line.cells[shown[0]].value
        none = value is None or math.isnan(value)
        rank = 0.0 if value is None or none else -value if down else value
        return none, rank, line.method, line.preset

    return sorted(lines, key=place)


def _card_name(method: str) -> str:
    """The method's name by its card; its id if the method isn't installed here."""
    return find_method(method).card.name if method in method_files() else method
