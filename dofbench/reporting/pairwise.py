"""Pairwise comparison of a board's methods: differences and their significance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.results.collecting import Entry, grouped
from dofbench.evaluation.results.columns import ALL_IN_FOCUS, COLUMNS, DEPTH, LENS, PHOTOGRAPH, REFOCUS
from dofbench.evaluation.results.protocol import arithmetic_mean
from dofbench.reporting import standing, table_cells
from dofbench.reporting.boards import Board, Variant, by_kind, mean_name
from dofbench.reporting.differences import Compared, adjusted, compare
from dofbench.reporting.paired import EXPLANATION
from dofbench.reporting.records import Records
from dofbench.reporting.view import Heading, Paragraph, Section, Table

Seeds = dict[Variant, list[Entry]]  # the seeds of each variant on one dataset

COMPARED = (
    "psnr",
    "ssim",
    "flip",
    "aif_psnr",
    "aif_ssim",
    "aif_flip",
    "photo_psnr",
    "photo_ssim",
    "across_psnr",
    "across_blurred_psnr",
    "delta_a",
    "delta_f",
    "delta_r",
    "disparity_error",
)
# Up to so many variants every pair is compared; of more, each only with the first and with those of methods that the
# user asks for, to keep the page short
EVERY_PAIR = 8
HEADING = "Compared view by view"
TESTED = "How differences are tested"
FILE_COLUMNS = (
    "dataset",
    "protocol",
    "method",
    "preset",
    "against_method",
    "against_preset",
    "column",
    "pairs",
    "seeds",
    "difference",
    "low",
    "high",
    "p",
    "verdict",
    "reason",
    "role",
)


@dataclass(frozen=True)
class Pair:
    """Two variants, and their differences by column."""

    one: Variant
    other: Variant
    compared: dict[str, Compared]


def pairwise(datasets: Sequence[Seeds], order: Sequence[Variant], against: Collection[str] = ()) -> list[Pair]:
    """Compare the variants that every dataset has, in the given order, in every score; p is adjusted over the pairs of
    a column. against: ids of methods that all are compared with, however many there are."""
    whole = [variant for variant in order if all(variant in seeds for seeds in datasets)]
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


def board_pairs(members: Sequence[Entry], against: Collection[str] = ()) -> list[Pair]:
    """The pairs of one board, in the order of its table. against: as of `pairwise`."""
    variants = grouped(list(members), "variant")
    return pairwise([variants], _ranked([variants]), against)


def with_the_best(pairs: Sequence[Pair], variants: int) -> list[Pair]:
    """Of the pairs of many variants, those with the best of them: what a page says of one scene among several, since
    pairs with other methods say more of the mean over scenes."""
    return [pair for pair in pairs if variants <= EVERY_PAIR or pair.one == pairs[0].one]


def mean_pairs(boards: Sequence[Board], against: Collection[str] = ()) -> dict[str, list[Pair]]:
    """Kind -> the pairs of its mean over scenes, where it has several boards: of the variants that every scene has,
    over all their views. against: as of `pairwise`."""
    kinds = {kind: [board.variants for board in scenes] for kind, scenes in by_kind(boards).items() if len(scenes) > 1}
    return {kind: pairwise(scenes, _ranked(scenes), against) for kind, scenes in kinds.items()}


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


def pairwise_section(
    pairs: Sequence[Pair], names: dict[Variant, tuple[str, str]], caption: str, signs: Mapping[Variant, str]
) -> Section | None:
    """The pairs as a table; None without a pair, or without a score that both have. caption: names the boards. signs:
    of each variant, as of its line."""
    columns = [column for column in COMPARED if any(pair.compared[column].difference for pair in pairs)]
    if not columns:
        return None
    counts = {
        column: {found.difference.pairs for pair in pairs if (found := pair.compared[column]).difference}
        for column in columns
    }
    views = dict.fromkeys(
        f"{' or '.join(map(str, sorted(found)))} {'training' if column in LENS else 'test'} "
        f"view{'' if found == {1} else 's'}"
        for column, found in counts.items()
    )
    rows = tuple(
        (
            *(table_cells.words(" ".join(names[side]), signs[side]) for side in (pair.one, pair.other)),
            *(table_cells.difference(pair.compared[column]) for column in columns),
        )
        for pair in pairs
    )
    headings = (
        Heading("", words=True),
        Heading("minus", words=True),
        *(table_cells.score_heading(COLUMNS[column]) for column in columns),
    )
    said = Paragraph(f"Over {' and '.join(views)}; see *{TESTED}*.")
    below = standing.notes(signs[side] for pair in pairs for side in (pair.one, pair.other))
    return Section(HEADING, (said, Table(f"{HEADING}: {caption}", headings, rows, names=2, below=below)))


def explanation() -> Section:
    """The section that explains tables of differences, once per page."""
    return Section(TESTED, (Paragraph(EXPLANATION),))


def comparison_records(
    boards: Sequence[Board],
    pairs: Mapping[Variant, Sequence[Pair]],
    means: Mapping[str, Sequence[Pair]],
    names: dict[Variant, tuple[str, str]],
) -> Records:
    """One row per pair and score, of scores that a run of the boards has. pairs: those of each board, by its key.
    means: `mean_pairs`."""
    kinds = by_kind(boards)
    sources = [(board.name, [board], pairs[board.key]) for board in boards]
    sources += [(mean_name(kind, kinds[kind]), kinds[kind], own) for kind, own in means.items()]
    rows = []
    for name, compared, own in sources:
        known = {
            column
            for board in compared
            for entry in board.members
            for column, score in entry.scores.items()
            if score is not None
        }
        for pair in own:
            (method, preset), (against, against_preset) = names[pair.one], names[pair.other]
            for column, found in pair.compared.items():
                if column not in known:
                    continue
                row: dict[str, object] = {
                    "dataset": name,
                    "protocol": compared[0].protocol,
                    "method": method,
                    "preset": preset,
                    "against_method": against,
                    "against_preset": against_preset,
                    "column": column,
                    "reason": found.reason,
                    "role": compared[0].role or ROLE_NOT_STATED,
                }
                if (one := found.difference) is not None:
                    row |= {
                        "pairs": one.pairs,
                        "seeds": one.seeds,
                        "difference": one.mean,
                        "low": one.low,
                        "high": one.high,
                        "p": one.p,
                        "verdict": found.verdict,
                    }
                rows.append(row)
    return Records("comparisons.csv", FILE_COLUMNS, tuple(rows))
