"""Is a result what it says it is? Schema, key, checksums, and a score computed again from the pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from dofbench.core.errors import InputError, Status
from dofbench.core.files import files_below, sha256_file, temporaries
from dofbench.core.images import read_image
from dofbench.core.leases import at_work, leased_folders
from dofbench.dataset.dataset import Dataset
from dofbench.metrics import score_image
from dofbench.results.added_scores import ADDED_FILE, read_added
from dofbench.results.result import RESULT_FILE, Result, read_result
from dofbench.running.execution import TRAINED_FILE
from dofbench.running.load_run import LoadedRun, load_run
from dofbench.scenes.named.roles import contradiction
from dofbench.scoring.evaluate import PREFIX, WHOLE
from dofbench.scoring.photograph_scores import picture_scores
from dofbench.scoring.result_consistency import added_inconsistencies, inconsistencies

# The pictures hold exactly what was scored (8 bits), so only the order of summation may differ.
PSNR_AGREEMENT = 1e-4  # dB


def check_result(folder: Path) -> list[str]:
    """What is wrong with the result in `folder`, one line each; an empty list when nothing is.

    Where the dataset is at the place that the result names, and is the same one, PSNR is computed
    again from the saved pictures; where it isn't, that is not a fault of the result, and only the
    other checks are made.
    """
    try:
        run = load_run(folder)
    except InputError as error:
        return [str(error)]
    result = run.result
    problems = [*inconsistencies(result), *_place(folder, result), *_pictures(folder, result), *_added(folder, result)]
    if said := contradiction(result.role, result.role_by):
        problems.append(said)
    return problems or _scores_again(run)


def result_folders(folder: Path) -> list[Path]:
    """Folders at or below `folder` with a result, or where a run is at work or died."""
    return sorted({*(file.parent for file in files_below(folder, RESULT_FILE)), *leased_folders(folder)})


def check_results(folders: Sequence[Path], say: Callable[[str], None]) -> dict[Path, list[str]]:
    """What is wrong with the result in each folder; an empty list where nothing is.

    Runs that died and results that are there twice are wrong too. say: told of runs at work, which aren't checked.
    """
    problems: dict[Path, list[str]] = {}
    keys: dict[str, Path] = {}
    for folder in folders:
        if at_work(folder):
            say(f"{folder}: a run is at work there, not checked")
        elif not (folder / RESULT_FILE).is_file():
            problems[folder] = ["a run died here and left no result; its command goes on with it"]
        else:
            problems[folder] = check_result(folder)
            if not problems[folder]:
                key = read_result(folder).key
                if (first := keys.setdefault(key, folder)) != folder:
                    problems[folder].append(f"the same run as in {first}: counted twice it would be a second seed")
    return problems


def _place(folder: Path, result: Result) -> Iterator[str]:
    if folder.resolve().name != result.spec.folder.name:
        yield f"the folder of this run would be {result.spec.folder.name}: it is found by its name"
    if (folder / TRAINED_FILE).is_file():
        yield f"{TRAINED_FILE}: left by a run that died while it scored; its command goes on with it"
    for file in temporaries(folder):
        if file.is_file():
            yield f"{file.relative_to(folder)}: half a file, left by a process that died"


def _pictures(folder: Path, result: Result) -> Iterator[str]:
    for name, checksum in {**result.predictions, **result.model}.items():
        file = folder / name
        if not file.resolve().is_relative_to(folder.resolve()):  # by a link
            yield f"{name}: outside of the result's folder"
        elif not file.is_file():
            yield f"{name}: missing"
        elif sha256_file(file) != checksum:
            yield f"{name}: not the file that was scored (its sha256 is another one)"
    for view in result.views if result.status is Status.OK else ():
        for kind, prefix in PREFIX.items():
            name = f"predictions/{kind}/{view.name}.png"
            if f"{prefix}psnr" in view.scores and name not in result.predictions:
                yield f"view {view.name}: scores of {kind}, and no picture of it in the result"


def _added(folder: Path, result: Result) -> Iterator[str]:
    try:
        added = read_added(folder)
    except InputError as error:
        yield str(error)
        return
    if added is not None:
        yield from (f"{ADDED_FILE}: {problem}" for problem in added_inconsistencies(added, result))


def _standing(result: Result, dataset: Dataset) -> list[str]:
    """The role and the photographer are the dataset's; results of older versions state neither."""
    if result.photographer is None:
        return []
    pairs = (("role", result.role, dataset.role), ("photographer", result.photographer, dataset.photographer))
    return [f"{name} {own}, and {whole} of {dataset.folder}" for name, own, whole in pairs if own != whole]


def _scores_again(run: LoadedRun) -> list[str]:
    try:
        dataset = run.dataset
    except InputError:  # gone, or another one by now: no fault of the result
        return []
    problems = _standing(run.result, dataset)
    test = {view.name: view for view in dataset.test_views()}
    for scored in run.result.views:
        if scored.name not in test:
            problems.append(f"view {scored.name}: not a test view of {run.data}")
            continue
        for kind, prefix in PREFIX.items():
            column = f"{prefix}psnr"
            stored = scored.scores.get(column)
            if stored is None or math.isnan(stored):
                continue
            truth = (dataset.all_in_focus if kind == "all_in_focus" else dataset.image)(test[scored.name])
            assert truth is not None
            picture = read_image(run.prediction(kind, scored.name))
            again = (
                score_image(picture, truth, ["psnr"])["psnr"]
                if kind in WHOLE
                else picture_scores(picture, truth, prefix)[column]
            )
            if again != stored and not abs(again - stored) <= PSNR_AGREEMENT:
                problems.append(f"view {scored.name}: {column} is {stored:.4f}, computed again {again:.4f}")
    return problems
