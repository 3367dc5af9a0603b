"""COLMAP's files checked before pycolmap reads them.

pycolmap reads past the end of a truncated binary file without an error. It cuts an image's name at its first blank,
and takes every second line of images.txt for 2D points. So both kinds are walked first (layout:
scene/reconstruction_io of COLMAP), and text is rewritten as COLMAP would write it.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.readable import check_file, read_bytes, read_text

_PARTS = ("cameras", "images", "points3D")


def model_suffix(folder: Path) -> str | None:
    """'.bin' or '.txt', if the folder has all three files of it (binary first, as COLMAP), else None."""
    for suffix in (".bin", ".txt"):
        if all((folder / f"{part}{suffix}").is_file() for part in _PARTS):
            return suffix
    return None


def check_kinds(folder: Path) -> None:
    """Raise InputError for a model file that is no regular file: a FIFO would never open."""
    for part in (*_PARTS, "rigs", "frames"):
        for suffix in (".bin", ".txt"):
            if (folder / f"{part}{suffix}").exists():
                check_file(folder / f"{part}{suffix}", "a file of a COLMAP model")


def check_binary(folder: Path) -> None:
    """Raise InputError naming the file unless every binary file ends where its contents end."""
    walks = {"cameras": _cameras, "images": _images, "points3D": _points, "rigs": _rigs, "frames": _frames}
    for part, walk in walks.items():
        file = folder / f"{part}.bin"
        if not file.is_file():
            continue
        content = read_bytes(file, "a whole COLMAP file")
        try:
            end = walk(content, file)
        except (struct.error, IndexError):
            end = None
        if end is None or end > len(content):
            raise InputError(file, f"{len(content)} bytes, too few for what they announce", "a whole COLMAP file")
        if end < len(content):
            raise InputError(file, f"{len(content) - end} bytes after the end", "a whole COLMAP file")


def _count(content: bytes, at: int) -> int:
    # A damaged count of 64 bits leads beyond what Python takes for a place.
    if at > len(content):
        raise IndexError("beyond the end")
    return struct.unpack_from("<Q", content, at)[0]


def _cameras(content: bytes, file: Path) -> int:
    from dofbench.scenes.colmap_binding import pycolmap

    end = 8
    for _ in range(_count(content, 0)):
        model = struct.unpack_from("<i", content, end + 4)[0]
        try:
            parameters = len(pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(model), 1.0, 1, 1).params)
        except (ValueError, RuntimeError, IndexError):
            raise InputError(file, f"camera model number {model}", "a model that pycolmap knows") from None
        end += 24 + 8 * parameters
    return end


def _images(content: bytes, file: Path) -> int:
    end = 8
    for _ in range(_count(content, 0)):
        # id, quaternion, translation, camera id; then the name up to a zero byte; then 2D points.
        if end > len(content):
            raise IndexError("beyond the end")
        name_end = content.find(b"\0", end + 64)
        if name_end < 0:
            raise IndexError("name without an end")
        if not any(struct.unpack_from("<4d", content, end + 4)):
            # pycolmap would take it for no rotation at all.
            name = content[end + 64 : name_end].decode("utf-8", "replace")
            raise InputError(file, f"a rotation of length 0 for {name}", "a unit quaternion")
        end = name_end + 9 + 24 * _count(content, name_end + 1)
    return end


def binary_poses(folder: Path) -> dict[int, tuple[float, ...]]:
    """Quaternion (w first) and translation of the images of a checked images.bin, by their id."""
    content = read_bytes(folder / "images.bin", "a whole COLMAP file")
    poses, end = {}, 8
    for _ in range(_count(content, 0)):
        key, *pose = struct.unpack_from("<I7d", content, end)
        poses[key] = tuple(pose)
        name_end = content.index(b"\0", end + 64)
        end = name_end + 9 + 24 * _count(content, name_end + 1)
    return poses


def _points(content: bytes, file: Path) -> int:
    end = 8
    for _ in range(_count(content, 0)):
        # id, position, colour, error: 43 bytes; then the track.
        end += 51 + 8 * _count(content, end + 43)
    return end


def _rigs(content: bytes, file: Path) -> int:
    end = 8
    for _ in range(_count(content, 0)):
        sensors = struct.unpack_from("<I", content, end + 4)[0]
        end += 8 + (8 if sensors else 0)
        for _ in range(max(0, sensors - 1)):
            end += 9 + (56 if content[end + 8] else 0)
    return end


def _frames(content: bytes, file: Path) -> int:
    end = 8
    for _ in range(_count(content, 0)):
        end += 68 + 16 * struct.unpack_from("<I", content, end + 64)[0]
    return end


_COUNT = {part: re.compile(rf"#\s*Number of {part}:\s*(\d+)") for part in ("cameras", "images", "points")}
# IMAGE_ID, QW QX QY QZ, TX TY TZ, CAMERA_ID, then the name: the rest of the line.
_BEFORE_NAME = 9
# POINT3D_ID, X Y Z, R G B, ERROR, then the track: pairs of IMAGE_ID and POINT2D_IDX.
_BEFORE_TRACK = 8
_ALL = ("cameras", "images", "points3D", "rigs", "frames")


@dataclass(frozen=True)
class TextModel:
    """folder: of the files for pycolmap. names, poses (quaternion, w first, and translation): by image id. notes: on
    repairs."""

    folder: Path
    names: dict[int, str]
    poses: dict[int, tuple[float, ...]]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Images:
    """lines: alternately of an image and of its 2D points. missing: number of missing lines of 2D points. cut: whether
    the last image's is missing."""

    names: dict[int, str]
    lines: list[str]
    missing: int
    cut: bool

    @property
    def poses(self) -> dict[int, tuple[float, ...]]:
        """Quaternion and translation by id."""
        return {
            key: tuple(float(word) for word in line.split(maxsplit=8)[1:8])
            for key, line in zip(self.names, self.lines[::2], strict=True)
        }

    @property
    def have_points(self) -> bool:
        return any(line.strip() for line in self.lines[1::2])


