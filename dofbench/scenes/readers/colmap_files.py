"""Do COLMAP's binary files have the length that they claim?

pycolmap reads past the end of a truncated file without a word: it invents cameras, or never
returns. So the structure is walked first (the layout is COLMAP's scene/reconstruction_io).
"""

from __future__ import annotations

import struct
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.readable import check_file, read_bytes

_PARTS = ("cameras", "images", "points3D")


def model_suffix(folder: Path) -> str | None:
    """'.bin' or '.txt', whichever the folder has all three files of (binary first, as COLMAP), else None."""
    for suffix in (".bin", ".txt"):
        if all((folder / f"{part}{suffix}").is_file() for part in _PARTS):
            return suffix
    return None


def check_kinds(folder: Path) -> None:
    """Raise InputError for a file of those that pycolmap opens that is no regular file: a FIFO would never open."""
    for part in (*_PARTS, "rigs", "frames"):
        for suffix in (".bin", ".txt"):
            if (folder / f"{part}{suffix}").exists():
                check_file(folder / f"{part}{suffix}", "a file of a COLMAP model")


def check_binary(folder: Path) -> None:
    """Raise InputError naming the file unless every binary file of the model ends where its contents end."""
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
