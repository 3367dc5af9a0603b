"""Sections of a report: boards, means over scenes, held-out focus, published figures, how each run was made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from dofbench.core.errors import Status
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.datasets.format.points_record import points_in_words
from dofbench.evaluation.comparing.means import mean_and_spread
from dofbench.evaluation.comparing.pairwise import Pair
from dofbench.evaluation.comparing.score_curves import UNEVEN
from dofbench.evaluation.results.collecting import Entry, grouped
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import AIF_PREFIX, arithmetic_mean
from dofbench.evaluation.results.result import Result
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting.boards import Board, Line, Names, mean_lines, sorted_lines
from dofbench.reporting.pairs import pair_sections
from dofbench.reporting.paper import ssim_note
from dofbench.reporting.tables import (
    Cell,
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

_UNKNOWN = "unknown"
ASKED_HEADING = "Held-out focus, by the test views' lens"
_ASKED_COLUMNS = ("psnr", "ssim", "flip")  # metrics that all-in-focus renderings have too


def board_section(board: Board, columns: Sequence[str], names: Names, pairs: Sequence[Pair]) -> Section:
    """One board: its scores, the comparison of its rows, and where focus was held out, scores by the test views'
    lens."""
    lines = sorted_lines([*board.lines.values(), *([board.nothing] if board.nothing is not None else [])])
    trained = "trained on all-in-focus images" if board.sharp else board.lenses
    photographed = () if board.sharp else (PHOTOGRAPHER_SAYS[board.photographer],)
    about = f"Scene {board.scene}; dataset checksum {board.key[1][:16]}{f'; {trained}' if board.lenses else ''}."
    scores = score_table(lines, columns, board.title)
    scores = replace(scores, below=(*scores.below, points_in_words(board.points)))
    signs = {variant: line.signs for variant, line in board.lines.items()}
    groups = [(board.lines[variant], seeds) for variant, seeds in board.variants.items()]
    about += UNEVEN if board.by_cpu else ""
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
    for kind, scenes in grouped(boards, "kind").items():
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
    """Which scores were computed after their runs, and by which code and weights."""
    by_code: dict[str, dict[str, None]] = {}
    for entry in entries:
        for column, score in (entry.added.scores if entry.added else {}).items():
            made_by = f"by code {score.code}" + (f", weights of sha256 {score.weights}" if score.weights else "")
            by_code.setdefault(made_by, {})[column] = None
    items = tuple(f"{', '.join(columns)}: {made_by}." for made_by, columns in by_code.items())
    said = "Computed by `dofbench score` from the kept renderings and models."
    return Section("Added after the runs", (said,), items=items) if items else None


def column_section(columns: Sequence[str]) -> Section:
    """An explanation of each score."""
    known = [COLUMNS[column] for column in columns]
    return Section("Scores", items=tuple(f"{one.label} ({one.id}): {one.note}." for one in known))


# ---- how it was made ----


def run_table(entries: Sequence[Entry], boards: Sequence[Board]) -> tuple[Table, tuple[str, ...]]:
    """(table of command, code and machine of every run; the machines by their number in the table)."""
    machines: dict[str, int] = {}
    rows, by_key = [], {board.key: board for board in boards}
    for entry in entries:
        result, code = entry.result, (entry.spec.key[:8], entry.spec.code.rpartition("+")[2][:8])
        how: tuple[str | Cell, ...] = (_UNKNOWN, _UNKNOWN, *code, _UNKNOWN, _UNKNOWN, "", "")
        if result is not None:
            machine = machines.setdefault(machine_text(result), len(machines) + 1)
            disabled = [f"{stage}: {why}" for stage, why in result.left_out_stages.items()]
            enabled = [f"{one['name']}: {one['reason']}" for one in result.plan.get("stages", ()) if one["runs"]]
            command = Cell("", sort=result.command, code=(result.command,))
            made = result.started[:16].replace("T", " "), command, *code, commit_text(result), str(machine)
            how = (*made, "; ".join(disabled), "; ".join(enabled))
        rows.append(cells(*_names(entry, by_key[entry.board]), str(entry.status), entry.spec.budget, *how))
    headings = (
        *word_headings("dataset", "method", "preset", "seed", "status", "budget"),
        *word_headings("started (UTC)", wide=True),
        *word_headings("command", "key", "code", "commit", "machine"),
        *word_headings("disabled stages", "enabled stages, and why", wide=True),
    )
    listed = tuple(f"Machine {count}: {described}" for described, count in machines.items())
    return Table("How each run was made", headings, tuple(rows), rest="runs.csv"), listed


def machine_lines(entries: Sequence[Entry]) -> tuple[str, ...]:
    """The machines of these runs."""
    found = dict.fromkeys(machine_text(entry.result) for entry in entries if entry.result is not None)
    return tuple(f"Machine: {described}" for described in found)


def stage_table(entries: Sequence[Entry], boards: Sequence[Board]) -> Table:
    """The time of each run by stage."""
    timed = [(entry, entry.result) for entry in entries if entry.result is not None]
    stages = list(dict.fromkeys(stage for _, result in timed for stage in result.stages))
    own = list(dict.fromkeys(stage for _, result in timed for stage in result.method_stages))
    headings = (
        *word_headings("dataset", "method", "preset", "seed"),
        *(Heading(f"{stage} [s]", "harness") for stage in stages),
        *(Heading(f"{stage} [s]", "within training") for stage in own),
    )
    rows, by_key = [], {board.key: board for board in boards}
    for entry, result in timed:
        times = [result.stages[stage].wall if stage in result.stages else None for stage in stages]
        times += [result.method_stages.get(stage) for stage in own]
        shown = (Cell("not run", "number") if time is None else Cell(f"{time:.2f}", "number", time) for time in times)
        rows.append((*_names(entry, by_key[entry.board]), *shown))
    caption = "Wall seconds of the harness's stages, and of the method's own within training"
    return Table(caption, headings, tuple(rows), rest="times.csv")


def _names(entry: Entry, board: Board) -> tuple[Cell, ...]:
    line, seed = board.lines[entry.variant], Cell(str(entry.spec.seed), sort=float(entry.spec.seed))
    return cells(board.name, words(line.method, line.signs), line.preset, seed)


def commit_text(result: Result) -> str:
    """The commit that a run was made with."""
    git = result.git
    return "no checkout" if git is None else git.commit[:12] + (" + changes" if git.dirty else "")


def machine_text(result: Result) -> str:
    """The machine that a run was made on."""
    facts = result.machine
    threads = f" ({facts['threads']} used)" if "threads" in facts else ""
    accelerator = [str(facts["accelerator"])] if "accelerator" in facts else []
    cpu = f"{facts['cpu']}, {facts['cores']} cores{threads}, {facts['memory_gib']} GiB"
    return ", ".join([cpu, str(facts["os"]), f"Python {facts['python']}", *accelerator])
