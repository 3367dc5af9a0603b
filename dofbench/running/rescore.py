"""Scoring finished runs again, from the pictures and the model that they kept: no training, and no change of a result.

What the result has already is computed again and must agree; what it hasn't is added, in a file of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from dofbench.core.clock import timestamp
from dofbench.core.contracts import Method
from dofbench.core.errors import InputError, Status, unknown
from dofbench.core.files import files_below, sha256_file
from dofbench.core.images import read_image, to_8bit
from dofbench.core.progress import Terminal, say
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.metrics import METRICS, score_image
from dofbench.evaluation.results import provenance
from dofbench.evaluation.results.added_scores import ADDED_VERSION, Added, AddedScore, read_added, write_added
from dofbench.evaluation.results.columns import COLUMNS, WEIGHTED
from dofbench.evaluation.results.protocol import (
    AIF_PREFIX,
    DEPTH_COLUMNS,
    PICTURE_BLUR,
    PROTOCOLS,
    arithmetic_mean,
    kind_prefix,
    scores_both_halves,
)
from dofbench.evaluation.results.result import RESULT_FILE, Result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.evaluation.scoring.evaluate import PREFIX, WHOLE, Kind, depth_scores, true_depth
from dofbench.evaluation.scoring.ground_truth import missing_truth
from dofbench.evaluation.scoring.photograph_scores import NO_TEXTURE, ScoredPixels, picture_blur
from dofbench.methods.cards import find_method
from dofbench.running.load_run import LoadedRun, load_run

if TYPE_CHECKING:
    from dofbench.evaluation.metrics.lpips import Lpips

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
    lpips: Sequence[Path] | None = None,
) -> bool:
    """Score every result at or below `paths`, and add what is new to its added.json.

    metrics: columns, comma-separated; all that are known for None. data: where the dataset is now. lpips: files with
    weights (`load_lpips`); no LPIPS for None. False when a result couldn't be scored, or a score of its own doesn't
    come out again. Raises InputError for a wrong call.
    """
    console = console or Console()
    tell = partial(say, console)
    weighted = None
    if lpips is not None:
        from dofbench.evaluation.metrics.lpips import load_lpips

        weighted = load_lpips(lpips)
    columns = None if metrics is None else _columns(metrics, weighted)
    folders = _folders(paths)
    if weighted is not None:
        tell(f"LPIPS by {weighted.name} ({weighted.id}), sha256 of the weights {weighted.sha256}")

    good = True
    with Terminal().stage("results scored", len(folders)) as advance:
        for done, folder in enumerate(folders, 1):
            found = _score_folder(folder, data, columns, weighted)
            for line in found if isinstance(found, list) else _lines(found):
                tell(f"{folder}: {line}")
            good = good and (isinstance(found, list) or not found.problems)
            advance(done)
    return good


def _score_folder(
    folder: Path, data: Path | None, columns: Sequence[str] | None, lpips: Lpips | None
) -> Scored | list[str]:
    """Score the result in `folder` again and keep what is new; or a line that says why nothing is scored."""
    try:
        run = load_run(folder, data)
        if run.result.status is not Status.OK:
            return [f"skipped, because its run ended {run.result.status}"]
        with run_lock(folder, run.result.spec, run.result.scene, timestamp()):
            found = score_result(run, columns, lpips)
            _keep(run, found)
            return found
    except InputError as error:
        return Scored(problems=[" ".join(str(error).split())])


def score_result(run: LoadedRun, columns: Iterable[str] | None, lpips: Lpips | None = None) -> Scored:
    """Compute these columns from what the run kept; for None all that are known, by `lpips` those of its protocol's
    kinds of image. Raises InputError when its dataset isn't there."""
    result, dataset = run.result, run.dataset
    wanted = [*columns_known(), *_own_columns(run, lpips)] if columns is None else list(columns)
    sources: list[tuple[str, Callable[[], dict[str, dict[str, float]]], list[str]]] = []
    found = Scored()
    for kind, prefix in PREFIX.items():
        own = [column for column in wanted if column not in DEPTH_COLUMNS and kind_prefix(column) == prefix]
        if own and (reason := _no_pictures(result, kind)):
            found.left_out |= dict.fromkeys(own, reason)
            continue
        if lpips and prefix + lpips.id in own and (reason := _too_small(dataset, lpips)):
            found.left_out[prefix + lpips.id] = reason
            own.remove(prefix + lpips.id)
        if own:
            sources.append(("predictions", partial(_of_pictures, run, kind, own, lpips), own))
    depth = [column for column in wanted if column in DEPTH_COLUMNS]
    if depth and (reason := _no_rendering(run)):
        found.left_out |= dict.fromkeys(depth, reason)
    elif depth:
        sources.append(("model", lambda: _of_depth(run.method, dataset), depth))
    folder = find_method(result.spec.method).folder
    code, git = provenance.code_version(folder, result.spec.device), provenance.git_state()
    for of, compute, own in sources:
        views = compute()
        for column in own:
            if any(column not in scores for scores in views.values()):
                found.left_out[column] = NO_TEXTURE
                continue
            values = {name: scores[column] for name, scores in views.items()}
            mean = arithmetic_mean(list(values.values()))
            if column not in result.scores:
                metric = column.removeprefix(kind_prefix(column))
                found.added[column] = AddedScore.model_validate(
                    {
                        "value": mean,
                        "views": values,
                        "of": of,
                        "note": (METRICS.get(metric) or COLUMNS[column]).note,
                        "code": code,
                        "git": git,
                        "scored": timestamp(),
                        "weights": lpips.sha256 if lpips and metric == lpips.id else "",
                    }
                )
            elif _same(mean, result.scores[column]):
                found.again.append(column)
            else:
                found.problems.append(f"{column} is {result.scores[column]:.6g}, computed again {mean:.6g}")
    # What the result has, and can't be had again now, is no gap.
    found.left_out = {column: reason for column, reason in found.left_out.items() if column not in result.scores}
    return found


