"""The report's first screen: what was run, the best over scenes and on each dataset, its lead and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from dofbench.core.errors import Status
from dofbench.datasets.format.points_record import points_in_words
from dofbench.evaluation.comparing.design import undecided
from dofbench.evaluation.comparing.paired import Side, compare
from dofbench.evaluation.comparing.pairwise import Pair
from dofbench.evaluation.comparing.photograph_notes import no_ranking
from dofbench.evaluation.results.collecting import Collection, Entry, grouped
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting.boards import Board, Line, Variant, mean_lines, united
from dofbench.reporting.sections import commit_text, machine_text
from dofbench.reporting.tables import Cell, Heading, Table, cells, difference, number, score, word_headings, words

# What a row can be the best at, ranked by the first column that a row has: refocusing, all-in-focus views, and
# photographs of unknown lens or of another aperture.
HEADLINES = (("psnr",), ("aif_psnr",), ("photo_psnr", "across_psnr"))
_SCORED_ON = {"psnr": "refocused", "aif_psnr": "all in focus"}
_PHOTOGRAPHS = "of photographs, fitted on half of each"
_COSTS = {"train_s": "s of training", "render_fps": "frames/s"}


@dataclass(frozen=True)
class Verdict:
    """The best variant by the mean of `column`. second: None if there is only one; ahead: their difference. sure: a
    cell of kind sure or unsure if the pair was tested in this column, else untested."""

    column: str
    best: Variant
    second: Variant | None
    ahead: float
    sure: Cell


def verdicts(
    lines: Mapping[Variant, Line], boards: Sequence[Mapping[Variant, Side]], pairs: Sequence[Pair]
) -> Iterator[Verdict]:
    """The verdict on each of `HEADLINES` that a row has a score of. lines: of one board, or means over several. boards:
    the runs of each board's variants. pairs: these variants compared, whose p is the only one of a pair."""
    for columns in HEADLINES:
        for column in columns:
            known = {variant: line.cells[column].value for variant, line in lines.items() if column in line.cells}
            scored = [(-value, variant) for variant, value in known.items() if value is not None]
            ranked = sorted(one for one in scored if not math.isnan(one[0]))
            if len(ranked) == 1:
                yield Verdict(column, ranked[0][1], None, 0.0, Cell("nothing to compare it with", "untested"))
            elif ranked:
                (first, best), (second, other) = ranked[:2]
                sides = [(runs.get(best, ()), runs.get(other, ())) for runs in boards]
                p = next((one.p(column) for one in pairs if {one.one, one.other} == {best, other}), None)
                yield Verdict(column, best, other, second - first, _sure(column, sides, p))
            if ranked:
                break


def _sure(column: str, sides: Sequence[tuple[Side, Side]], p: float | None) -> Cell:
    """How sure a lead is: the difference over the test views of both variants. p: of the pair, None if it wasn't tested
    in this column."""
    compared = compare(sides, column, test=False)
    found = compared.difference
    if found is None:
        return Cell(f"not tested: {compared.reason}", "untested")
    compared = replace(compared, difference=replace(found, p=p))
    seeds = f"{found.seeds} seeds" if found.seeds > 1 else "one seed: the spread over seeds is unknown"
    shown, scenes = difference(compared), f" of {found.groups} scenes" if found.groups > 1 else ""
    cell = replace(shown, text=f"over {found.pairs} test views{scenes}, {seeds}; {shown.text}", sort=None)
    if shown.test is not None and shown.test.verdict == "better":
        return replace(cell, kind="sure")
    if p is not None:
        return replace(cell, kind="unsure", below="not significant")
    if found.above == found.below == 0:
        return replace(cell, kind="untested", below="nothing differs")
    return replace(cell, kind="untested", below=undecided(found.pairs, found.groups) or "not tested in this score")


def best_table(
    boards: Sequence[Board], pairs: Mapping[Variant, Sequence[Pair]], of_means: Mapping[str, Sequence[Pair]]
) -> Table:
    """The best row of the means over each kind's boards, and of every board. pairs, of_means: as in `build_view`."""
    rows = (*_of_means(boards, of_means), *_of_boards(boards, pairs))
    return _table("The best over scenes and of each dataset, by PSNR", rows)


