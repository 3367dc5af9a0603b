"""Collects results and groups those that can be compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from dofbench.core.errors import InputError, Status
from dofbench.core.files import canonical_json, files_below
from dofbench.datasets.format.points_record import PointsRecord, points_of_plan
from dofbench.evaluation.results.added_scores import Added, read_added
from dofbench.evaluation.results.columns import COLUMNS, SCORES
from dofbench.evaluation.results.protocol import kind_prefix
from dofbench.evaluation.results.result import RESULT_FILE, Result, Spec, read_result
from dofbench.evaluation.results.run_lock import at_work, begun_folders, read_lock
from dofbench.evaluation.results.run_spec import option_words

T = TypeVar("T")


@dataclass(frozen=True)
class Entry:
    """One run. result: None if the process died before writing one. added: scores computed later by `dofbench score`.
    choices: `Result.choices`, None if unknown."""

    folder: Path
    spec: Spec
    scene: str
    status: Status
    message: str
    result: Result | None
    added: Added | None = None
    choices: str | None = None

    @cached_property
    def scores(self) -> dict[str, float]:
        """Scores by column, measured by the run or added later."""
        if self.result is None:
            return {}
        later = {column: score.value for column, score in self.added.scores.items()} if self.added else {}
        return {**later, **self.result.scores} if later else self.result.scores

    @property
    def left_out(self) -> dict[str, str]:
        """Reasons for missing scores, by column."""
        return {**(self.added.left_out if self.added else {}), **self.result.left_out} if self.result else {}

    @cached_property
    def views(self) -> dict[str, dict[str, float]]:
        """Scores by test view and column, measured by the run or added later."""
        later = self.added.scores.items() if self.added else ()
        found = {}
        for view in self.result.views if self.result else ():
            more = {column: score.views[view.name] for column, score in later if view.name in score.views}
            found[view.name] = {**more, **view.scores} if more else view.scores
        return found

    @cached_property
    def preset(self) -> str:
        """The preset, followed by what the user changed: options, and the share of held-out pixels."""
        return " ".join([self.spec.preset, *option_words(self.changed)])

    @property
    def changed(self) -> dict[str, Any]:
        """What the user changed of the preset's options and training views."""
        held_out = {"held_out": self.spec.held_out} if self.spec.held_out else {}
        return {**self.spec.overrides, **held_out}

    @property
    def lenses(self) -> dict[str, Any] | None:
        """The dataset's assignment of lenses to views, as in the plan; None for an old result without it."""
        return self.result.plan.get("lenses") if self.result else None

    @property
    def points(self) -> PointsRecord | None:
        """The source of the dataset's points and poses; None if unknown."""
        return points_of_plan(self.result.plan) if self.result else None

    @cached_property
    def board(self) -> tuple[str, str, str]:
        """(dataset, its checksum, protocol): only runs that share all three are compared in a table."""
        return self.spec.dataset, self.spec.dataset_checksum, self.spec.protocol

    @cached_property
    def variant(self) -> tuple[str, ...]:
        """The settings shared by runs of one configuration with different seeds or datasets."""
        spec = self.spec
        # Not the overrides alone: --force-all changes none of them. Not the options: plans change them too.
        chosen = canonical_json([self.changed, spec.content]), self.choices or canonical_json(spec.options)
        return spec.method, spec.preset, *chosen, spec.budget, spec.device, spec.code


@dataclass(frozen=True)
class Collection:
    """The runs below some folders. entries: sorted. unreadable: one line for each unreadable result. running: folders
    of runs in progress. doubles: copies of a run in entries."""

    entries: tuple[Entry, ...]
    unreadable: tuple[str, ...]
    running: tuple[Path, ...]
    doubles: tuple[Path, ...]


def collect(*folders: Path) -> Collection:
    """All runs below the folders, merged by key: of several results with one key the best is kept (`_rank`).

    Raises InputError without any result.
    """
    results: dict[str, tuple[Path, Result]] = {}
    unreadable: list[str] = []
    doubles: list[Path] = []
    for folder in folders:
        if not folder.is_dir():
            raise InputError(folder, "no such folder", "a folder of results, as `dofbench run` writes it")
        for file in files_below(folder, RESULT_FILE):
            try:
                found = file.parent, read_result(file)
            except InputError as error:
                unreadable.append(str(error))
                continue
            first = results.setdefault(found[1].key, found)
            if first is not found:  # a copy would count as a second seed
                better, other = (found, first) if _rank(found[1]) > _rank(first[1]) else (first, found)
                results[better[1].key] = better
                doubles.append(other[0])
    entries: list[Entry] = []
    for folder, result in results.values():
        try:
            entries.append(entry_of(folder, result))
        except InputError as error:  # the added scores only
            unreadable.append(str(error))
            entries.append(_entry(folder, result, None))
    running: list[Path] = []
    finished = {entry.spec.key for entry in entries}
    for folder in dict.fromkeys(below for root in folders for below in begun_folders(root)):
        if at_work(folder):
            running.append(folder)
        elif not (folder / RESULT_FILE).is_file():
            try:
                dead = dead_entry(folder)
            except InputError as error:
                unreadable.append(str(error))
                continue
            # Another machine may have finished this run since, or died in it too.
            if dead is not None and dead.spec.key not in finished:
                finished.add(dead.spec.key)
                entries.append(dead)
    if not entries and not unreadable:
        where = ", ".join(map(str, folders))
        raise InputError(where, f"no {RESULT_FILE} in it or below", "results of `dofbench run`")
    entries = _of_one_set_of_weights(_settled(entries))
    entries.sort(key=lambda entry: (*entry.board, *entry.variant, entry.spec.seed, entry.spec.key))
    return Collection(tuple(entries), tuple(unreadable), tuple(running), tuple(doubles))


