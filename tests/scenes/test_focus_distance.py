"""The distance in focus that a camera wrote, from EXIF and maker notes made by hand."""

from __future__ import annotations

import math
import random
import struct

import numpy as np
import OpenImageIO as oiio
import pytest
from tolerances import EXIF_RATIONAL

from dofbench.core.image_files.exif import Exif, read_exif, write_exif
from dofbench.scenes.readers.exif_files import exif_of_image, read_exif_csv

ENDLESS = 0xFFFFFFFF  # numerator: infinity, by the standard
DAMAGED = 300  # files


def _directory(endian, tags, start):
    """A TIFF directory at `start` with its values behind it. tags: number, type, count, value."""
    entries, values = b"", b""
    behind = start + 2 + 12 * len(tags) + 4
    for number, kind, count, value in tags:
        place = value.ljust(4, b"\0") if len(value) <= 4 else struct.pack(endian + "I", behind + len(values))
        entries += struct.pack(endian + "HHI", number, kind, count) + place
        values += value + b"\0" * (len(value) % 2) if len(value) > 4 else b""
    return struct.pack(endian + "H", len(tags)) + entries + bytes(4) + values


def photograph(path, make, subject=None, note=None, endian="<"):
    """A JPEG whose EXIF has a maker, a subject distance, and a maker note that is made for its place in the file."""
    spec = oiio.ImageSpec(16, 16, 3, "uint8")
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(np.zeros((16, 16, 3), np.uint8)) and output.close()
    head = (b"II" if endian == "<" else b"MM") + struct.pack(endian + "HI", 42, 8)

    def block(at):
        name = make.encode() + b"\0"
        first = [(0x010F, 2, len(name), name), (0x8769, 4, 1, struct.pack(endian + "I", at))]
        return head + _directory(endian, first, 8)

    start = len(block(0))
    tags = [(0x829D, 5, 1, struct.pack(endian + "II", 28, 10))]
    if subject is not None:
        tags.append((0x9206, 5, 1, struct.pack(endian + "II", *subject)))
    if note is not None:
        behind = start + 2 + 12 * (len(tags) + 1) + 4 + 8 * len(tags)
        tags.append((0x927C, 7, len(note(behind)), note(behind)))
    exif = b"Exif\0\0" + block(start) + _directory(endian, tags, start)
    segment = b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif
    data = path.read_bytes()
    jfif = 2 + 2 + int.from_bytes(data[4:6], "big")  # cameras write EXIF in its place
    path.write_bytes(data[:2] + segment + data[jfif:])
    return path


def canon(directory, word, upper, lower, endian="<"):
    """Canon's directory with both ends of the zone in focus, centimetres, from that word on."""

    def note(at):
        words = [0] * 34
        words[0], words[word], words[word + 1] = 68, upper, lower
        return _directory(endian, [(directory, 3, 34, struct.pack(endian + "34H", *words))], at)

    return note


def nikon(version, step):
    data = version + bytes(5) + bytes([step]) + bytes(20)
    return lambda at: b"Nikon\0\x02\x10\0\0II*\0\x08\0\0\0" + _directory("<", [(0x98, 7, len(data), data)], 8)


@pytest.mark.parametrize(
    ("subject", "metres"),
    [
        ((123, 100), 1.23),
        ((ENDLESS, 1), math.inf),
        ((ENDLESS, 1000), math.inf),
        ((5, 0), math.inf),
        ((0, 1), None),
        ((0, 0), None),
    ],
)
def test_the_subject_distance(tmp_path, subject, metres):
    assert exif_of_image(photograph(tmp_path / "a.jpg", "X", subject)).focus_distance == metres