def _columns(metrics: str, lpips: Lpips | None) -> tuple[str, ...]:
    known = (*columns_known(), *PICTURE_BLUR, *(prefix + lpips.id for prefix in PREFIX.values() if lpips))
    wanted = tuple(dict.fromkeys(part.strip() for part in metrics.split(",")))
    for column in wanted:
        if column not in known and column in WEIGHTED:
            label = METRICS[column.removeprefix(kind_prefix(column))].label
            raise InputError("--metrics", repr(column), f"the weights of {label} in --lpips")
        if column not in known:
            raise unknown("--metrics", column, {*known, *WEIGHTED})
    return wanted


def _own_columns(run: LoadedRun, lpips: Lpips | None) -> list[str]:
    """The blur of predicted photographs, and LPIPS of the kinds of image that the run's protocol scores."""
    protocol = PROTOCOLS.get(run.result.spec.protocol)
    if protocol is None:
        return []
    blur = [column for column in PICTURE_BLUR if column in protocol.image_columns]
    kinds = PREFIX.values() if lpips else ()
    return [*blur, *(prefix + lpips.id for prefix in kinds if lpips and f"{prefix}psnr" in protocol.image_columns)]


def _too_small(dataset: Dataset, lpips: Lpips) -> str:
    """Why the images have no LPIPS, or ""."""
    shortest = min(min(view.camera.width, view.camera.height) for view in dataset.test_views())
    return f"images of {shortest} px, and {lpips.name} needs {lpips.smallest}" if shortest < lpips.smallest else ""


def _folders(paths: Sequence[Path]) -> list[Path]:
    folders: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "a result or a folder of results")
        below = [path.parent] if path.is_file() else [file.parent for file in files_below(path, RESULT_FILE)]
        if not below:
            raise InputError(path, f"no {RESULT_FILE} in it or below", "results of `dofbench run`")
        folders += below
    return list(dict.fromkeys(folders))


def _no_pictures(result: Result, kind: Kind) -> str:
    """Why there are no pictures of that kind, or ""."""
    if any(name.startswith(f"predictions/{kind}/") for name in result.predictions):
        return ""
    return result.left_out.get(f"{PREFIX[kind]}psnr", "the run kept no such pictures")


def _of_pictures(run: LoadedRun, kind: Kind, columns: list[str], lpips: Lpips | None) -> dict[str, dict[str, float]]:
    """Raises InputError where a picture isn't the one that was scored."""
    prefix = PREFIX[kind]
    metrics = [column.removeprefix(prefix) for column in columns if column not in (*WEIGHTED, *PICTURE_BLUR)]
    read = run.dataset.all_in_focus if kind == "all_in_focus" else run.dataset.image
    views = {}
    pixels = ScoredPixels(run.dataset, both=kind in WHOLE or scores_both_halves(run.result.spec.protocol))
    for view in run.dataset.test_views():
        picture, truth = read_image(run.prediction(kind, view.name)), read(view)
        assert truth is not None
        mask, _ = pixels.of(view)
        scores = score_image(picture, truth, metrics, mask)
        if lpips and prefix + lpips.id in columns:
            scores[lpips.id] = lpips(picture, truth, mask)
        views[view.name] = {prefix + metric: float(value) for metric, value in scores.items()}
        if any(column in PICTURE_BLUR for column in columns):
            views[view.name] |= picture_blur(picture, truth, pixels.tiles(view))
    return views


def _of_depth(method: Method, dataset: Dataset) -> dict[str, dict[str, float]]:
    views = {}
    for view in dataset.test_views():
        found, truth = np.asarray(method.render(view.camera, None).depth), true_depth(dataset, view)
        assert truth is not None and dataset.disparity_range is not None
        views[view.name] = depth_scores(found, truth, dataset.disparity_range)
    return views


def _no_rendering(run: LoadedRun) -> str:
    """Why depth rendered by the kept model would say nothing: there is no truth, or this code doesn't render the model
    as the code did that trained it. "" where it does."""
    if reason := missing_truth(run.dataset).depth or run.no_model():
        return reason
    view = run.dataset.test_views()[0]
    try:
        picture = np.asarray(run.method.render(view.camera, None).image)
    except Exception as error:  # a method's own code, and a model that other code wrote: its words are the reason
        return f"this code can't render the kept model: {' '.join(f'{type(error).__name__}: {error}'.split())}"
    kept = run.folder / "predictions" / "all_in_focus" / f"{view.name}.png"
    if not kept.is_file():
        return "without a kept picture it is unknown whether this code still renders the kept model the same"
    before, now = to_8bit(read_image(kept)).astype(int), to_8bit(picture).astype(int)
    if before.shape != now.shape or np.abs(before - now).max() > SAME_LEVELS:
        return "this code renders the kept model otherwise than the code that trained it"
    return ""


def _keep(run: LoadedRun, found: Scored) -> None:
    folder = run.folder
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
                key=run.result.key,
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
