"""The contact sheet: a few views side by side, to see at a glance what the dataset is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from dofbench.images import resize
from dofbench.lens import DisparityRange
from dofbench.synthesis.disparity import disparity_of
from dofbench.synthesis.schema import ViewRecord

_ROWS = 6
_THUMB = 320          # pixels, longest side of a picture
_GAP, _MARGIN = 10, 18
_CAPTION = 26         # pixels, height of the line under a picture
_HEADER = 70
_BAR = 8              # pixels, height of a colour bar
_PAPER, _INK, _FAINT = (250, 250, 248), (30, 30, 34), (110, 110, 116)
_UNKNOWN = (190, 190, 190)
_COLUMNS = ("all in focus", "depth", "CoC radius", "shallow")


@dataclass(frozen=True, eq=False)
class SheetRow:
    """One view. sharp, shallow: (H, W, 3) uint8, encoded; depth: (H, W) float32, scene units, 0 unknown."""

    record: ViewRecord
    sharp: np.ndarray
    depth: np.ndarray
    shallow: np.ndarray


def choose_rows(records: Sequence[ViewRecord], count: int = _ROWS) -> list[ViewRecord]:
    """A few views that show different lenses: at most `count`, one of them a test view where there is any.

    Greedy by novelty: first views whose (A, F) is new, in name order, then whatever is left.
    """
    training = [record for record in records if record.split == "train"]
    testing = [record for record in records if record.split == "test"]
    chosen: list[ViewRecord] = []
    for pool, room in ((training, count - bool(testing)), (testing, count)):
        seen = {(record.aperture, record.focus) for record in chosen}
        fresh, others = [], []
        for record in pool:
            lens = (record.aperture, record.focus)
            (others if lens in seen else fresh).append(record)
            seen.add(lens)
        chosen += (fresh + others)[: max(0, room - len(chosen))]
    return sorted(chosen, key=lambda record: record.name)


def contact_sheet(title: str, rows: Sequence[SheetRow], disparity_range: DisparityRange) -> np.ndarray:
    """Draw the sheet; (H, W, 3) uint8.

    Depth is drawn as normalised disparity, the CoC radius up to the largest one on the sheet, each
    with its colour bar. Grey is unknown depth.
    """
    width, height = _thumb_size(rows)
    most = max([row.record.max_coc_px for row in rows] + [1.0])
    sheet = np.empty(
        (_HEADER + len(rows) * (height + _CAPTION + _GAP) + _MARGIN,
         2 * _MARGIN + len(_COLUMNS) * width + (len(_COLUMNS) - 1) * _GAP, 3), np.uint8,
    )
    sheet[:] = _PAPER
    lefts = [_MARGIN + column * (width + _GAP) for column in range(len(_COLUMNS))]
    _write(sheet, title, lefts[0], 26, scale=0.62, room=sheet.shape[1] - 2 * _MARGIN)
    for left, name in zip(lefts, _COLUMNS, strict=True):
        _write(sheet, name, left, 56, scale=0.46, room=width)
    _bar(sheet, lefts[1], width, cv2.COLORMAP_VIRIDIS, "far", "near")
    _bar(sheet, lefts[2], width, cv2.COLORMAP_INFERNO, "0", f"{most:.1f} px")
    for index, row in enumerate(rows):
        top = _HEADER + index * (height + _CAPTION + _GAP)
        known = row.depth > 0
        disparity = disparity_of(row.depth)
        radius = np.abs(row.record.lens.physical(disparity_range, row.depth.shape[1])
                        .signed_radius(disparity, row.depth.shape[1]))
        pictures = (
            row.sharp,
            _coloured(disparity_range.normalise(disparity), known, cv2.COLORMAP_VIRIDIS),
            _coloured(radius / most, known, cv2.COLORMAP_INFERNO),
            row.shallow,
        )
        record = row.record
        captions = (
            f"{record.name}  ({record.split})",
            f"z {row.depth[known].min():.3g} to {row.depth[known].max():.3g}" if known.any() else "unknown",
            f"up to {record.max_coc_px:.1f} px",
            f"A {record.aperture:.3g}   F {record.focus:.3g}",
        )
        for left, picture, caption in zip(lefts, pictures, captions, strict=True):
            sheet[top : top + height, left : left + width] = resize(picture, width, height)
            _write(sheet, caption, left, top + height + 17, scale=0.42, room=width, colour=_FAINT)
    return sheet


def _thumb_size(rows: Sequence[SheetRow]) -> tuple[int, int]:
    """Width and height of the pictures: the first view's aspect ratio, never above _THUMB, small views enlarged."""
    height, width = rows[0].sharp.shape[:2]
    scale = _THUMB / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def _coloured(values: np.ndarray, known: np.ndarray, colours: int) -> np.ndarray:
    """Values 0 ... 1 in the colours of an OpenCV map, RGB; grey where not known."""
    levels = np.round(np.clip(values, 0.0, 1.0) * 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, colours)[..., ::-1].copy()
    picture[~known] = _UNKNOWN
    return picture


def _bar(sheet: np.ndarray, left: int, width: int, colours: int, low: str, high: str) -> None:
    """A colour bar at the right of a column's heading, with what its ends mean."""
    length, top = width // 4, 47
    right = left + width - _text_width(high, 0.38) - 4
    ramp = np.linspace(0, 1, length)[None].repeat(_BAR, axis=0)
    sheet[top : top + _BAR, right - length : right] = _coloured(ramp, np.ones_like(ramp, dtype=bool), colours)
    _write(sheet, low, right - length - _text_width(low, 0.38) - 4, 56, scale=0.38, room=width, colour=_FAINT)
    _write(sheet, high, right + 4, 56, scale=0.38, room=width, colour=_FAINT)


def _text_width(text: str, scale: float) -> int:
    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]


def _write(
    sheet: np.ndarray, text: str, left: int, baseline: int, *, scale: float, room: int,
    colour: tuple[int, int, int] = _INK,
) -> None:
    """Write a line that is shrunk to fit in `room` pixels. The font has ASCII only; other letters come out as '?'."""
    wide = _text_width(text, scale)
    fitted = scale * min(1.0, room / wide) if wide else scale
    cv2.putText(sheet, text, (left, baseline), cv2.FONT_HERSHEY_SIMPLEX, fitted, colour, 1, cv2.LINE_AA)
