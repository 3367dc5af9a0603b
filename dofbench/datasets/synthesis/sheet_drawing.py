"""Drawing of pictures in rows and columns, with captions and colour bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dofbench.core.images import resize

_THUMB = 320  # pixels, longest side of a picture
_GAP, _MARGIN = 10, 18
_CAPTION = 26  # pixels, height of the line under a picture
_HEADER = 70
_BAR = 8  # pixels, height of a colour bar
_PAPER, _INK, _FAINT = (250, 250, 248), (30, 30, 34), (110, 110, 116)
_UNKNOWN = (190, 190, 190)


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture with its caption. picture: (H, W, 3) uint8; None for a missing picture, which is drawn grey. caption:
    the line below."""

    picture: np.ndarray | None
    caption: str

    def resized(self, size: tuple[int, int]) -> Panel:
        """The panel with its picture at this width and height."""
        return self if self.picture is None else replace(self, picture=resize(self.picture, *size))


@dataclass(frozen=True)
class Column:
    """A column. heading: its title. colours: an OpenCV colour map for a colour bar. ends: labels of the bar's two
    ends."""

    name: str
    colours: int | None = None
    ends: tuple[str, str] = ("", "")


def draw(title: str, columns: Sequence[Column], rows: Sequence[Sequence[Panel]], size: tuple[int, int]) -> np.ndarray:
    """Draw the panels below their headings; (H, W, 3) uint8. size: width and height of every picture."""
    width, height = size
    sheet = np.empty(
        (
            _HEADER + len(rows) * (height + _CAPTION + _GAP) + _MARGIN,
            2 * _MARGIN + len(columns) * width + (len(columns) - 1) * _GAP,
            3,
        ),
        np.uint8,
    )
    sheet[:] = _PAPER
    lefts = [_MARGIN + column * (width + _GAP) for column in range(len(columns))]
    _write(sheet, title, lefts[0], 26, scale=0.62, room=sheet.shape[1] - 2 * _MARGIN)
    for left, column in zip(lefts, columns, strict=True):
        _write(sheet, column.name, left, 56, scale=0.46, room=width)
        if column.colours is not None:
            _bar(sheet, left, width, column.colours, *column.ends)
    for index, row in enumerate(rows):
        top = _HEADER + index * (height + _CAPTION + _GAP)
        for left, panel in zip(lefts, row, strict=True):
            sheet[top : top + height, left : left + width] = _UNKNOWN if panel.picture is None else panel.picture
            _write(sheet, panel.caption, left, top + height + 17, scale=0.42, room=width, colour=_FAINT)
    return sheet


def thumb_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of all pictures: with the aspect ratio of an image of this size and a longest side of _THUMB;
    small pictures are enlarged."""
    scale = _THUMB / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def coloured(values: np.ndarray, known: np.ndarray, colours: int) -> np.ndarray:
    """Values 0 ... 1 in the colours of an OpenCV map, RGB; grey where not known."""
    levels = np.round(np.clip(values, 0.0, 1.0) * 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, colours)[..., ::-1].copy()
    picture[~known] = _UNKNOWN
    return picture


def _bar(sheet: np.ndarray, left: int, width: int, colours: int, low: str, high: str) -> None:
    """A colour bar at the right of a column's heading, with the labels of its ends."""
    length, top = width // 4, 47
    right = left + width - _text_width(high, 0.38) - 4
    ramp = np.linspace(0, 1, length)[None].repeat(_BAR, axis=0)
    sheet[top : top + _BAR, right - length : right] = coloured(ramp, np.ones_like(ramp, dtype=bool), colours)
    _write(sheet, low, right - length - _text_width(low, 0.38) - 4, 56, scale=0.38, room=width, colour=_FAINT)
    _write(sheet, high, right + 4, 56, scale=0.38, room=width, colour=_FAINT)


def _text_width(text: str, scale: float) -> int:
    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]


def _write(
    sheet: np.ndarray,
    text: str,
    left: int,
    baseline: int,
    *,
    scale: float,
    room: int,
    colour: tuple[int, int, int] = _INK,
) -> None:
    """Write a line that is shrunk to fit in `room` pixels. The font has ASCII only; other letters come out as '?'."""
    wide = _text_width(text, scale)
    fitted = scale * min(1.0, room / wide) if wide else scale
    cv2.putText(sheet, text, (left, baseline), cv2.FONT_HERSHEY_SIMPLEX, fitted, colour, 1, cv2.LINE_AA)
