"""Pictures of test views: truth, predictions and error maps, as files and as embedded in the page.

A file whose checksum isn't the one in the result is not shown; the reason is.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dofbench.core.errors import InputError, Status
from dofbench.core.images import read_image, resize, to_8bit
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.evaluation.scoring.evaluate import PREFIX, Kind
from dofbench.reporting.boards import Board
from dofbench.running.load_run import LoadedRun, loaded

TITLES: dict[Kind, str] = {
    "refocus": "through the view's own lens",
    "all_in_focus": "all in focus",
    "photograph": "lens fitted on half of the tiles",
    "across": "learned aperture scaled, focus fitted on half of the tiles",
}
NOT_THERE = "the picture isn't next to the result, or isn't the one that was scored"
BUDGET_MB = 12  # MB of pictures in one page, as base64
SIDES = (720, 504, 360, 252)  # px, longer side of pictures: the first size is used with which all pictures fit
QUALITY = 85  # of WebP
_SHOWN = ("psnr", "ssim", "flip")


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
    """One kind of prediction of a view. truth: reads the picture that predictions were compared with, (H, W, 3),
    encoded; None if it is missing, for the `reason`."""

    kind: Kind
    title: str
    truth: Callable[[], np.ndarray] | None
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
    trouble: str = ""


# ---- files ----


def gallery(board: Board) -> BoardPictures:
    """The pictures of a board, by the first seed of each row whose run ended well."""
    shown = list(_shown(board))
    if not shown:
        return BoardPictures(board.title, (), "no run has predictions")
    views = tuple(_views(board, shown))
    return BoardPictures(board.title, views, "" if views else "the predictions aren't next to the results")


def _shown(board: Board) -> Iterator[tuple[str, Entry, LoadedRun]]:
    """(name, entry, run) of each variant's first seed whose run ended well."""
    for variant, seeds in board.variants.items():
        for entry in seeds:
            if entry.status is Status.OK and entry.result and entry.result.views:
                line = board.lines[variant]
                yield f"{line.name}, seed {entry.spec.seed}", entry, loaded(entry.folder, entry.result)
                break


def _views(board: Board, shown: Sequence[tuple[str, Entry, LoadedRun]]) -> Iterator[ViewPictures]:
    dataset, trouble = _dataset([run for _, _, run in shown])
    lenses = (shown[0][1].lenses or {}).get("test", {})
    for name in dict.fromkeys(view.name for entry in board.members if entry.result for view in entry.result.views):
        kinds = []
        for kind in PREFIX:
            runs = tuple(_run(*one, kind, name) for one in shown)
            if any(run.picture for run in runs):
                truth, reason = _truth(dataset, kind, name) if dataset is not None else (None, trouble)
                kinds.append(KindPictures(kind, TITLES[kind], truth, reason, runs))
        if kinds:
            lens = lenses.get(name)
            yield ViewPictures(name, "" if lens is None else f"F {lens[1]:g}, A {lens[0]:g}", tuple(kinds))


def _dataset(runs: Sequence[LoadedRun]) -> tuple[Dataset | None, str]:
    """(the dataset that these runs were scored on, "") or (None, why it can't be used)."""
    reason = ""
    for run in runs:
        try:
            return run.dataset, ""
        except InputError as error:
            reason = f"the dataset {run.result.spec.dataset} can't be used: {error}"
    return None, reason


def _truth(dataset: Dataset, kind: Kind, name: str) -> tuple[Callable[[], np.ndarray] | None, str]:
    """(reads the picture that predictions of this kind were compared with, "") or (None, why it can't be used)."""
    view = dataset.view(name)
    file: Literal["image", "all_in_focus"] = "all_in_focus" if kind == "all_in_focus" else "image"

    def read() -> np.ndarray:
        dataset.require_intact(view, file)
        picture = dataset.all_in_focus(view) if kind == "all_in_focus" else dataset.image(view)
        if picture is None:
            raise InputError(f"view {view.name} of {dataset.name}", "no all-in-focus image", "one to compare with")
        return picture

    try:
        dataset.require_intact(view, file)
    except InputError as error:
        return None, str(error)
    return read, ""


