"""Is a result what it says it is? Schema, key, checksums, and a score computed again from the pictures."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console

from dofbench.errors import InputError, Status
from dofbench.files import sha256_file
from dofbench.harness.evaluate import PREFIX
from dofbench.harness.protocol import PROTOCOLS, arithmetic_mean
from dofbench.harness.result import RESULT_FILE, Result, read_result
from dofbench.images import read_image
from dofbench.metrics import score_image
from dofbench.synthesis.dataset import Dataset

# The pictures hold exactly what was scored (8 bits), so only the order of summation may differ.
PSNR_AGREEMENT = 1e-4  # dB
MEAN_AGREEMENT = 1e-9  # relative, between a mean and the per-view values that it was taken of


def check(path: Path, console: Console | None = None) -> bool:
    """Check a dataset, a result, or every result below a folder; print what is wrong. True when nothing is.

    Raises InputError when there is neither at `path`.
    """
    console = console or Console()
    if not path.exists():
        raise InputError(path, "no such file or folder", "a dataset, a result or a folder of results")
    folder = path if path.is_dir() else path.parent
    if (folder / "dataset.json").is_file():
        from dofbench.synthesis.verify import check_dataset

        problems = {folder: check_dataset(folder)}
    else:
        results = sorted(file.parent for file in folder.rglob(RESULT_FILE))
        if not results:
            raise InputError(path, f"neither dataset.json nor {RESULT_FILE}", "a dataset or a folder of results")
        problems = {result: check_result(result) for result in results}
    for subject, found in problems.items():
        for problem in found:
            console.print(f"{subject}: {problem}", highlight=False, markup=False, soft_wrap=True)
        if not found:
            console.print(f"{subject}: good", highlight=False, markup=False, soft_wrap=True)
    return not any(problems.values())


def check_result(folder: Path) -> list[str]:
    """What is wrong with the result in `folder`, one line each; an empty list when nothing is.

    Where the dataset is at the place that the result names, and is the same one, PSNR is computed
    again from the saved pictures; where it isn't, that is not a fault of the result, and only the
    other checks are made.
    """
    try:
        result = read_result(folder)
    except InputError as error:
        return [str(error)]
    problems = []
    if result.spec.key != result.key:
        problems.append(f"the key is {result.key[:8]}…, the spec's hash {result.spec.key[:8]}…")
    known = PROTOCOLS.get(result.spec.protocol)
    if known is None:
        problems.append(f"unknown protocol {result.spec.protocol!r}, expected one of {', '.join(PROTOCOLS)}")
    problems += _pictures(folder, result)
    problems += _means(result)
    if result.status is Status.OK:
        expected = result.plan.get("columns", [])
        problems += [f"no score {column}, though the plan has it" for column in expected
                     if column not in result.scores and column not in result.left_out]
    if not problems:
        problems += _scores_again(folder, result)
    return problems


def _pictures(folder: Path, result: Result) -> list[str]:
    problems = []
    for name, checksum in result.predictions.items():
        file = folder / name
        if not file.resolve().is_relative_to(folder.resolve()):
            problems.append(f"{name}: outside of the result's folder")
        elif not file.is_file():
            problems.append(f"{name}: missing")
        elif sha256_file(file) != checksum:
            problems.append(f"{name}: not the file that was scored (its sha256 is another one)")
    return problems


def _means(result: Result) -> list[str]:
    """The table's numbers must be the means of the values below them."""
    problems = []
    for column in (result.views[0].scores if result.views else {}):
        mean = arithmetic_mean([view.scores[column] for view in result.views])
        problems += _differing(column, result.scores.get(column), mean)
    for column in ("delta_a", "delta_f") if result.lens else ():
        mean = arithmetic_mean([getattr(view, column) for view in result.lens])
        problems += _differing(column, result.scores.get(column), mean)
    return problems


def _differing(column: str, stored: float | None, mean: float) -> list[str]:
    if stored is None:
        return [f"{column}: no mean, though there are per-view values"]
    same = stored == mean or (math.isnan(stored) and math.isnan(mean))
    if same or math.isclose(stored, mean, rel_tol=MEAN_AGREEMENT, abs_tol=MEAN_AGREEMENT):
        return []
    return [f"{column}: {stored:.6g} is not the mean of the per-view values, {mean:.6g}"]


def _scores_again(folder: Path, result: Result) -> list[str]:
    data = Path(result.data)
    if not (data / "dataset.json").is_file():
        return []
    dataset = Dataset.load(data)
    if dataset.checksum != result.spec.dataset_checksum:
        return []
    problems = []
    test = {view.name: view for view in dataset.views if view.split == "test"}
    for scored in result.views:
        if scored.name not in test:
            problems.append(f"view {scored.name}: not a test view of {data}")
            continue
        for kind, prefix in PREFIX.items():
            column, file = f"{prefix}psnr", folder / "predictions" / kind / f"{scored.name}.png"
            stored = scored.scores.get(column)
            if stored is None or math.isnan(stored):
                continue
            truth = (dataset.image if kind == "refocus" else dataset.all_in_focus)(test[scored.name])
            again = score_image(read_image(file), truth, ["psnr"])["psnr"]
            if again != stored and not abs(again - stored) <= PSNR_AGREEMENT:
                problems.append(f"view {scored.name}: {column} is {stored:.4f}, computed again {again:.4f}")
    return problems
