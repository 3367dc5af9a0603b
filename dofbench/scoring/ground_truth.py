"""Which truth a dataset has to score against. A score is a mean over all test views, or all training views, so it takes
the truth of every one of them: a mean over those that happen to have it would stand for no set that anyone named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.dataset.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.results.protocol import ACROSS_COLUMNS, PHOTOGRAPH_COLUMNS
from dofbench.scenes.by_exif import same_f_number
from dofbench.scenes.folders import listed

NO_TEST_VIEWS = "the dataset has no test views"
NO_EXACT_DEPTH = "the dataset's own depth is an estimate, no truth to compare with"


@dataclass(frozen=True)
class MissingTruth:
    """Why a kind of score can't be had, one line; empty where it can.

    refocus: through test views' lenses. all_in_focus: against test views' sharp photographs. lens: of the training
    views' learned lenses. depth: of the depth rendered at test views.
    """

    refocus: str
    all_in_focus: str
    lens: str
    depth: str


def missing_truth(dataset: BenchmarkDataset) -> MissingTruth:
    """Look at what the dataset has of its views."""
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
    """Whether the test views are photographs of unknown lens, and there is no sharp one of any: the photographs
    themselves are all that there is to score against. False without test views."""
    test = dataset.test_views()
    return bool(test) and not any(view.lens is not None or view.has_all_in_focus for view in test)


def photograph_columns(dataset: BenchmarkDataset) -> tuple[str, ...]:
    """The columns that test views of unknown lens are scored by; none where they have a lens or a sharp photograph."""
    if not of_photographs(dataset):
        return ()
    return ACROSS_COLUMNS if training_f_number(dataset) is not None else PHOTOGRAPH_COLUMNS


def training_f_number(dataset: BenchmarkDataset) -> float | None:
    """The f-number of all training views, where it is one, and every test view has another one, by the EXIF of each;
    else None. Aperture is to be carried from the ones to the others, so focal lengths must not be known to differ."""
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
    """As "no test lens", or "no test lens of 2 of 5 test views: v1, v3"."""
    if not without:
        return ""
    if len(without) == len(views):
        return f"no {what}"
    return f"no {what} of {len(without)} of {len(views)} {split} views: {listed(view.name for view in without)}"
