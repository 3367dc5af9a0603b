"""Frames of a video: of every stretch of it the sharpest one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file, write_json
from dofbench.core.images import write_png
from dofbench.scenes.reconstruction.photograph_list import LEAST, Photograph, Upright, sharpness

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".3gp")
# Sharpness is measured at this width: a smaller one hides blur, a larger one measures the sensor's noise.
_LOOK = 480
_DONE = "frames.json"


def is_video(path: Path) -> bool:
    """Whether a path is a file that is called like a video."""
    return path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES


def announced(path: Path) -> int:
    """Frames that the video says it has. Raises InputError for a file that can't be opened as one, or has none."""
    import cv2

    with _opened(path) as video:
        return max(0, int(video.get(cv2.CAP_PROP_FRAME_COUNT)))


def frame_size(path: Path) -> tuple[int, int]:
    """(width, height) of the frames, upright. Raises InputError as `announced`."""
    import cv2

    with _opened(path) as video:
        return int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))


def sharpest_frames(path: Path, folder: Path, count: int, advance: Callable[[int], None]) -> list[Photograph]:
    """The sharpest frame of each of `count` windows of equal length, as `folder/frame_INDEX.png`; kept where whole.

    Turned upright as the video says. advance: called with the number of frames looked at. Raises InputError where
    the video can't be decoded or has fewer than three frames.
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


def digest(path: Path) -> dict[str, str]:
    """sha256 of the video."""
    return {path.name: sha256_file(path)}


def _best(path: Path, total: int, count: int, advance: Callable[[int], None]) -> Iterator[tuple[int, np.ndarray]]:
    """The index of every window's sharpest frame and that frame, 8-bit RGB; one at a time, since they may be large."""
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
        small = cv2.resize(
            frame, (width, max(1, frame.shape[0] * width // frame.shape[1])), interpolation=cv2.INTER_AREA
        )
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
