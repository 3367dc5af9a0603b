"""Notes on scores of real photographs: whether the dataset can rank lenses, coverage, and intervals against EXIF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from dofbench.core.errors import Status
from dofbench.core.files import canonical_json
from dofbench.evaluation.metrics.exif_errors import Estimate, Interval, exif_intervals
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import EVIDENCE_COLUMNS, EXIF_COLUMNS, arithmetic_mean

START = "lens_init_aperture"  # the option whose values are the starts
MEASURED = "lens_measured_at"  # the option by which, below 1, a measurement replaces the start
APART = 4.0  # least ratio of two starts
LEAST_WIDTH = 0.05  # relative: half of the narrowest interval, since two trainings are never equal
ONE_START = "one start"

Variant = tuple[str, ...]
Groups = Mapping[Variant, Sequence[Entry]]  # the runs of each variant on one dataset


def photograph_notes(
    groups: Groups, others: Sequence[Entry], names: Mapping[Variant, tuple[str, str]]
) -> tuple[str, ...]:
    """Lines below a table of scores. others: all runs of the report. names: of the variants, as shown."""
    shown = {variant: " ".join(names[variant]).strip() for variant in groups}
    ranking = no_ranking([entry for runs in groups.values() for entry in runs])
    return *([ranking] if ranking else []), *_coverage(groups, others, shown), *_by_exif(groups, shown)


def no_ranking(members: Sequence[Entry]) -> str:
    """That a dataset can't rank lenses, with the figures of the run that finds most blur; "" if some run shows that it
    can, or none was asked."""
    asked = [entry for entry in members if entry.result and all(one in entry.scores for one in EVIDENCE_COLUMNS)]
    reasons = [(entry.scores[EVIDENCE_COLUMNS[0]], entry.result.no_ranking) for entry in asked if entry.result]
    if not reasons or not all(reason for _, reason in reasons):
        return ""
    return f"This dataset can't rank lenses: {max(reasons)[1]}."


# ---- coverage ----


def _coverage(groups: Groups, others: Sequence[Entry], shown: Mapping[Variant, str]) -> Iterator[str]:
    """For each variant that was also trained with a part of the test photographs: both scores of the rest."""
    alike: dict[tuple[str, ...], list[Entry]] = {}
    scenes = {runs[0].scene for runs in groups.values() if runs}
    for other in others:
        if other.scene in scenes:
            alike.setdefault(_made(other), []).append(other)
    for variant, runs in groups.items():
        more = [other for other in alike.get(_made(runs[0]), ()) if _covers_more(other, runs[0])] if runs else []
        if not more:
            continue
        left, all_of = _split(more[0])[1], _split(runs[0])[1]
        without, covered = _psnr(runs, left), _psnr(more, left)
        if without is not None and covered is not None:
            yield (
                f"Coverage, {shown[variant]}: {covered:.2f} dB on {len(left)} of the test photographs when trained on "
                f"the other {len(all_of) - len(left)} as well, {without:.2f} dB without."
            )


def _covers_more(other: Entry, run: Entry) -> bool:
    """Whether `other`, of the same method and options, was trained on a part of this run's test views too."""
    if other.scene != run.scene:
        return False
    (train, test), (more, left) = _split(run), _split(other)
    return bool(left) and left < test and more == train | (test - left)


def _made(entry: Entry) -> tuple[str, ...]:
    spec = entry.spec
    return spec.method, spec.preset, canonical_json([entry.changed, spec.content]), spec.budget, spec.device


def _split(entry: Entry) -> tuple[set[str], set[str]]:
    """Names of the training and the test views."""
    lenses = entry.lenses or {"train": {}, "test": {}}
    return set(lenses["train"]), set(lenses["test"])


def _psnr(runs: Sequence[Entry], views: set[str]) -> float | None:
    """Mean PSNR of these photographs over the runs; None where a run lacks one."""
    found = [
        next((scores[one] for one in ("photo_psnr", "across_psnr") if one in scores), None)
        for entry in runs
        if entry.status is Status.OK
        for scores in (entry.views.get(view, {}) for view in sorted(views))
    ]
    known = [value for value in found if value is not None]
    return arithmetic_mean(known) if known and len(known) == len(found) else None


# ---- apertures against EXIF ----


def undetermined(groups: Groups) -> dict[Variant, str]:
    """Variant -> why its scores against EXIF mean nothing: two trainings, alike but for `lens_init_aperture`, a factor
    of four apart, learned apertures whose intervals don't meet."""
    return {variant: said for variant, said in _starts(groups).items() if said.startswith("undetermined")}


def _by_exif(groups: Groups, shown: Mapping[Variant, str]) -> Iterator[str]:
    said = _starts(groups)
    for variant, runs in groups.items():
        found = exif_intervals(_estimates(runs))
        parts = [
            f"{COLUMNS[column].label} 95 % from {low:.1f} to {high:.1f} %"
            for column, interval in zip(EXIF_COLUMNS, (found.spread, found.ratio), strict=True)
            if interval is not None and any(column in entry.scores for entry in runs)
            for low, high in [interval]
        ]
        if parts:
            yield f"Apertures against EXIF, {shown[variant]}: {', '.join([*parts, said[variant]])}."


def _starts(groups: Groups) -> dict[Variant, str]:
    """Variant -> what trainings from other starts say of its apertures, in words."""
    families: dict[str, list[Variant]] = {}
    for variant, runs in groups.items():
        families.setdefault(_family(runs), []).append(variant)
    said = {family: _of_starts([groups[one] for one in members]) for family, members in families.items()}
    return {variant: said[family] for family, members in families.items() for variant in members}


def _of_starts(family: Sequence[Sequence[Entry]]) -> str:
    options = [(runs[0].spec.options, runs) for runs in family]
    starts = {one[START]: runs for one, runs in options if START in one and one.get(MEASURED, 1.0) >= 1.0}
    if not starts or max(starts) < APART * min(starts):
        return ONE_START
    ends = [(start, exif_intervals(_estimates(starts[start])).product) for start in (min(starts), max(starts))]
    (low, first), (high, second) = ends
    if first is None or second is None:
        return ONE_START
    said = f"aperture × f-number {_words(first)} from a start of {low:g}, {_words(second)} from {high:g}"
    (a, b), (c, d) = _widened(first), _widened(second)
    return f"{'two starts agree' if a <= d and c <= b else 'undetermined'}: {said}"


def _family(runs: Sequence[Entry]) -> str:
    """What variants that differ only in their start share."""
    spec = runs[0].spec
    overrides, options = ({k: v for k, v in some.items() if k != START} for some in (runs[0].changed, spec.options))
    parts = [spec.method, spec.preset, overrides, options, spec.content, spec.budget, spec.device, spec.code]
    return canonical_json(parts)


def _estimates(runs: Sequence[Entry]) -> list[Estimate]:
    results = [entry.result for entry in runs if entry.status is Status.OK and entry.result is not None]
    return [(view.aperture, view.f_number) for result in results for view in result.apertures]


def _words(interval: Interval) -> str:
    return f"{interval[0]:.3g} to {interval[1]:.3g}"


def _widened(interval: Interval) -> Interval:
    middle = (interval[0] + interval[1]) / 2
    return min(interval[0], middle * (1 - LEAST_WIDTH)), max(interval[1], middle * (1 + LEAST_WIDTH))
