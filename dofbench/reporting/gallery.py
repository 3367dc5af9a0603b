"""Lists the pictures of test views by file: truths, predictions and error maps; with the reason if one is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError, Status
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.scoring.evaluate import PREFIX, Kind
from dofbench.reporting.boards import Board
from dofbench.reporting.truth_images import find_dataset, prediction_file, require_truth, true_picture

TITLES: dict[Kind, str] = {
    "refocus": "through the view's own lens",
    "all_in_focus": "all in focus",
    "photograph": "through the lens fitted on the other half of its tiles",
    "across": "by the learned aperture scaled, in focus as fitted on the other half",
}
NOT_THERE = "the picture isn't beside the result, or isn't the one that was scored"
_SHOWN = ("psnr", "ssim", "flip")


@dataclass(frozen=True)
class Truth:
    """The picture that the predictions of a view were compared with."""

    dataset: Dataset
    kind: Kind
    view: str

    def read(self) -> np.ndarray:
        """(H, W, 3), encoded. Raises InputError when it has changed since the report was built."""
        return true_picture(self.dataset, self.kind, self.dataset.view(self.view))


@dataclass(frozen=True)
class RunPictures:
    """The pictures of one run and view. picture, error, resolved: PNG files, or None. reason: why there is no picture.
    scores: (heading, value) as shown."""

    name: str
    picture: Path | None
    reason: str
    error: Path | None
    resolved: Path | None
    scores: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class KindPictures:
    """One kind of prediction of a view. truth: None if it is missing, for the `reason`."""

    kind: Kind
    title: str
    truth: Truth | None
    reason: str
    runs: tuple[RunPictures, ...]


@dataclass(frozen=True)
class ViewPictures:
    """One test view. lens: a text such as "F 0.2, A 1", "" if it is unknown."""

    name: str
    lens: str
    kinds: tuple[KindPictures, ...]


@dataclass(frozen=True)
class BoardPictures:
    """The test views of one board that have a picture. trouble: the reason if no view has one."""

    board: str
    views: tuple[ViewPictures, ...]
    trouble: str


def gallery(boards: Sequence[Board]) -> tuple[BoardPictures, ...]:
    """The pictures of every board, by the first seed of each row whose run ended well."""
    return tuple(_board(board) for board in boards)


def _board(board: Board) -> BoardPictures:
    shown = _shown(board)
    if not shown:
        return BoardPictures(board.title, (), "no run has predictions")
    views = tuple(_views(board, shown))
    return BoardPictures(board.title, views, "" if views else "the predictions aren't beside the results")


def _views(board: Board, shown: list[tuple[str, Entry]]) -> Iterator[ViewPictures]:
    dataset, trouble = find_dataset(entry for _, entry in shown)
    names = dict.fromkeys(view.name for entry in board.members if entry.result for view in entry.result.views)
    for name in names:
        kinds = []
        for kind in PREFIX:
            runs = tuple(_run(title, entry, kind, name) for title, entry in shown)
            if any(run.picture for run in runs):
                truth, reason = _truth(dataset, kind, name) if dataset is not None else (None, trouble)
                kinds.append(KindPictures(kind, TITLES[kind], truth, reason, runs))
        if kinds:
            yield ViewPictures(name, _lens(shown[0][1], name), tuple(kinds))


def _shown(board: Board) -> list[tuple[str, Entry]]:
    """(name, first seed whose run ended well) of each variant."""
    found = []
    for variant, seeds in board.variants.items():
        good = [entry for entry in seeds if entry.status is Status.OK and entry.result and entry.result.views]
        if good:
            line = board.lines[variant]
            found.append((f"{line.method} {line.preset}, seed {good[0].spec.seed}", good[0]))
    return found


def _truth(dataset: Dataset, kind: Kind, view: str) -> tuple[Truth | None, str]:
    try:
        require_truth(dataset, kind, dataset.view(view))
    except InputError as error:
        return None, str(error)
    return Truth(dataset, kind, view), ""


def _run(name: str, entry: Entry, kind: Kind, view: str) -> RunPictures:
    picture = prediction_file(entry, kind, view)
    return RunPictures(
        name,
        picture,
        "" if picture else entry.left_out.get(f"{PREFIX[kind]}psnr", NOT_THERE),
        prediction_file(entry, f"{kind}_error", view),
        # The resolved map depends on the view alone, so it is shown only once, not beside the refocused prediction.
        prediction_file(entry, "resolved", view) if kind != "refocus" else None,
        _scores(entry, kind, view),
    )


def _scores(entry: Entry, kind: Kind, view: str) -> tuple[tuple[str, str], ...]:
    scores = next((one.scores for one in entry.result.views if one.name == view), {}) if entry.result else {}
    return tuple(
        (COLUMNS[column].heading, COLUMNS[column].text(scores[column]))
        for column in (PREFIX[kind] + metric for metric in _SHOWN)
        if column in scores
    )


def _lens(entry: Entry, view: str) -> str:
    lens = (entry.lenses or {}).get("test", {}).get(view)
    return "" if lens is None else f"F {lens[1]:g}, A {lens[0]:g}"
