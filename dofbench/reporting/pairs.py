"""Pairwise comparison of a board's methods, view by view."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import ALL_IN_FOCUS, COLUMNS, DEPTH, LENS, PHOTOGRAPH, REFOCUS
from dofbench.evaluation.results.protocol import arithmetic_mean
from dofbench.reporting.boards import Board, Names, Variant, by_kind, mean_names, sign_notes
from dofbench.reporting.statistics import Compared, adjusted, compare
from dofbench.reporting.tables import Section, Table, difference, score_headings, word_headings, words

Seeds = Mapping[Variant, Sequence[Entry]]  # the seeds of each variant on one dataset

SHOWN = """psnr ssim flip aif_psnr aif_ssim aif_flip photo_psnr photo_ssim across_psnr across_blurred_psnr
    delta_a delta_f delta_r disparity_error""".split()
# Up to so many variants every pair is compared; of more, each only with the first and with those of methods that the
# user asks for, to keep the page short
EVERY_PAIR = 8
HEADING = "Compared view by view"
TESTED = "How differences are tested"


@dataclass(frozen=True)
class Pair:
    """Two variants, and their differences by column."""

    one: Variant
    other: Variant
    compared: dict[str, Compared]


def pairwise(datasets: Sequence[Seeds], against: Collection[str] = ()) -> list[Pair]:
    """Compare the variants that every dataset has in every score; p is adjusted over the pairs of a column. against:
    ids of methods that all are compared with."""
    whole = [variant for variant in _ranked(datasets) if all(variant in seeds for seeds in datasets)]
    pairs = list(itertools.combinations(whole, 2))
    if len(whole) > EVERY_PAIR:
        rivals = {variant for variant in whole if datasets[0][variant][0].spec.method in against} | {whole[0]}
        pairs = [pair for pair in pairs if rivals & set(pair)]
    found: list[dict[str, Compared]] = [{} for _ in pairs]
    for column in (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH, *LENS, *DEPTH):
        raw = [compare([(seeds[one], seeds[other]) for seeds in datasets], column) for one, other in pairs]
        for compared, one in zip(found, adjusted(raw), strict=True):
            compared[column] = one
    return [Pair(*pair, compared) for pair, compared in zip(pairs, found, strict=True)]


def with_the_best(pairs: Sequence[Pair], variants: int) -> Sequence[Pair]:
    """Of the pairs of many variants, those with the best: what a page shows of one scene among several."""
    return [pair for pair in pairs if variants <= EVERY_PAIR or pair.one == pairs[0].one]


def mean_pairs(boards: Sequence[Board], against: Collection[str] = ()) -> dict[str, list[Pair]]:
    """Kind -> the pairs of its mean over scenes, where it has several boards."""
    return {
        kind: pairwise([board.variants for board in scenes], against)
        for kind, scenes in by_kind(boards).items()
        if len(scenes) > 1
    }


def _ranked(datasets: Sequence[Seeds]) -> list[Variant]:
    """The variants in the order of table lines: best refocus PSNR first, then by all-in-focus PSNR."""

    def place(variant: Variant) -> tuple[Any, ...]:
        means = []
        for column in ("psnr", "aif_psnr", "photo_psnr", "across_psnr"):
            values = [entry.scores.get(column) for seeds in datasets for entry in seeds.get(variant, [])]
            known = [value for value in values if value is not None and not math.isnan(value)]
            means += [not known, -arithmetic_mean(known) if known else 0.0]
        return (*means, variant)

    return sorted({variant for seeds in datasets for variant in seeds}, key=place)


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
    rows = tuple(
        (
            *(words(" ".join(names[side]), signs[side]) for side in (pair.one, pair.other)),
            *(difference(pair.compared[column]) for column in columns),
        )
        for pair in pairs
    )
    below = sign_notes(signs[side] for pair in pairs for side in (pair.one, pair.other))
    headings = (*word_headings("", "minus"), *score_headings(columns))
    table = Table(f"{HEADING}: {caption}", headings, rows, names=2, below=below)
    return (Section(HEADING, (f"Over {' and '.join(views)}; see *{TESTED}*.",), (table,)),)


def comparison_rows(
    boards: Sequence[Board], pairs: Mapping[Variant, Sequence[Pair]], means: Mapping[str, Sequence[Pair]], names: Names
) -> Iterator[dict[str, object]]:
    """One row per pair and score that a run has. pairs: of each board, by its key. means: `mean_pairs`."""
    kinds = by_kind(boards)
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