def _settled(entries: Sequence[Entry]) -> list[Entry]:
    """The entries; a dead run gets the choices of a run that differs only in its seed."""
    known = {_but_for_seed(entry): entry.choices for entry in entries if entry.choices is not None}
    return [
        entry if entry.result is not None else replace(entry, choices=known.get(_but_for_seed(entry)))
        for entry in entries
    ]


def _of_one_set_of_weights(entries: Sequence[Entry]) -> list[Entry]:
    """The entries; scores by other weights than most runs' have a reason instead, since they can't be compared."""
    used = Counter(
        (_metric_of(column), score.weights)
        for entry in entries
        for column, score in (entry.added.scores if entry.added else {}).items()
        if score.weights
    )
    kept = dict(pair for pair, _ in sorted(used.items(), key=lambda one: (one[1], one[0])))  # the most frequent is last
    found = []
    for entry in entries:
        scores = entry.added.scores if entry.added else {}
        other = {
            column: f"by weights of sha256 {score.weights[:8]}…, most runs here by {most[:8]}…"
            for column, score in scores.items()
            if score.weights and score.weights != (most := kept[_metric_of(column)])
        }
        if entry.added and other:
            left = {column: score for column, score in scores.items() if column not in other}
            added = entry.added.model_copy(update={"scores": left, "left_out": {**entry.added.left_out, **other}})
            entry = replace(entry, added=added)
        found.append(entry)
    return found


def _metric_of(column: str) -> str:
    return column.removeprefix(kind_prefix(column))


def _but_for_seed(entry: Entry) -> str:
    return canonical_json(entry.spec.model_dump(exclude={"seed"}))


def _rank(result: Result) -> tuple[bool, bool]:
    """Higher is better: successful runs, then runs that would fail in the same way again, then interrupted ones."""
    return result.status is Status.OK, result.finished


def entry_of(folder: Path, result: Result) -> Entry:
    """The run of this result in `folder`. Raises InputError for unreadable added scores."""
    return _entry(folder, result, read_added(folder))


def _entry(folder: Path, result: Result, added: Added | None) -> Entry:
    return Entry(folder, result.spec, result.scene, result.status, result.message, result, added, result.choices)


def dead_entry(folder: Path) -> Entry | None:
    """The run that died in `folder` before writing a result; None without one. Raises InputError for a damaged
    record."""
    left = read_lock(folder)
    if left is None:
        return None
    spec, scene, started = left
    message = f"started {started}, and the process died without a message (killed, or out of memory)"
    return Entry(folder, spec, scene, Status.CRASHED, message, None)


def added_columns(entries: Sequence[Entry]) -> tuple[str, ...]:
    """Columns that `dofbench score` added to at least one of these runs and that runs don't measure themselves."""
    found = dict.fromkeys(column for entry in entries if entry.added for column in entry.added.scores)
    return tuple(column for column in COLUMNS if column in found and column not in SCORES)


def grouped(items: Iterable[T], attribute: str) -> dict[Any, list[T]]:
    """Items by an attribute, in order: entries by `board` or `variant`, boards by `kind`."""
    groups: dict[Any, list[T]] = {}
    for item in items:
        groups.setdefault(getattr(item, attribute), []).append(item)
    return groups


def board_names(entries: tuple[Entry, ...]) -> dict[tuple[str, ...], str]:
    """The name of each board's dataset, with the checksum if two datasets have the same name."""
    boards = list(grouped(entries, "board"))
    checksums: dict[str, set[str]] = {}
    for dataset, checksum, _ in boards:
        checksums.setdefault(dataset, set()).add(checksum)
    return {board: board[0] if len(checksums[board[0]]) == 1 else f"{board[0]}@{board[1][:8]}" for board in boards}


def variant_names(entries: tuple[Entry, ...]) -> dict[tuple[str, ...], tuple[str, str]]:
    """(method, preset) to show for each variant; skipped stages, budget, device or code are added where two look
    alike."""
    members = grouped(entries, "variant")
    names = {variant: (found[0].spec.method, found[0].preset) for variant, found in members.items()}
    details_of: tuple[Callable[[Sequence[Sequence[Entry]]], list[str]], ...] = (
        _left_out_stages,
        lambda those: [found[0].spec.budget for found in those],
        lambda those: [found[0].spec.device for found in those],
        lambda those: [f"code {found[0].spec.code[-64:][:8]}" for found in those],
    )
    for detail in details_of:
        alike: dict[tuple[str, str], list[tuple[str, ...]]] = {}
        for variant, name in names.items():
            alike.setdefault(name, []).append(variant)
        for (method, preset), variants in alike.items():
            details = dict(zip(variants, detail([members[variant] for variant in variants]), strict=True))
            if len(set(details.values())) > 1:
                names |= {variant: (method, f"{preset}, {details[variant]}") for variant in variants}
    return names


def _left_out_stages(variants: Sequence[Sequence[Entry]]) -> list[str]:
    """For each variant the stages skipped on a shared dataset, except those skipped by all; empty without such a
    dataset."""
    shared = set.intersection(*({entry.board for entry in found} for found in variants))
    if not shared:
        return [""] * len(variants)
    board = min(shared)
    entries = [next(entry for entry in found if entry.board == board) for found in variants]
    plans = [entry.result.plan["stages"] if entry.result else [] for entry in entries]
    absent = [[stage["name"] for stage in plan if not stage["runs"]] for plan in plans]
    planned = [set(names) for plan, names in zip(plans, absent, strict=True) if plan]
    common = set.intersection(*planned) if planned else set()
    nothing = "nothing else skipped" if common else "nothing skipped"
    return [", ".join(f"{name} skipped" for name in names if name not in common) or nothing for names in absent]
