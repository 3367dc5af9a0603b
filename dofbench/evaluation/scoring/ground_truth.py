"""The ground truth of a dataset. A score is a mean over all test (or training) views, so it needs that of every
view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.evaluation.results.protocol import ACROSS_COLUMNS, PHOTOGRAPH_COLUMNS
from dofbench.scenes.readers.exif_files import same_f_number
from dofbench.scenes.readers.folders import listed

NO_TEST_VIEWS = "the dataset has no test views"
NO_EXACT_DEPTH = "the dataset's depth is an estimate"


@dataclass(frozen=True)
class MissingTruth:
    """Why a kind of score isn't possible, one line each; "" if it is.

    refocus: renderings with the test views' lenses. all_in_focus: comparison with the test views' all-in-focus images.
    lens: errors of the training views' learned lenses. depth: errors of the test views' rendered depth.
    """

    refocus: str
    all_in_focus: str
    lens: str
    depth: str


def missing_truth(dataset: BenchmarkDataset) -> MissingTruth:
    """The missing ground truth of a dataset."""
    train = dataset.training_views()
    test = dataset.test_views()
    lens = _lacking("true lens", train, [view for view in train if view.lens is None], "training")
    if not test:
        return MissingTruth(NO_TEST_VIEWS, NO_TEST_VIEWS, lens, NO_TEST_VIEWS)
    depth = _lacking("depth", test, [view for view in test if not view.has_depth], "test")
    return MissingTruth(
        refocus=_lacking("test lens", test, [view for view in test if view.lens is None], "test"),
        all_in_focus=_lacking("sharp photograph", test, [view for view in test if not view.has_all_in_focus], "test"),
        lens=lens,
        depth=depth or ("" if dataset.has_exact_depth else NO_EXACT_DEPTH),
    )


def of_photographs(dataset: BenchmarkDataset) -> bool:
    """Whether all test views are real photographs of unknown lens without an all-in-focus image; False without any."""
    test = dataset.test_views()
    return bool(test) and not any(view.lens is not None or view.has_all_in_focus for view in test)


def photograph_columns(dataset: BenchmarkDataset) -> tuple[str, ...]:
    """The columns for test views of unknown lens; none if they have a lens or an all-in-focus image."""
    if not of_photographs(dataset):
        return ()
    return ACROSS_COLUMNS if training_f_number(dataset) is not None else PHOTOGRAPH_COLUMNS


def training_f_number(dataset: BenchmarkDataset) -> float | None:
    """The f-number of all training views, if every test view has another one; else None, also for different focal
    lengths, whose apertures aren't in the ratio of the f-numbers."""
    numbers: dict[str, list[float]] = {"train": [], "test": []}
    lengths = set()
    for view in dataset.views:
        if view.split not in numbers:
            continue
        if view.exif is None or view.exif.f_number is None:
            return None
        numbers[view.split].append(view.exif.f_number)
        lengths |= {view.exif.focal_length} - {None}
    if not numbers["train"] or not numbers["test"] or len(lengths) > 1:
        return None
    first = numbers["train"][0]
    one = all(same_f_number(number, first) for number in numbers["train"])
    return first if one and not any(same_f_number(number, first) for number in numbers["test"]) else None


def _lacking(what: str, views: Sequence[BenchmarkView], without: Sequence[BenchmarkView], split: str) -> str:
    """A text such as "no test lens", or "no test lens of 2 of 5 test views: v1, v3"."""
    if not without:
        return ""
    if len(without) == len(views):
        return f"no {what}"
    return f"no {what} of {len(without)} of {len(views)} {split} views: {listed(view.name for view in without)}"
