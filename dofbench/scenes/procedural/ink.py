"""Draw strokes, discs, rectangles and a stroke alphabet on float images, by NumPy alone.

An imaging library's next version might draw other pixels and so change the scenes. Positions are (x, y) in pixels, y
down; everything is drawn in place with a soft, one-pixel edge and clipped to the image.
"""

from __future__ import annotations

import itertools

import numpy as np

Colour = tuple[float, float, float]
Point = tuple[float, float]

# Letters on a grid 4 wide and 6 tall, y down: one string per stroke, two digits (x, y) per corner.
_LETTERS = {
    "A": ("062046", "1333"),
    "B": ("0006", "003041423303", "3344453606"),
    "C": ("4130100105163645",),
    "D": ("00204244260600",),
    "E": ("40000646", "0333"),
    "F": ("400006", "0333"),
    "G": ("41301001051636454323",),
    "H": ("0006", "4046", "0343"),
    "I": ("2026",),
    "J": ("4045361605",),
    "K": ("0006", "400346"),
    "L": ("000646",),
    "M": ("0600234046",),
    "N": ("06004640",),
    "O": ("103041453616050110",),
    "P": ("06003041423303",),
    "Q": ("103041453616050110", "2446"),
    "R": ("06003041423303", "2346"),
    "S": ("413010010213334445361605",),
    "T": ("0040", "2026"),
    "U": ("000516364540",),
    "V": ("002640",),
    "W": ("0016233640",),
    "X": ("0046", "4006"),
    "Y": ("002340", "2326"),
    "Z": ("00400646",),
    " ": (),
}


def stroke(image: np.ndarray, start: Point, end: Point, width: float, colour: Colour) -> None:
    """A line of `width` pixels with round ends."""
    reach, ends = width / 2 + 1, (start, end)
    low, high = (tuple(least(point[axis] for point in ends) for axis in (0, 1)) for least in (min, max))
    window = _window(image, low[0] - reach, low[1] - reach, high[0] + reach, high[1] + reach)
    if window is None:
        return
    part, x, y = window
    along = np.subtract(end, start)
    length2 = max(float(along @ along), 1e-12)
    t = np.clip(((x - start[0]) * along[0] + (y - start[1]) * along[1]) / length2, 0, 1)
    _paint(part, width / 2 - np.hypot(x - start[0] - t * along[0], y - start[1] - t * along[1]), colour)


def disc(image: np.ndarray, centre: Point, radius: float, colour: Colour) -> None:
    """A filled disc."""
    window = _window(
        image, centre[0] - radius - 1, centre[1] - radius - 1, centre[0] + radius + 1, centre[1] + radius + 1
    )
    if window is not None:
        part, x, y = window
        _paint(part, radius - np.hypot(x - centre[0], y - centre[1]), colour)


def ring(image: np.ndarray, centre: Point, radius: float, width: float, colour: Colour) -> None:
    """A circle's outline, `width` pixels wide."""
    reach = radius + width
    window = _window(image, centre[0] - reach, centre[1] - reach, centre[0] + reach, centre[1] + reach)
    if window is not None:
        part, x, y = window
        _paint(part, width / 2 - np.abs(np.hypot(x - centre[0], y - centre[1]) - radius), colour)


def rectangle(image: np.ndarray, box: tuple[float, float, float, float], colour: Colour) -> None:
    """A filled box = (x, y, width, height)."""
    x, y, width, height = (round(v) for v in box)
    image[max(y, 0) : max(y + height, 0), max(x, 0) : max(x + width, 0)] = colour


def frame(image: np.ndarray, margin: int, width: int, colour: Colour) -> None:
    """A border line at `margin` pixels from the image's edges."""
    high, wide = image.shape[:2]
    for box in (
        (margin, margin, wide - 2 * margin, width),
        (margin, high - margin - width, wide - 2 * margin, width),
        (margin, margin, width, high - 2 * margin),
        (wide - margin - width, margin, width, high - 2 * margin),
    ):
        rectangle(image, box, colour)


def text(
    image: np.ndarray, words: str, box: tuple[float, float, float, float], colour: Colour, weight: float = 0.17
) -> None:
    """Capital letters that fill box = (x, y, width, height), pixels; weight: stroke width as a share of the height."""
    x, y, width, height = box
    pen = min(weight * height, 0.8 * width / (6 * len(words)))
    step = (width - pen) / (6 * len(words) - 2)
    rise = (height - pen) / 6
    for index, glyph in enumerate(words):
        for line in _LETTERS[glyph]:
            corners = [
                (x + pen / 2 + (6 * index + int(line[i])) * step, y + pen / 2 + int(line[i + 1]) * rise)
                for i in range(0, len(line), 2)
            ]
            for start, end in itertools.pairwise(corners):
                stroke(image, start, end, pen, colour)


def print_lines(
    rng: np.random.Generator, image: np.ndarray, box: tuple[int, int, int, int], pitch: int, colour: Colour
) -> None:
    """Small print that fills box = (x, y, width, height): words of random letters, ragged right. pitch: of lines."""
    x0, y0, width, height = box
    letters = sorted(set(_LETTERS) - {" "})
    advance = 0.55 * pitch
    for top in range(y0, y0 + height - pitch, pitch):
        x = x0 + (2.0 * pitch if rng.random() < 0.12 else 0.0)
        end = x0 + width * (1.0 if rng.random() > 0.15 else rng.uniform(0.3, 0.9))
        while x + 3 * advance < end:
            count = min(int(rng.integers(2, 9)), int((end - x) / advance))
            word = "".join(rng.choice(letters, count))
            text(image, word, (x, top + 0.15 * pitch, count * advance, 0.62 * pitch), colour, 0.2)
            x += (count + 1) * advance


def _window(
    image: np.ndarray, left: float, top: float, right: float, bottom: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The part of the image in a box, and its pixel centres' x and y; None for a box outside."""
    high, wide = image.shape[:2]
    x0, x1 = max(int(np.floor(left)), 0), min(int(np.ceil(right)) + 1, wide)
    y0, y1 = max(int(np.floor(top)), 0), min(int(np.ceil(bottom)) + 1, high)
    if x0 >= x1 or y0 >= y1:
        return None
    return image[y0:y1, x0:x1], np.arange(x0, x1)[None, :] + 0.5, np.arange(y0, y1)[:, None] + 0.5


def _paint(part: np.ndarray, inside: np.ndarray, colour: Colour) -> None:
    """Blend `colour` in, by the signed distance to the shape's edge (pixels, positive inside)."""
    cover = np.clip(inside + 0.5, 0, 1)[..., None]
    part[:] = part * (1 - cover) + np.asarray(colour) * cover
