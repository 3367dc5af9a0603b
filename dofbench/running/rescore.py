"""Scoring finished runs again, from the pictures and the model that they kept: no training, and no change of a result.

What the result has already is computed again and must agree; what it hasn't is added, in a file of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from dofbench.core.contracts import Method
from dofbench.core.errors import InputError, Status
from dofbench.core.files import sha256_file
from dofbench.core.images import read_image, to_8bit
from dofbench.dataset.dataset import Dataset
from dofbench.metrics import METRICS, score_image
from dofbench.results import provenance
from dofbench.results.added_scores import ADDED_VERSION, Added, AddedScore, read_added, write_added
from dofbench.results.protocol import AIF_PREFIX, DEPTH_COLUMNS, arithmetic_mean
from dofbench.results.result import RESULT_FILE, Result, read_result
from dofbench.results.run_lock import locked
from dofbench.running.method_cards import MethodEntry, find_method
from dofbench.scoring.evaluate import PREFIX, WHOLE, Kind, depth_scores
from dofbench.scoring.ground_truth import missing_truth

SAME = 1e-6  # relative, between a score and the same one computed again from the same pictures
SAME_LEVELS = 1  # of 255, between a kept picture and the kept model rendered again: float32 sums of another machine


@dataclass(eq=False)
class Scored:
    """What scoring a result again came to. added: by column. again: columns that agree with the result's. left_out:
    column -> reason. problems: one line each."""

    added: dict[str, AddedScore] = field(default_factory=dict)
    again: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def columns_known() -> tuple[str, ...]:
    """Every column that can be computed from what a run keeps, lens errors excepted: those are of the training."""
    images = [metric.id for metric in METRICS.values() if metric.needs == "images"]
    return (*images, *(AIF_PREFIX + metric for metric in images), *DEPTH_COLUMNS)


def score(
    paths: Sequence[Path],
    metrics: str | None = None,
    data: Path | None = None,
    console: Console | None = None,
) -> bool:
    """Score every result at or below `paths`, and add what is new to its added.json.

    metrics: columns, comma-separated; all that are known for None. data: where the dataset is now. False when a result
    couldn't be scored, or a score of its own doesn't come out again. Raises InputError for a wrong call.
    """
    console = console or Console()
    columns = _columns(metrics)
    folders = _folders(paths)

    def say(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    good = True
    for folder in folders:
        try:
            result = read_result(folder)
            if result.status is not Status.OK:
                say(f"{folder}: left out, as its run ended {result.status}")
                continue
            with locked(folder, result.spec, result.scene, _now()):
                found = score_result(folder, result, columns, data)
                _keep(folder, result, found)
        except InputError as error:
            found = Scored(problems=[" ".join(str(error).split())])
        for line in _lines(found):
            say(f"{folder}: {line}")
        good = good and not found.problems
    return good


def score_result(folder: Path, result: Result, columns: Iterable[str], data: Path | None = None) -> Scored:
    """Compute these columns from what the run in `folder` kept. Raises InputError when its dataset isn't there."""
    dataset = _dataset(result, data or Path(result.data))
    entry = find_method(result.spec.method)
    wanted = list(columns)
    sources: list[tuple[str, Callable[[], dict[str, dict[str, float]]], list[str]]] = []
    found = Scored()
    for kind in WHOLE:
        prefix = PREFIX[kind]
        own = [
            column for column in wanted if column not in DEPTH_COLUMNS and column.startswith(AIF_PREFIX) == bool(prefix)
        ]
        if own and (reason := _no_pictures(folder, result, kind)):
            found.left_out |= dict.fromkeys(own, reason)
        elif own:
            sources.append(("predictions", lambda kind=kind, own=own: _of_pictures(folder, dataset, kind, own), own))
    depth = [column for column in wanted if column in DEPTH_COLUMNS]
    if depth:
        method, reason = _kept_method(folder, result, dataset, entry)
        if method is None:
            found.left_out |= dict.fromkeys(depth, reason)
        else:
            sources.append(("model", lambda: _of_depth(method, dataset), depth))
    code, git = provenance.code_version(entry.folder), provenance.git_state()
    for of, compute, own in sources:
        views = compute()
        for column in own:
            values = {name: scores[column] for name, scores in views.items()}
            mean = arithmetic_mean(list(values.values()))
            if column not in result.scores:
                found.added[column] = AddedScore.model_validate(
                    dict(
                        value=mean,
                        views=values,
                        of=of,
                        note=METRICS[column.removeprefix(AIF_PREFIX)].note,
                        code=code,
                        git=git,
                        scored=_now(),
                    )
                )
            elif _same(mean, result.scores[column]):
                found.again.append(column)
            else:
                found.problems.append(f"{column} is {result.scores[column]:.6g}, computed again {mean:.6g}")
    # What the result has, and can't be had again now, is no gap.
    found.left_out = {column: reason for column, reason in found.left_out.items() if column not in result.scores}
    return found


def _columns(metrics: str | None) -> tuple[str, ...]:
    known = columns_known()
    if metrics is None:
        return known
    wanted = tuple(dict.fromkeys(part.strip() for part in metrics.split(",")))
    for column in wanted:
        if column not in known:
            raise InputError("--metrics", repr(column), f"one of {', '.join(known)}")
    return wanted


