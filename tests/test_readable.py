"""Files that never end, claim more than they hold, or can't be anything: each one line, without hanging."""

from __future__ import annotations

import os
import socket
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dofbench.core import readable
from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.core.images import image_size, read_exr, read_image, write_exr, write_png
from dofbench.core.readable import parse_json, read_array, read_arrays, read_toml
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.ply import read_ply
from dofbench.scenes.readers.folders import image_files


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


SPECIAL: dict[str, Callable[[Path], None]] = {
    "a FIFO": os.mkfifo,
    "a socket": _socket,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a folder": Path.mkdir,
    "no such file": lambda path: path.symlink_to("nothing"),
    "too many levels": lambda path: path.symlink_to(path.name),
}
READERS: dict[str, Callable[[Path], object]] = {
    "a.png": read_image,
    "b.png": image_size,
    "a.exr": read_exr,
    "a.json": read_json,
    "a.toml": lambda path: read_toml(path, "a TOML file"),
    "a.npy": lambda path: read_array(path, "an array"),
    "a.npz": lambda path: read_arrays(path, "arrays"),
    "a.ply": read_ply,
    "a.bin": lambda path: read_depth(path, 1.0),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("found", SPECIAL)
def test_what_is_no_regular_file_is_not_opened(tmp_path: Path, monkeypatch, found: str, name: str) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's path may have a hundred bytes
    SPECIAL[found](Path(name))
    with pytest.raises(InputError, match=found):
        READERS[name](Path(name))


@pytest.mark.parametrize("found", [kind for kind in SPECIAL if kind != "a folder"])
def test_a_folder_of_images_with_something_else_among_them(tmp_path: Path, monkeypatch, found: str) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(Path("a.png"), np.zeros((4, 4, 3)))
    assert image_files(Path()) == [Path("a.png")]
    SPECIAL[found](Path("b.png"))
    with pytest.raises(InputError, match=f"b.png: found {found}"):
        image_files(Path())


@pytest.mark.parametrize("name", ["x" * 300, "a/" * 3000, "a\0b"])
def test_names_that_no_file_has(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        read_json(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[" * 100_000 + "]" * 100_000, "nested deeper"),
        ("[" * 200 + "]" * 200, "nested deeper"),
        ('{"a":' * 200 + "1" + "}" * 200, "nested deeper"),
        ('{"a": ' + "9" * 400 + "}", "400 digits"),
        ('["\\ud800"]', "surrogate"),
        ('{"\\udfff": 1}', "surrogate"),
        ("{", "no JSON"),
        ("", "no JSON"),
    ],
)
def test_json_that_nothing_can_be_made_of(text: str, found: str) -> None:
    with pytest.raises(InputError, match=found):
        parse_json(text, "a.json")


def test_json_up_to_the_bounds() -> None:
    deep = parse_json("[" * 100 + "]" * 100, "a.json")
    assert deep and parse_json('["\\ud83d\\ude00", ' + "9" * 308 + "]", "a.json") == ["\U0001f600", 10**308 - 1]


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_json(tmp_path / "a.json") == {"a": 1}


def _announcing(shape: tuple[int, ...], body: bytes = b"", kind: str = "<f4") -> bytes:
    header = str({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (_announcing((6_000_000, 6_000_000)), "values"),
        (_announcing((1000, 1000)), "0 bytes for an array of 4000000"),
        (_announcing((2, 2), bytes(20)), "20 bytes for an array of 16"),
        (_announcing((-1, -4), bytes(16)), "shape"),
        (_announcing((1,), bytes(8), "|O"), "values of type object"),
        (_announcing((2.5,), bytes(8)), "no readable array"),
        (b"PK\x05\x06" + bytes(18), "an archive of several arrays"),
        (b"", "no readable array"),
        (b"\x93NUMPY", "no readable array"),
    ],
)
def test_arrays_are_as_long_as_they_say(tmp_path: Path, content: bytes, found: str) -> None:
    file = tmp_path / "a.npy"
    file.write_bytes(content)
    with pytest.raises(InputError, match=found):
        read_array(file, "an array")


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("shape", [(), (0, 3), (3,), (2, 3, 4)])
def test_whole_arrays_are_read(tmp_path: Path, shape: tuple[int, ...], order: str) -> None:
    array = np.asarray(np.arange(np.prod(shape, dtype=int)).reshape(shape), order=order)
    np.save(tmp_path / "a.npy", array)
    np.savez_compressed(tmp_path / "a.npz", one=array, two=np.array("text"))
    both = read_arrays(tmp_path / "a.npz", "arrays")
    for found in (read_array(tmp_path / "a.npy", "an array"), both["one"]):
        assert found.dtype == array.dtype and found.shape == shape and np.array_equal(found, array)
    assert str(both["two"]) == "text"


def _png(width: int, height: int, rows: bytes) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("width", "height", "length", "found"),
    [(40_000, 30_000, 2**22, "40000 x 30000"), (15_000, 15_000, 2**18, "too few for 15000 x 15000")],
)
def test_images_that_claim_too_much_are_not_decoded(
    tmp_path: Path, width: int, height: int, length: int, found: str
) -> None:
    file = tmp_path / "a.png"
    # Enough bytes for OpenImageIO, which refuses headers of tiny files by itself.
    file.write_bytes(_png(width, height, bytes(100)) + bytes(length))
    for read in (read_image, image_size):
        with pytest.raises(InputError, match=found):
            read(file)


def test_an_exr_with_too_large_a_window_is_not_decoded(tmp_path: Path) -> None:
    file = tmp_path / "a.exr"
    write_exr(file, np.zeros((4, 4), np.float32))
    content, side = file.read_bytes(), struct.pack("<2i", 3, 3)
    file.write_bytes(content.replace(side, struct.pack("<2i", 14_999, 14_999)))
    with pytest.raises(InputError, match="15000"):
        read_exr(file)


def test_the_largest_images_are_read(tmp_path: Path, monkeypatch) -> None:
    write_png(tmp_path / "a.png", np.zeros((20, 30, 3)))
    monkeypatch.setattr(readable, "MOST_PIXELS", 600)
    assert image_size(tmp_path / "a.png") == (30, 20)
    monkeypatch.setattr(readable, "MOST_PIXELS", 599)
    with pytest.raises(InputError, match="30 x 20 pixels"):
        image_size(tmp_path / "a.png")


@pytest.mark.parametrize("unit", [1e38, 1e300, 1e-30, 0.0, -1.0, float("nan")])
def test_a_depth_unit_that_leaves_no_depth(tmp_path: Path, unit: float) -> None:
    np.save(tmp_path / "a.npy", np.full((3, 4), 5.0, np.float32))
    with pytest.raises(InputError, match="unit"):
        read_depth(tmp_path / "a.npy", unit)


def test_a_ply_announcing_more_than_it_holds(tmp_path: Path) -> None:
    head = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    for form in ("ascii", "binary_little_endian"):
        for count in ("99999999999999", "9" * 400, "²"):
            (tmp_path / "a.ply").write_text(head.format(form, count) + "end_header\n1 2 3\n")
            with pytest.raises(InputError):
                read_ply(tmp_path / "a.ply")


def test_a_message_is_one_printable_line_of_bounded_length() -> None:
    message = str(InputError("a\x1b[31m\udce4.png", "x\n" * 10_000, "b\x07"))
    assert message.isprintable() and len(message) < 4000 and message.encode()