def mean_table(boards: Sequence[Board], of_means: Mapping[str, Sequence[Pair]]) -> Table:
    """The best row of the means over each kind's boards."""
    return _table("The best over scenes, by PSNR", tuple(_of_means(boards, of_means)))


def scene_table(
    boards: Sequence[Board], pairs: Mapping[Variant, Sequence[Pair]], links: Mapping[Variant, str]
) -> Table:
    """The best row of every board, whose name leads to its pages. links: board -> their folder."""
    return _table("The best of each dataset, by PSNR", tuple(_of_boards(boards, pairs, links)))


def _of_means(boards: Sequence[Board], of_means: Mapping[str, Sequence[Pair]]) -> Iterator[tuple[Cell, ...]]:
    for kind, scenes in grouped(boards, "kind").items():
        if len(scenes) > 1:
            means = mean_lines(scenes, [*(column for columns in HEADLINES for column in columns), *_COSTS])
            runs = [board.variants for board in scenes]
            yield from _rows(f"mean over {len(scenes)} scenes", kind, means, runs, of_means[kind])


def _of_boards(
    boards: Sequence[Board], pairs: Mapping[Variant, Sequence[Pair]], links: Mapping[Variant, str] = {}
) -> Iterator[tuple[Cell, ...]]:
    for board in boards:
        signs = united(line.signs for line in board.lines.values())
        nobody = cells(words(board.name, signs), board.kind, "none: every run failed, or none has a score")
        own = _rows(board.name, board.kind, board.lines, [board.variants], pairs[board.key])
        for first, *others in own or [(*nobody, *(Cell(""),) * 5)]:
            yield (replace(first, link=links.get(board.key, "")), *others)


def _table(caption: str, rows: tuple[tuple[Cell, ...], ...]) -> Table:
    headings = (
        *word_headings("dataset", "protocol", "best"),
        Heading("PSNR", note="refocused, all in focus, or of photographs", largest_first=True),
        *word_headings("ahead of"),
        Heading("by", largest_first=True),
        *word_headings("how sure", "at what cost"),
    )
    return Table(caption, headings, rows, rest="leaderboard.csv")


def _rows(
    name: str,
    kind: str,
    lines: Mapping[Variant, Line],
    boards: Sequence[Mapping[Variant, Side]],
    pairs: Sequence[Pair],
) -> list[tuple[Cell, ...]]:
    """A row for everything that one can be the best at."""
    rows: list[tuple[Cell, ...]] = []
    for found in verdicts(lines, boards, pairs):
        column, first = COLUMNS[found.column], lines[found.best]
        psnr = replace(score(first.cells[found.column], column), unit="dB")
        ssim = first.cells.get(column.id.replace("psnr", "ssim"))
        below = _SCORED_ON.get(column.id) or _PHOTOGRAPHS + (f"; SSIM {ssim.value:.3f}" if ssim and ssim.value else "")
        costs = [(column, text, first.cells[column].value) for column, text in _COSTS.items()]
        rival, ahead = Cell(""), Cell("")
        if found.second is not None:
            rival = words(lines[found.second].name, lines[found.second].signs)
            ahead = number(found.ahead, f"+{column.text(found.ahead)} {column.unit}".strip())
        rows.append(
            (
                words(name, united(line.signs for line in lines.values())),
                words(kind),
                replace(words(first.name, first.signs), sort=first.name, best=True),
                replace(psnr, below=below),
                rival,
                ahead,
                found.sure,
                words(", ".join(f"{COLUMNS[one].text(cost)} {text}" for one, text, cost in costs if cost is not None)),
            )
        )
    return rows


def headline(collection: Collection) -> str:
    """A summary of the page in one line."""
    entries = collection.entries
    methods, datasets = {entry.spec.method for entry in entries}, {entry.board[:2] for entry in entries}
    counts = (_count(len(entries), "run"), _count(len(methods), "method"), _count(len(datasets), "dataset"))
    days = sorted({entry.result.ended[:10] for entry in entries if entry.result})
    dates = list(dict.fromkeys((days[0], days[-1]))) if days else []
    return " · ".join(filter(None, (*counts, f"{duration(_trained(entries))} of training", " to ".join(dates))))