def _folders(paths: Sequence[Path]) -> list[Path]:
    folders: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "a result or a folder of results")
        below = [path.parent] if path.is_file() else sorted(file.parent for file in path.rglob(RESULT_FILE))
        if not below:
            raise InputError(path, f"no {RESULT_FILE} in it or below", "results of `dofbench run`")
        folders += below
    return list(dict.fromkeys(folders))


def _dataset(result: Result, folder: Path) -> Dataset:
    dataset = Dataset.load(folder)
    if dataset.checksum != result.spec.dataset_checksum:
        raise InputError(
            folder,
            f"the dataset {dataset.name} of checksum {dataset.checksum[:16]}",
            f"{result.spec.dataset} of checksum {result.spec.dataset_checksum[:16]}, that it was run on",
        )
    return dataset


def _no_pictures(folder: Path, result: Result, kind: Kind) -> str:
    """Why there are no pictures of that kind, or "". Raises InputError where one isn't the one that was scored."""
    names = [name for name in result.predictions if name.startswith(f"predictions/{kind}/")]
    if not names:
        return result.left_out.get(f"{PREFIX[kind]}psnr", "the run kept no such pictures")
    for name in names:
        file = folder / name
        if not file.is_file() or sha256_file(file) != result.predictions[name]:
            raise InputError(file, "no file" if not file.is_file() else "another picture", "the one that was scored")
    return ""


def _of_pictures(folder: Path, dataset: Dataset, kind: Kind, columns: list[str]) -> dict[str, dict[str, float]]:
    prefix = PREFIX[kind]
    metrics = [column.removeprefix(prefix) for column in columns]
    read = dataset.image if kind == "refocus" else dataset.all_in_focus
    views = {}
    for view in _test_views(dataset):
        picture = read_image(folder / "predictions" / kind / f"{view.name}.png")
        views[view.name] = {
            prefix + metric: float(value) for metric, value in score_image(picture, read(view), metrics).items()
        }
    return views


def _of_depth(method: Method, dataset: Dataset) -> dict[str, dict[str, float]]:
    return {
        view.name: depth_scores(
            np.asarray(method.render(view.camera, None).depth), dataset.depth(view), dataset.disparity_range
        )
        for view in _test_views(dataset)
    }


def _kept_method(
    folder: Path,
    result: Result,
    dataset: Dataset,
    entry: MethodEntry,
) -> tuple[Method | None, str]:
    """The trained method, or None and the reason: nothing to compare with, or the kept model can't be rendered."""
    views = _test_views(dataset)
    if reason := missing_truth(dataset).depth:
        return None, reason
    if not (folder / "model").is_dir():
        return None, "the run kept no model"
    for name, checksum in result.model.items():
        if not (folder / name).is_file() or sha256_file(folder / name) != checksum:
            return None, f"{name} isn't the file that the run kept"
    try:
        method = entry.create(dict(result.spec.options), result.spec.seed, result.spec.device)
        method.load(folder / "model")
        picture = np.asarray(method.render(views[0].camera, None).image)
    except Exception as error:  # a method's own code, and a model that other code wrote: its words are the reason
        return None, f"this code can't render the kept model: {' '.join(f'{type(error).__name__}: {error}'.split())}"
    kept = folder / "predictions" / "all_in_focus" / f"{views[0].name}.png"
    if not kept.is_file():
        return None, "without a kept picture nobody knows whether this code renders the kept model as then"
    before, now = to_8bit(read_image(kept)).astype(int), to_8bit(picture).astype(int)
    if before.shape != now.shape or np.abs(before - now).max() > SAME_LEVELS:
        return None, "this code renders the kept model otherwise than the code that trained it"
    return method, ""


def _test_views(dataset: Dataset):
    return [view for view in dataset.views if view.split == "test"]


def _keep(folder: Path, result: Result, found: Scored) -> None:
    try:
        earlier = read_added(folder)
    except InputError:  # of another result.json, or damaged: written anew
        earlier = None
    scores = {**(earlier.scores if earlier else {}), **found.added}
    left_out = {
        column: reason
        for column, reason in {**(earlier.left_out if earlier else {}), **found.left_out}.items()
        if column not in scores
    }
    if scores or left_out:
        write_added(
            folder,
            Added(
                schema_version=ADDED_VERSION,
                key=result.key,
                scores=scores,
                left_out=left_out,
                result_sha256=sha256_file(folder / RESULT_FILE),
            ),
        )


def _lines(found: Scored) -> list[str]:
    lines = [*found.problems]
    lines += [
        f"added {column} {score.value:.6g}, of {len(score.views)} views, from the kept {score.of}"
        for column, score in found.added.items()
    ]
    if found.again:
        lines.append(f"the same again: {', '.join(found.again)}")
    reasons: dict[str, list[str]] = {}
    for column, reason in found.left_out.items():
        reasons.setdefault(reason, []).append(column)
    return [*lines, *(f"no {', '.join(columns)}: {reason}" for reason, columns in reasons.items())]


def _same(one: float, two: float) -> bool:
    return one == two or (math.isnan(one) and math.isnan(two)) or math.isclose(one, two, rel_tol=SAME, abs_tol=SAME)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
