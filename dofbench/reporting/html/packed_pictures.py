"""Pictures embedded in the page, within a given total size."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.images import read_image, resize, to_8bit
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.reporting.gallery import BoardPictures, KindPictures

BUDGET_MB = 12  # MB of pictures in one page, as base64
SIDES = (720, 504, 360, 252)  # px, longer side of pictures: the first size is used with which all pictures fit
QUALITY = 85  # of WebP


class TooLarge(Exception):
    """The pictures don't fit at this size."""


@dataclass(frozen=True)
class Packed:
    """Embedded pictures. data: for the page's script. said: a sentence on their size and quality, and on what was left
    out."""

    data: list[dict[str, Any]]
    said: str


def packed(boards: Sequence[BoardPictures], budget_mb: float = BUDGET_MB) -> Packed:
    """The pictures of every board: all test views at the largest size that fits, else fewer views at the smallest
    size."""
    boards = [board for board in boards if board.views]
    every = max((len(board.views) for board in boards), default=0)
    if not every:
        return Packed([], "")
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
        return Packed(data, _said(packer, count, every))
    return Packed([], f"No pictures: not even one view of each dataset fits into {budget_mb:g} MB.")


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
        """The data URI of a PNG file; None for None."""
        return None if path is None else self.uri(read_image(path))


def _said(packer: _Packer, count: int, every: int) -> str:
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


def _board(board: BoardPictures, packer: _Packer, count: int) -> dict[str, Any]:
    views = [
        {"name": view.name, "lens": view.lens, "kinds": {one.kind: _kind(one, packer) for one in view.kinds}}
        for view in board.views[:: max(1, -(-len(board.views) // count))]
    ]
    return {"board": board.board, "views": views, "full_scale": FULL_SCALE}


def _kind(pictures: KindPictures, packer: _Packer) -> dict[str, Any]:
    runs = [
        {
            "name": run.name,
            "picture": packer.file(run.picture),
            "reason": run.reason,
            "error": packer.file(run.error),
            "resolved": packer.file(run.resolved),
            "scores": run.scores,
        }
        for run in pictures.runs
    ]
    truth = packer.uri(pictures.truth.read()) if pictures.truth is not None else None
    return {"title": pictures.title, "truth": truth, "reason": pictures.reason, "runs": runs}
