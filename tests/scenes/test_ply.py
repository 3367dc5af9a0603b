"""PLY points, ASCII and binary."""

import numpy as np
import pytest

from dofbench.core.errors import InputError
from dofbench.scenes.ply import read_ply

HEADER = "ply\nformat {}\ncomment made up\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\n"
COLOUR = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
END = "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
FIELDS = [("x", "f4"), ("y", "f4"), ("z", "f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
VALUES = [(1.0, 2.0, 3.5, 255, 0, 51), (-1.0, 0.25, 9.0, 0, 102, 255)]


def binary(order):
    return np.array(VALUES, dtype=[(name, order + code) for name, code in FIELDS]).tobytes()


CONTENTS = {
    "ascii": (HEADER.format("ascii 1.0") + COLOUR + END).encode()
    + "".join(" ".join(map(str, row)) + "\n" for row in VALUES).encode(),
    "little": (HEADER.format("binary_little_endian 1.0") + COLOUR + END).encode() + binary("<"),
    "big": (HEADER.format("binary_big_endian 1.0") + COLOUR + END).encode() + binary(">"),
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_points_and_colours(tmp_path, content):
    file = tmp_path / "points.ply"
    file.write_bytes(content)
    points = read_ply(file)
    assert points.xyz.tolist() == [[1.0, 2.0, 3.5], [-1.0, 0.25, 9.0]]
    assert (points.rgb * 255).round().tolist() == [[255, 0, 51], [0, 102, 255]]
    assert np.isnan(points.error).all() and points.views is None


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "no PLY header"),
        (b"ply\nformat ascii 1.0\nend_header\n", "without format or vertices"),
        (b"ply\nformat strange 1.0\nelement vertex 0\nend_header\n", "without format or vertices"),
        (b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", "element face first"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "vertex properties x"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n", "vertex property list"),
        (CONTENTS["little"][:-5], "bytes of vertices"),
        (CONTENTS["ascii"][:-4], "cut short"),
        (CONTENTS["ascii"].replace(b"0.25", b"what"), "what"),
        (CONTENTS["ascii"].replace(b"0.25", b"nan"), "NaN"),
    ],
)
def test_damage_is_named(tmp_path, content, found):
    file = tmp_path / "points.ply"
    file.write_bytes(content)
    with pytest.raises(InputError, match=found) as caught:
        read_ply(file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_without_colour_points_are_grey(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_ply(tmp_path / "points.ply")
    file = tmp_path / "points.ply"
    file.write_text(HEADER.format("ascii 1.0") + "end_header\n0 0 1\n0 1 1\n")
    assert read_ply(file).rgb.tolist() == [[0.5] * 3] * 2