def facts(
    collection: Collection, boards: Sequence[Board], most: int | None = None
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """(term, lines) on what was run, on which datasets, how long it took, and what failed; terms without lines are
    omitted. most: lines of a term, None for all."""
    entries, points = collection.entries, dict[str, list[str]]()
    for board in boards:
        points.setdefault(points_in_words(board.points), []).append(board.name)
    results = [entry.result for entry in entries if entry.result]
    failed = [
        f"{entry.spec.method} {entry.preset} on {entry.spec.dataset}, seed {entry.spec.seed}: {entry.status}: "
        f"{entry.message}"
        for entry in entries
        if entry.status is not Status.OK
    ]
    uncounted = [
        *(f"{folder}: a run is at work there" for folder in collection.running),
        *(f"{folder}: a copy of another result" for folder in collection.doubles),
        *(f"unreadable: {problem}" for problem in collection.unreadable),
    ]
    found = {
        "Methods": [_method_words(method, entries) for method in sorted({entry.spec.method for entry in entries})],
        "Datasets": list(map(_board_words, boards)),
        "Points and poses": [f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in points.items()],
        "Time": [_time_words(entries)],
        "Seeds": [_seed_words(boards)],
        "Failed": failed or ["nothing"],
        "Not counted": uncounted,
        "Machine": list(dict.fromkeys(map(machine_text, results))),
        "Code": list(dict.fromkeys(f"commit {commit_text(result)}" for result in results)),
    }
    return tuple((term, _first(lines, most)) for term, lines in found.items() if lines)


def _first(lines: Sequence[str], most: int | None) -> tuple[str, ...]:
    """At most so many lines, the last of which counts the others."""
    if most is None or len(lines) <= most:
        return tuple(lines)
    return (*lines[: most - 1], f"and {len(lines) - most + 1} more: runs.csv has every run")


def _method_words(method: str, entries: Sequence[Entry]) -> str:
    presets = list(dict.fromkeys(entry.preset for entry in entries if entry.spec.method == method))
    shown = ", ".join(presets[:4]) + (f" and {len(presets) - 4} more" if len(presets) > 4 else "")
    about = f": {find_method(method).card.summary}" if method in method_files() else ""
    return f"{method} ({_count(len(presets), 'preset')}: {shown}){about}"


def _board_words(board: Board) -> str:
    plan = next((entry.result.plan for entry in board.members if entry.result), None)
    views = f"{plan['train_views']} training and {plan['test_views']} test views" if plan else "unknown views"
    lenses = f" of {board.lenses.removeprefix('trained on ')}" if board.lenses else ""
    trained = "all-in-focus images" if board.sharp else f"images with defocus{lenses}"
    ranking = f". {said}" if (said := no_ranking(board.members)) else ""
    return f"{board.name} ({board.scene}): {views}; {board.kind}, trained on {trained}{ranking}"


def _time_words(entries: Sequence[Entry]) -> str:
    stages = [(stage, time) for entry in entries if entry.result for stage, time in entry.result.stages.items()]
    whole = sum(time.wall for _, time in stages)
    cpu = sum(time.cpu for stage, time in stages if stage == "train")
    cold = sum(time.wall for stage, time in stages if stage in ("import", "warm up"))
    return (
        f"training {duration(_trained(entries))} wall, {duration(cpu)} CPU; imports and JIT compilation "
        f"{duration(cold)}; everything with scoring {duration(whole)}"
    )


def _trained(entries: Sequence[Entry]) -> float:
    return sum(entry.scores.get("train_s", 0.0) for entry in entries)


def _seed_words(boards: Sequence[Board]) -> str:
    counts = sorted({len(seeds) for board in boards for seeds in board.variants.values()})
    if counts == [1]:
        return "one per row: the spread is unknown, so small differences mean nothing"
    span = " to ".join(map(str, dict.fromkeys((counts[0], counts[-1]))))
    return f"{span} per row; cells are mean ± sample standard deviation over them"


def duration(seconds: float) -> str:
    """A duration such as "2 h 05 min", "12 min" or "48 s"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