@pytest.mark.parametrize("endian", ["<", ">"])
@pytest.mark.parametrize(("directory", "word"), [(0x0004, 19), (0x0093, 20)])
@pytest.mark.parametrize(
    ("upper", "lower", "metres"),
    [
        (250, 250, 2.5),
        (300, 200, 2.4),  # half-way between 1/3 and 1/2 per metre
        (200, 300, 2.4),  # some bodies write them the other way round
        (200, 0, 2.0),
        (40000, 40000, 400.0),  # beyond a signed word
        (0xFFFF, 1000, 20.0),
        (0xFFFF, 0xFFFF, math.inf),
        (0, 0, None),
        (0, 500, None),
    ],
)
def test_canon_s_maker_note(tmp_path, endian, directory, word, upper, lower, metres):
    file = photograph(tmp_path / "a.jpg", "Canon", note=canon(directory, word, upper, lower, endian), endian=endian)
    found = exif_of_image(file).focus_distance
    assert found == (metres if metres is None else pytest.approx(metres, rel=EXIF_RATIONAL))


def test_the_standard_s_tag_comes_before_the_maker_note(tmp_path):
    note = canon(0x0004, 19, 250, 250)
    assert exif_of_image(photograph(tmp_path / "a.jpg", "Canon", (7, 1), note)).focus_distance == 7
    assert exif_of_image(photograph(tmp_path / "a.jpg", "Canon", (0, 1), note)).focus_distance == 2.5


@pytest.mark.parametrize(
    ("version", "step", "metres"), [(b"0101", 80, 1.0), (b"0101", 0, None), (b"0204", 80, None), (b"0100", 80, None)]
)
def test_nikon_s_maker_note_where_it_is_plain(tmp_path, version, step, metres):
    assert (
        exif_of_image(photograph(tmp_path / "a.jpg", "NIKON CORPORATION", note=nikon(version, step))).focus_distance
        == metres
    )


@pytest.mark.parametrize("make", ["SONY", "FUJIFILM", "", "NIKON"])
def test_another_maker_s_note_says_nothing(tmp_path, make):
    assert exif_of_image(photograph(tmp_path / "a.jpg", make, note=canon(0x0004, 19, 250, 250))).focus_distance is None


def test_a_damaged_maker_note_says_nothing_and_raises_nothing(tmp_path, capfd):
    file, draw = photograph(tmp_path / "a.jpg", "Canon", note=canon(0x0004, 19, 250, 240)), random.Random(0)
    sound = file.read_bytes()
    for _ in range(DAMAGED):
        damaged = bytearray(sound)
        for _ in range(draw.randint(1, 6)):
            damaged[draw.randrange(30, 300)] = draw.choice((0, 1, 3, 7, 255))
        file.write_bytes(damaged)
        found = exif_of_image(file).focus_distance
        assert found is None or found > 0
    assert capfd.readouterr() == ("", "")


def test_a_count_of_thousands_of_millions_ends(tmp_path):
    file = photograph(tmp_path / "a.jpg", "Canon", note=canon(0x0004, 19, 250, 240))
    data = file.read_bytes()
    place = data.index(struct.pack("<HH", 0x927C, 7)) + 4
    file.write_bytes(data[:place] + b"\xff\xff\xff\xff" + data[place + 4 :])
    assert exif_of_image(file).focus_distance is None


def test_infinity_is_kept(tmp_path):
    (tmp_path / "exif.csv").write_text("name,focus_distance_m\na,1.5\nb,inf\nc,Infinity\nd,\n")
    known = read_exif_csv(tmp_path / "exif.csv")
    assert [known[name].focus_distance for name in "abcd"] == [1.5, math.inf, math.inf, None]
    write_exif(tmp_path, known)
    assert "Infinity" not in (tmp_path / "exif.json").read_text()  # which JSON doesn't have
    assert read_exif(tmp_path) == known


@pytest.mark.parametrize("number", [math.nan, -1.0, 0.0, -math.inf])
def test_a_distance_that_cant_be_is_refused(number):
    with pytest.raises(ValueError, match="focus_distance"):
        Exif(focus_distance=number)


def test_nothing_else_may_be_infinite():
    with pytest.raises(ValueError, match="f_number"):
        Exif(f_number=math.inf)