@contextmanager
def readable_text(folder: Path) -> Iterator[TextModel]:
    """The text model of a folder, or a temporary copy of it that pycolmap reads correctly.

    Raises InputError for text that isn't UTF-8, a line in another format, a repeated id, and a header (`# Number of
    images: N`) that contradicts the content.
    """
    files = {part: folder / f"{part}.txt" for part in _ALL if (folder / f"{part}.txt").is_file()}
    texts = {part: _text(file) for part, file in files.items()}
    marked = any(file.open("rb").read(3) == b"\xef\xbb\xbf" for file in files.values())
    images = _text_images(texts["images"], files["images"])
    _check_count("images", len(images.names), texts["images"], files["images"])
    cameras = len(_data_lines(texts["cameras"]))
    _check_count("cameras", cameras, texts["cameras"], files["cameras"])
    points = [_point(number, line, files["points3D"]) for number, line in _data_lines(texts["points3D"])]
    _check_count("points", len(points), texts["points3D"], files["points3D"])
    tracks = not images.have_points and any(len(point) > _BEFORE_TRACK for point in points)
    if not (marked or images.missing or images.cut or tracks):
        yield TextModel(folder, images.names, images.poses, ())
        return
    note = (
        f"{files['images'].name} of {folder.name} has no lines of 2D points"
        if images.missing == len(images.names)
        else f"{images.missing} of {len(images.names)} images in {files['images'].name} have no line of 2D points"
    )
    lines = images.lines
    if tracks:
        lines, points = _joined(images, points, files["points3D"])
        texts["points3D"] = "\n".join(" ".join(point) for point in points)
    texts["images"] = "\n".join(lines)
    with tempfile.TemporaryDirectory(prefix="dofbench-colmap-") as copy:
        for part, text in texts.items():
            Path(copy, f"{part}.txt").write_text(f"{text}\n", encoding="utf-8")
        yield TextModel(Path(copy), images.names, images.poses, (note,) if images.missing else ())


