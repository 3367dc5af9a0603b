"""Sharpest frames of a video, which must be SDR in BT.709 colours."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.image_files.iso_boxes import colour_codes
from dofbench.core.images import write_png
from dofbench.scenes.reconstruction.photograph_list import LEAST, Photograph, Upright, sharpness

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".3gp")
# Sharpness is measured at this width: a smaller one hides blur, a larger one measures the sensor's noise.
_LOOK = 480
_DONE = "frames.json"


def is_video(path: Path) -> bool:
    """Whether a path is a file with the suffix of a video."""
    return path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES


def announced(path: Path) -> int:
    """Number of frames by the video's header. Raises InputError for a file that isn't a readable video."""
    import cv2

    with _opened(path) as video:
        return max(0, int(video.get(cv2.CAP_PROP_FRAME_COUNT)))


def frame_size(path: Path) -> tuple[int, int]:
    """(width, height) of the frames, upright. Raises InputError as `announced`."""
    import cv2

    with _opened(path) as video:
        return int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))


def sharpest_frames(path: Path, folder: Path, count: int, advance: Callable[[int], None]) -> list[Photograph]:
    """Write the sharpest frame of each of `count` windows of equal length, upright, as `folder/frame_INDEX.png`.

    advance: called with the number of frames looked at. Raises InputError for an undecodable video or fewer than three
    frames.
    """
    done = folder / _DONE
    if not done.is_file():
        total = announced(path) or sum(1 for _ in _frames(path))
        for left_over in folder.glob("frame_*.png"):
            left_over.unlink()
        names = []
        for index, image in _best(path, total, count, advance):
            names.append(f"frame_{index:06d}")
            write_png(folder / f"{names[-1]}.png", image)
        if len(names) < LEAST:
            raise InputError(path, f"{len(names)} readable frames", f"a video of at least {LEAST}")
        write_json(done, names)
    files = [folder / f"{name}.png" for name in read_json(done)]
    return [Photograph(file.stem, file, Upright(file)) for file in files]


def _best(path: Path, total: int, count: int, advance: Callable[[int], None]) -> Iterator[tuple[int, np.ndarray]]:
    """Index and pixels, 8-bit RGB, of every window's sharpest frame, one at a time, since they may be large."""
    import cv2

    best: tuple[int, np.ndarray] | None = None
    current, score = 0, -1.0
    for index, frame in enumerate(_frames(path)):
        window = min(count - 1, index * count // max(1, total))
        if window != current and best is not None:
            yield best
            best, score = None, -1.0
        current = window
        width = min(_LOOK, frame.shape[1])
        size = width, max(1, frame.shape[0] * width // frame.shape[1])
        small = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
        value = sharpness(small[..., ::-1].astype(np.float32) / np.float32(255.0))
        if value > score:
            best, score = (index, np.ascontiguousarray(frame[..., ::-1])), value
        advance(min(index + 1, max(1, total)))
    if best is not None:
        yield best


def _frames(path: Path) -> Iterator[np.ndarray]:
    with _opened(path) as video:
        while True:
            read, frame = video.read()
            if not read:
                return
            yield frame


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import cv2

    # For a damaged file the decoder prints lines without a cause; the error raised below replaces them.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    level = cv2.utils.logging.setLogLevel(0)
    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise InputError(path, "no readable video", "a video that OpenCV can decode")
        yield video
    finally:
        video.release()
        cv2.utils.logging.setLogLevel(level)


# ITU-T H.273, tables 2 and 3. 0 and 2: not stated. BT.601's primaries are a hair's breadth from BT.709's.
_USUAL_PRIMARIES = (0, 1, 2, 4, 5, 6, 7)
_USUAL_CURVES = (0, 1, 2, 4, 5, 6, 7, 11, 12, 13, 14, 15)
_PRIMARIES = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
_CURVES = {8: "linear light", 16: "PQ (HDR)", 18: "HLG (HDR)"}
_TONES = "zscale=t=linear:npl=100,tonemap=hable,"
_CONVERT = "ffmpeg -i {} -vf {}zscale=p=bt709:t=bt709:m=bt709:r=tv,format=yuv420p -crf 14 SDR.mp4"
# EBML (RFC 8794) and Matroska (RFC 9559, 5.1.4.1.28.16): the elements on the way to a track's colour.
_MATROSKA = (".mkv", ".webm")
_INSIDE = (0x18538067, 0x1654AE6B, 0xAE, 0xE0, 0x55B0)
_CURVE_ID, _PRIMARIES_ID, _CLUSTER = 0x55BA, 0x55BB, 0x1F43B675


def check_colours(path: Path) -> None:
    """Raise InputError, with the command that converts it, for a video in HDR or a wide gamut."""
    codes = _matroska_codes(path) if path.suffix.lower() in _MATROSKA else colour_codes(path)
    if codes is None:
        return
    primaries, curve = codes
    if primaries in _USUAL_PRIMARIES and curve in _USUAL_CURVES:
        return
    said = [
        _PRIMARIES.get(primaries, "" if primaries in _USUAL_PRIMARIES else f"primaries {primaries}"),
        _CURVES.get(curve, "" if curve in _USUAL_CURVES else f"transfer curve {curve}"),
    ]
    command = _CONVERT.format(path.name, _TONES if curve in (16, 18) else "")
    found = f"a video in {' with '.join(filter(None, said))}"
    raise InputError(path, found, f"SDR in BT.709; convert it first: {command}")


def _matroska_codes(path: Path) -> tuple[int, int] | None:
    found: dict[int, int] = {}
    with path.open("rb") as stream:
        _read_elements(stream, stream.seek(0, 2), 0, found)
    if not found:
        return None
    return found.get(_PRIMARIES_ID, 2), found.get(_CURVE_ID, 2)


def _read_elements(stream: BinaryIO, end: int, start: int, found: dict[int, int]) -> None:
    """Collect the codes among the elements from `start` to `end`, up to the first cluster of pictures."""
    while start < end:
        stream.seek(start)
        kind, first = _number(stream, keep_mark=True)
        size, second = _number(stream, keep_mark=False)
        if kind is None or size is None or kind == _CLUSTER:
            return
        inside = start + first + second
        unknown = size == (1 << (7 * second)) - 1
        last = end if unknown else min(end, inside + size)
        if kind in _INSIDE:
            _read_elements(stream, last, inside, found)
        elif kind in (_CURVE_ID, _PRIMARIES_ID) and size <= 8:
            found.setdefault(kind, int.from_bytes(stream.read(size), "big"))
        start = last


def _number(stream: BinaryIO, *, keep_mark: bool) -> tuple[int | None, int]:
    """An EBML number, whose first set bit gives its length, and its bytes; None at the end and where damaged."""
    head = stream.read(1)
    if not head or not head[0]:
        return None, 1
    length = 9 - head[0].bit_length()
    rest = stream.read(length - 1)
    if len(rest) < length - 1:
        return None, length
    mark = 0 if keep_mark else 0x80 >> (length - 1)
    return int.from_bytes(bytes([head[0] & ~mark]) + rest, "big"), length
