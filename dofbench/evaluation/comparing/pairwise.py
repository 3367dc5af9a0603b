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

Variant = tuple[str, ...]  # `Entry.variant`
Seeds = Mapping[Variant, Sequence[Entry]]  # the seeds of each variant on one dataset

# Up to so many variants every pair is compared; of more, each only with the first and with those of methods that the
# user asks for, to keep the page short
EVERY_PAIR = 8


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
