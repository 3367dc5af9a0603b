"""ICC profiles written from public numbers, to tag test images with."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

# Red, green and blue in XYZ, adapted to D50, and the tone curve's exponent (0: sRGB's curve).
DISPLAY_P3 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407), 0.0)
ADOBE_RGB = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457), 563 / 256)
PROPHOTO = ((0.79767, 0.28804, 0.0), (0.13519, 0.71188, 0.0), (0.03134, 0.00009, 0.82491), 1.8)
LINEAR_SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410), 1.0)
D50 = (0.96419, 1.0, 0.82489)


def of_primaries(red: tuple, green: tuple, blue: tuple, gamma: float, name: str = "made") -> bytes:
    """A display's profile of three curves and a matrix."""
    tags = {b"rXYZ": _xyz(red), b"gXYZ": _xyz(green), b"bXYZ": _xyz(blue)}
    return _profile(b"RGB ", b"XYZ ", tags | dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), _curve(gamma)), name)


def of_grey(gamma: float) -> bytes:
    """A profile of one curve."""
    return _profile(b"GRAY", b"XYZ ", {b"kTRC": _curve(gamma)}, "grey")


def of_table(channels: int) -> bytes:
    """A profile of a table: neutral; the lightness is the mean of the RGB, or what three of the four inks leave of the
    white times what the black leaves."""
    corners = np.array(np.meshgrid(*[[0, 1]] * channels, indexing="ij")).reshape(channels, -1).T
    light = corners.mean(1) if channels == 3 else (1 - corners[:, :3].mean(1)) * (1 - corners[:, 3])
    lab = np.stack([light * 255, np.full(len(light), 128), np.full(len(light), 128)], 1).round().astype(np.uint8)
    ramp = bytes(range(256))
    identity = b"".join(struct.pack(">i", value) for value in np.eye(3, dtype=int).ravel() * 65536)
    table = b"mft1\0\0\0\0" + bytes([channels, 3, 2, 0]) + identity + ramp * channels + lab.tobytes() + ramp * 3
    return _profile(b"RGB " if channels == 3 else b"CMYK", b"Lab ", {b"A2B0": table}, "table")


def _fixed(value: float) -> bytes:
    return struct.pack(">i", round(value * 65536))


def _xyz(values: tuple) -> bytes:
    return b"XYZ \0\0\0\0" + b"".join(map(_fixed, values))


def _curve(gamma: float) -> bytes:
    if gamma:
        return b"para\0\0\0\0\0\0\0\0" + _fixed(gamma)
    return b"para\0\0\0\0\0\3\0\0" + b"".join(map(_fixed, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))


def _text(text: str) -> bytes:
    return b"mluc\0\0\0\0" + struct.pack(">IIHHII", 1, 12, 0x656E, 0x5553, 2 * len(text), 28) + text.encode("utf-16-be")


def _profile(space: bytes, connection: bytes, tags: Mapping[bytes, bytes], name: str) -> bytes:
    tags = {b"desc": _text(name), b"cprt": _text("CC0"), b"wtpt": _xyz(D50)} | dict(tags)
    kind = b"prtr" if space == b"CMYK" else b"mntr"
    table, data, start = b"", b"", 128 + 4 + 12 * len(tags)
    for tag, content in tags.items():
        table += tag + struct.pack(">II", start + len(data), len(content))
        data += content + bytes(-len(content) % 4)
    head = struct.pack(
        ">I4sI4s4s4s6H4s", start + len(data), b"", 0x04200000, kind, space, connection, *[2026, 1, 1, 0, 0, 0], b"acsp"
    )
    head += bytes(28) + b"".join(map(_fixed, D50)) + bytes(48)
    return head + struct.pack(">I", len(tags)) + table + data
