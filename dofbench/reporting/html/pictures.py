"""Truth, predictions and error maps as pictures inside the page, kept within a stated size."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError, Status
from dofbench.core.images import read_image, resize, to_8bit
from dofbench.reporting.html.boards import Board
from dofbench.reporting.truth_images import find_dataset, prediction_file, true_picture
from dofbench.results.collecting import Entry, grouped
from dofbench.results.columns import COLUMNS
from dofbench.scoring.error_maps import FULL_SCALE
from dofbench.scoring.evaluate import PREFIX, Kind

BUDGET_MB = 12  # of pictures in one page, as base64
SIDES = (720, 504, 360, 252)  # px of a picture's longer side: the first with which all of them fit
QUALITY = 85  # of WebP
TITLES: dict[Kind, str] = {
    "refocus": "through the view's own lens",
    "all_in_focus": "all in focus",
    "photograph": "through the lens fitted on the other half of its tiles",
    "across": "by the learned aperture scaled, in focus as fitted on the other half",
}
NOT_THERE = "the picture isn't beside the result, or isn't the one that was scored"
_SHOWN = ("psnr", "ssim", "flip")


class TooLarge(Exception):
    """The pictures don't fit at this size."""


@dataclass(frozen=True)
class Gallery:
    """data: for the page's script. said: their size and quality, and what had to be left out."""

    data: list[dict[str, Any]]
    said: str


def gallery(boards: Sequence[Board], budget_mb: float = BUDGET_MB) -> Gallery:
    """The pictures of every board: all test views as large as fits, else fewer views at the smallest size."""
    every = max((len(_views(board)) for board in boards), default=0)
    attempts = [(side, every) for side in SIDES]
    views = every // 2
    while views:
        attempts.append((SIDES[-1], views))
        views //= 2
    for side, count in attempts:
        packer = _Packer(side, budget_mb * 1e6)
        try:
            data = [_board(board, packer, count) for board in boards]
        except TooLarge:
            continue
        return Gallery([one for one in data if one is not None], _said(packer, count, every))
    return Gallery([], f"No pictures: not even one view of each dataset fits into {budget_mb:g} MB.")


class _Packer:
    """Makes data URIs, and counts their bytes."""

    def __init__(self, side: int, budget: float):
        self.side, self._budget, self.bytes, self.pictures, self.shrunk = side, budget, 0, 0, 0

    def uri(self, image: np.ndarray) -> str:
        """image: (H, W, 3), encoded. Raises TooLarge."""
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

    def file(self, path: Path | None) -> str | None:
        """Of a PNG; None for none."""
        return None if path is None else self.uri(read_image(path))


def _said(packer: _Packer, count: int, every: int) -> str:
    if not packer.pictures:
        return ""
    size = f"WebP at quality {QUALITY}, " + (
        f"{packer.shrunk} of {packer.pictures} shrunk to {packer.side} px on the longer side"
        if packer.shrunk
        else "at their own size"
    )
    fewer = (
        f"; only {count} of up to {every} test views of each dataset, so that the page stays small"
        if count < every
        else ""
    )
    return (
        f"{packer.pictures} pictures, {packer.bytes / 1e6:.1f} MB, {size}{fewer}. They are for looking; every "
        "score is of the PNG files beside the results."
    )


def _board(board: Board, packer: _Packer, count: int) -> dict[str, Any] | None:
    shown = _shown(board)
    if not shown:
        return None
    dataset, trouble = find_dataset(entry for _, entry in shown)
    views = []
    names = _views(board)
    for name in names[:: max(1, -(-len(names) // count))] if count else ():
        kinds = {}
        for kind in PREFIX:
            runs = list(_runs(shown, kind, name, packer))
            if not any(run["picture"] for run in runs):
                continue
            truth, reason = None, trouble
            if dataset is not None:
                try:
                    truth = packer.uri(true_picture(dataset, kind, dataset.view(name)))
                except InputError as error:
                    reason = str(error)
            kinds[kind] = {"title": TITLES[kind], "truth": truth, "reason": reason, "runs": runs}
        if kinds:
            views.append({"name": name, "lens": _lens(shown[0][1], name), "kinds": kinds})
    return {"board": f"{board.name}, {board.kind}", "views": views, "full_scale": FULL_SCALE} if views else None


def _shown(board: Board) -> list[tuple[str, Entry]]:
    """(name, its first seed that ended well) of each variant."""
    found = []
    for variant, seeds in grouped(list(board.members), "variant").items():
        good = [entry for entry in seeds if entry.status is Status.OK and entry.result and entry.result.views]
        if good:
            line = board.lines[variant]
            found.append((f"{line.method} {line.preset}, seed {good[0].spec.seed}", good[0]))
    return found


def _views(board: Board) -> list[str]:
    return list(dict.fromkeys(view.name for entry in board.members if entry.result for view in entry.result.views))


def _runs(shown: list[tuple[str, Entry]], kind: Kind, view: str, packer: _Packer) -> Iterator[dict[str, Any]]:
    for name, entry in shown:
        picture = packer.file(prediction_file(entry, kind, view))
        missing = entry.left_out.get(f"{PREFIX[kind]}psnr", NOT_THERE)
        yield {
            "name": name,
            "picture": picture,
            "reason": "" if picture else missing,
            "error": packer.file(prediction_file(entry, f"{kind}_error", view)),
            # Of the view, whatever the kind: once is enough, beside what is judged by it.
            "resolved": packer.file(prediction_file(entry, "resolved", view)) if kind != "refocus" else None,
            "scores": _scores(entry, kind, view),
        }


def _scores(entry: Entry, kind: Kind, view: str) -> list[list[str]]:
    """[label, value as shown] of one view."""
    scores = next((one.scores for one in entry.result.views if one.name == view), {}) if entry.result else {}
    return [
        [COLUMNS[column].heading, COLUMNS[column].text(scores[column])]
        for column in (PREFIX[kind] + metric for metric in _SHOWN)
        if column in scores
    ]


def _lens(entry: Entry, view: str) -> str:
    lens = (entry.lenses or {}).get("test", {}).get(view)
    return "" if lens is None else f"F {lens[1]:g}, A {lens[0]:g}"
