"""Is a result what it says it is? Digest, key, checksums, and every score that its pictures and lenses give again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import InputError, Status
from dofbench.core.files import files_below, sha256_file, temporaries
from dofbench.evaluation.results.added_scores import ADDED_FILE, read_added
from dofbench.evaluation.results.result import RESULT_FILE, Result, read_result
from dofbench.evaluation.results.run_lock import at_work, begun_folders
from dofbench.evaluation.scoring.evaluate import PREFIX
from dofbench.evaluation.scoring.result_consistency import added_inconsistencies, inconsistencies
from dofbench.running.execution import TRAINED_FILE
from dofbench.running.load_run import load_run
from dofbench.running.recomputed import differences
from dofbench.scenes.named.library import contradiction


@dataclass(frozen=True)
class Checked:
    """What is wrong with a result, one line each. not_recomputed: why its scores couldn't be computed again; "" where
    they were, or where it has none."""

    problems: list[str]
    not_recomputed: str = ""


def check_result(folder: Path, data: Path | None = None) -> Checked:
    """Check the result in `folder`: its digest, key and checksums, whether its parts agree, and, where its dataset is
    found, every score that its pictures and lenses give again.

    data: where the dataset is; None to look for it (`load_run.find_data`).
    """
    try:
        run = load_run(folder, data)
    except InputError as error:
        return Checked([str(error)])
    result = run.result
    problems = [*inconsistencies(result), *_place(folder, result), *_pictures(folder, result), *_added(folder, result)]
    if said := contradiction(result.role, result.role_by):
        problems.append(said)
    if problems:
        return Checked(problems)
    try:
        return Checked(differences(run))
    except InputError as error:  # gone, or another one by now: no fault of the result
        return Checked([], " ".join(str(error).split()) if result.views or result.lens or result.do_nothing else "")


def result_folders(folder: Path) -> list[Path]:
    """Folders at or below `folder` with a result, or where a run is at work or died."""
    return sorted({*(file.parent for file in files_below(folder, RESULT_FILE)), *begun_folders(folder)})


def check_results(folders: Sequence[Path], say: Callable[[str], None], data: Path | None = None) -> dict[Path, Checked]:
    """Check the result in each folder, as `check_result` does.

    Runs that died and results that are there twice are wrong too. say: told of runs at work, which aren't checked.
    """
    found: dict[Path, Checked] = {}
    keys: dict[str, Path] = {}
    for folder in folders:
        if at_work(folder):
            say(f"{folder}: a run is at work there, not checked")
        elif not (folder / RESULT_FILE).is_file():
            found[folder] = Checked(["a run died here and left no result; its command goes on with it"])
        else:
            found[folder] = check_result(folder, data)
            if not found[folder].problems:
                key = read_result(folder).key
                if (first := keys.setdefault(key, folder)) != folder:
                    found[folder].problems.append(
                        f"the same run as in {first}: counted twice it would be a second seed"
                    )
    return found


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