def count_images(folder: Path) -> int:
    """Number of images in images.txt. Raises InputError as `readable_text`."""
    file = folder / "images.txt"
    return len(_text_images(_text(file), file).names)


def _text(file: Path) -> str:
    return read_text(file, "a file of a COLMAP model")


def _data_lines(text: str) -> list[tuple[int, str]]:
    """Lines with data, and their numbers from 1."""
    lines = enumerate(text.split("\n"), start=1)
    return [(number, line.strip()) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def _check_count(part: str, found: int, text: str, file: Path) -> None:
    announced = _COUNT[part].search(text)
    if announced is not None and int(announced[1]) != found:
        raise InputError(file, f"{found} {part}", f"the {announced[1]} that its header counts: a whole file")


def _text_images(text: str, file: Path) -> _Images:
    names: dict[int, str] = {}
    lines: list[str] = []
    missing, waiting = 0, False
    for number, raw in enumerate(text.removesuffix("\n").split("\n"), start=1):
        line = raw.strip()
        if line.startswith("#"):
            continue
        image = _image(line)
        if waiting and (not line or image is None):
            if len(line.split()) % 3:
                raise InputError(file, f"line {number} of {len(line.split())} words", "an image, or its 2D points")
            lines.append(line)
            waiting = False
        elif line:
            if image is None:
                raise InputError(file, f"line {number}: {line[:60]!r}", "an image: id, pose, camera and name")
            if waiting:
                lines.append("")
                missing += 1
            key, name = image
            if key in names:
                raise InputError(file, f"image id {key} a second time in line {number}", "one image an id")
            names[key] = name
            lines.append(line)
            waiting = True
    if waiting:
        lines.append("")
    # An editor that strips a text's end takes the last blank line alone.
    return _Images(names, lines, missing + (waiting and missing > 0), cut=waiting)


def _image(line: str) -> tuple[int, str] | None:
    """(id, name) of an image's line; None for others, and for one that may be 2D points."""
    words = line.split(maxsplit=_BEFORE_NAME)
    if len(words) <= _BEFORE_NAME:
        return None
    *numbers, name = words
    try:
        for word in numbers[1:-1]:
            float(word)
        key, _ = int(numbers[0]), int(numbers[-1])
    except ValueError:
        return None
    return None if _are_points(name) else (key, name)


def _are_points(rest: str) -> bool:
    """Whether the words after the ninth are triples of numbers, as 2D points."""
    words = rest.split()
    if len(words) % 3:
        return False
    try:
        for word in words:
            float(word)
    except ValueError:
        return False
    return True


def _point(number: int, line: str, file: Path) -> list[str]:
    words = line.split()
    if len(words) < _BEFORE_TRACK or len(words) % 2:
        raise InputError(file, f"line {number} of {len(words)} words", "a point and its whole track")
    return words


def _joined(images: _Images, points: list[list[str]], file: Path) -> tuple[list[str], list[list[str]]]:
    """Make lines of 2D points from the tracks, which pycolmap requires in both files; their positions are 0."""
    seen: dict[str, list[str]] = {str(key): [] for key in images.names}
    joined = []
    for words in points:
        key, track = words[0], words[_BEFORE_TRACK::2]
        pairs = []
        for image in track:
            if image not in seen:
                raise InputError(file, f"image {image} in the track of point {key}", "an image of images.txt")
            pairs += [image, str(len(seen[image]))]
            seen[image].append(f"0 0 {key}")
        joined.append([*words[:_BEFORE_TRACK], *pairs])
    pairs_of_lines = zip(images.lines[::2], seen.values(), strict=True)
    return [line for image, points_of in pairs_of_lines for line in (image, " ".join(points_of))], joined