def _run(name: str, entry: Entry, run: LoadedRun, kind: Kind, view: str) -> RunPictures:
    def file(folder: str) -> Path | None:
        try:
            return run.prediction(folder, view)
        except InputError:
            return None

    picture = file(kind)
    reason = "" if picture else entry.left_out.get(f"{PREFIX[kind]}psnr", NOT_THERE)
    scores = next((one.scores for one in run.result.views if one.name == view), {})
    columns = [COLUMNS[PREFIX[kind] + metric] for metric in _SHOWN if PREFIX[kind] + metric in scores]
    # The resolved map depends on the view alone, so it is shown only once, not next to the refocused prediction.
    resolved = file("resolved") if kind != "refocus" else None
    shown = tuple((column.heading, column.text(scores[column.id])) for column in columns)
    return RunPictures(name, picture, reason, file(f"{kind}_error"), resolved, shown)


# ---- embedded ----


class TooLarge(Exception):
    """The pictures don't fit at this size."""


@dataclass(frozen=True)
class Packed:
    """Embedded pictures. data: for the page's script. said: a sentence on their size and quality, and on what was
    omitted."""

    data: list[dict[str, Any]] = field(default_factory=list)
    said: str = ""


def packed(boards: Sequence[BoardPictures], budget_mb: float = BUDGET_MB) -> Packed:
    """The pictures of every board: all test views at the largest size that fits, else fewer views at the smallest
    size."""
    boards = [board for board in boards if board.views]
    every = max((len(board.views) for board in boards), default=0)
    if not every:
        return Packed()
    fewer = [every >> halvings for halvings in range(1, every.bit_length())]
    for side, count in (*((side, every) for side in SIDES), *((SIDES[-1], count) for count in fewer)):
        packer = _Packer(side, budget_mb * 1e6)
        try:
            return Packed([packer.board(board, count) for board in boards], packer.said(count, every))
        except TooLarge:
            continue
    return Packed([], f"No pictures: not even one view of each dataset fits into {budget_mb:g} MB.")


class _Packer:
    """Makes data for the page's script with pictures as data URIs, and counts their bytes. Raises TooLarge."""

    def __init__(self, side: int, budget: float):
        self.side, self._budget, self.bytes, self.pictures, self.shrunk = side, budget, 0, 0, 0

    def board(self, board: BoardPictures, count: int) -> dict[str, Any]:
        """At most `count` views, evenly spaced."""
        views = [
            {"name": view.name, "lens": view.lens, "kinds": {one.kind: self._kind(one) for one in view.kinds}}
            for view in board.views[:: max(1, -(-len(board.views) // count))]
        ]
        return {"board": board.board, "views": views, "full_scale": FULL_SCALE}

    def said(self, count: int, every: int) -> str:
        """A sentence on what was packed."""
        shrunk = f"{self.shrunk} of {self.pictures} shrunk to {self.side} px on the longer side"
        fewer = f"; only {count} of up to {every} test views of each dataset, to keep the page small"
        return (
            f"{self.pictures} pictures, {self.bytes / 1e6:.1f} MB, WebP at quality {QUALITY}, "
            f"{shrunk if self.shrunk else 'at their own size'}{fewer if count < every else ''}. Scores are of the PNG "
            "files next to the results."
        )

    def _kind(self, pictures: KindPictures) -> dict[str, Any]:
        runs = [
            {"name": run.name, "reason": run.reason, "scores": run.scores}
            | {name: self._file(getattr(run, name)) for name in ("picture", "error", "resolved")}
            for run in pictures.runs
        ]
        truth = self._uri(pictures.truth()) if pictures.truth is not None else None
        return {"title": pictures.title, "truth": truth, "reason": pictures.reason, "runs": runs}

    def _file(self, path: Path | None) -> str | None:
        return None if path is None else self._uri(read_image(path))

    def _uri(self, image: np.ndarray) -> str:
        """image: (H, W, 3), encoded."""
        import cv2

        height, width = image.shape[:2]
        factor = min(1.0, self.side / max(height, width))
        if factor < 1.0:
            self.shrunk += 1
            image = resize(image, max(1, round(width * factor)), max(1, round(height * factor)))
        done, coded = cv2.imencode(".webp", to_8bit(image)[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        if not done:
            raise RuntimeError("the picture can't be encoded as WebP")
        text = "data:image/webp;base64," + base64.b64encode(coded.tobytes()).decode()
        self.bytes += len(text)
        self.pictures += 1
        if self.bytes > self._budget:
            raise TooLarge
        return text
