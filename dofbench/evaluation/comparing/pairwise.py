"""Compares methods pairwise, view by view, in every score."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dofbench.evaluation.comparing.paired import Compared, adjusted, compare
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import ALL_IN_FOCUS, DEPTH, LENS, PHOTOGRAPH, REFOCUS
from dofbench.evaluation.results.protocol import arithmetic_mean

# A pair is tested in one of these, the first that most pairs have.
TESTED = ("psnr", "aif_psnr", "photo_psnr", "across_psnr")

Variant = tuple[str, ...]  # `Entry.variant`
Seeds = Mapping[Variant, Sequence[Entry]]  # the seeds of each variant on one dataset

# Up to so many variants every pair is compared; of more, each only with the first and with those of methods that the
# user asks for, to keep the page short
EVERY_PAIR = 8


@dataclass(frozen=True)
class Pair:
    """Two variants, and their differences by column. tested: the column whose difference has the pair's p."""

    one: Variant
    other: Variant
    compared: dict[str, Compared]
    tested: str

    def p(self, column: str) -> float | None:
        """The pair's p, where this is the column that it is tested in."""
        found = self.compared[column].difference
        return None if found is None else found.p


def pairwise(datasets: Sequence[Seeds], against: Collection[str] = ()) -> list[Pair]:
    """Compare the variants that every dataset has in every score, and test each pair in one (`TESTED`), p adjusted over
    the pairs. against: ids of methods that all are compared with."""
    whole = [variant for variant in _ranked(datasets) if all(variant in seeds for seeds in datasets)]
    pairs = list(itertools.combinations(whole, 2))
    if len(whole) > EVERY_PAIR:
        rivals = {variant for variant in whole if datasets[0][variant][0].spec.method in against} | {whole[0]}
        pairs = [pair for pair in pairs if rivals & set(pair)]
    columns = (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH, *LENS, *DEPTH)
    sides = [[(seeds[one], seeds[other]) for seeds in datasets] for one, other in pairs]
    found = {column: [compare(groups, column, test=False) for groups in sides] for column in columns}
    tested = max(TESTED, key=lambda column: sum(one.difference is not None for one in found[column]))
    found[tested] = adjusted([compare(groups, tested) for groups in sides])
    return [
        Pair(*pair, {column: every[place] for column, every in found.items()}, tested)
        for place, pair in enumerate(pairs)
    ]


def with_the_best(pairs: Sequence[Pair], variants: int) -> Sequence[Pair]:
    """Of the pairs of many variants, those with the best: what a page shows of one scene among several."""
    return [pair for pair in pairs if variants <= EVERY_PAIR or pair.one == pairs[0].one]


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
