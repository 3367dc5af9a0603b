"""Pairwise comparison of a board's methods, view by view."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.comparing.design import design_words
from dofbench.evaluation.comparing.pairwise import Pair, pairwise
from dofbench.evaluation.results.collecting import grouped
from dofbench.evaluation.results.columns import COLUMNS, LENS
from dofbench.reporting.boards import Board, Names, Variant, mean_names
from dofbench.reporting.tables import Section, Table, difference, score_headings, word_headings, words

SHOWN = """psnr ssim flip aif_psnr aif_ssim aif_flip photo_psnr photo_ssim photo_blur across_psnr across_blurred_psnr
    delta_a delta_f delta_r disparity_error""".split()
HEADING = "Compared view by view"
TESTED = "How differences are tested"


def mean_pairs(boards: Sequence[Board], against: Collection[str] = ()) -> dict[str, list[Pair]]:
    """Kind -> the pairs of its mean over scenes, where it has several boards."""
    return {
        kind: pairwise([board.variants for board in scenes], against)
        for kind, scenes in grouped(boards, "kind").items()
        if len(scenes) > 1
    }


def pair_sections(
    pairs: Sequence[Pair], names: Names, caption: str, signs: Mapping[Variant, str]
) -> tuple[Section, ...]:
    """The pairs as a table; nothing without a score that both of a pair have. signs: of each variant."""
    columns = [column for column in SHOWN if any(pair.compared[column].difference for pair in pairs)]
    if not columns:
        return ()
    views: dict[str, None] = {}
    for column in columns:
        counts = {found.pairs for pair in pairs if (found := pair.compared[column].difference)}
        kind, plural = "training" if column in LENS else "test", "" if counts == {1} else "s"
        views[f"{' or '.join(map(str, sorted(counts)))} {kind} view{plural}"] = None
    said = [f"Over {' and '.join(views)}; p of {COLUMNS[pairs[0].tested].label}; see *{TESTED}*."]
    if tested := [one for pair in pairs if (one := pair.compared[pair.tested].difference) is not None]:
        scatters = [one.spread for one in tested if one.spread]
        said.append(design_words(max(one.pairs for one in tested), max(one.groups for one in tested), scatters))
    rows = tuple(
        (
            *(words(" ".join(names[side]), signs[side]) for side in (pair.one, pair.other)),
            *(difference(pair.compared[column]) for column in columns),
        )
        for pair in pairs
    )
    headings = (*word_headings("", "minus"), *score_headings(columns))
    table = Table(f"{HEADING}: {caption}", headings, rows, names=2, rest="comparisons.csv")
    return (Section(HEADING, tuple(filter(None, said)), (table,)),)


def comparison_rows(
    boards: Sequence[Board], pairs: Mapping[Variant, Sequence[Pair]], means: Mapping[str, Sequence[Pair]], names: Names
) -> Iterator[dict[str, object]]:
    """One row per pair and score that a run has. pairs: of each board, by its key. means: `mean_pairs`."""
    kinds = grouped(boards, "kind")
    sources = [(board.name, [board], pairs[board.key]) for board in boards]
    sources += [(mean_names(kind, kinds[kind])[1], kinds[kind], own) for kind, own in means.items()]
    for name, compared, own in sources:
        runs = [entry.scores for board in compared for entry in board.members]
        known = [column for column in COLUMNS if any(scores.get(column) is not None for scores in runs)]
        where = {"dataset": name, "protocol": compared[0].protocol, "role": compared[0].role or ROLE_NOT_STATED}
        for pair in own:
            (method, preset), (other, other_preset) = names[pair.one], names[pair.other]
            who = {"method": method, "preset": preset, "against_method": other, "against_preset": other_preset}
            for column, found in pair.compared.items():
                if column in known:
                    numbers = vars(found.difference) if found.difference else {}
                    said = {"column": column, "reason": found.reason, "verdict": found.verdict}
                    yield {**where, **who, **said, **numbers, "difference": numbers.get("mean")}
