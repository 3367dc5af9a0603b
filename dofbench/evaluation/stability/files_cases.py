"""Image files: odd sizes, unusual numbers and channels, damage; resizing and display encoding."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import image_size, read_exr, read_image, resize, write_exr, write_grey_png, write_png
from dofbench.evaluation.stability.case import NUMPY, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import differing, in_folder, off, off_each, refuses
from dofbench.evaluation.stability.samples import by_size, picture
from dofbench.optics.tone import decode, encode

LEVEL = 1 / 255


@in_folder
def _png(folder: Path, size: tuple[int, int], bits: int) -> Found:
    image = picture(*size)
    write_png(folder / "a.png", image, bits=bits)
    wrong = float(image_size(folder / "a.png") != (size[1], size[0]))
    steps = 2**bits - 1
    # Half a level, and the rounding of a float32 number near 1.
    return Found(math.inf if wrong else off(read_image(folder / "a.png"), image, 1.0), 0.5 / steps + 2e-7)


@in_folder
def _exr(folder: Path, size: tuple[int, int]) -> Found:
    image, depth = picture(*size) * np.float32(1e6), picture(*size)[..., 0] * np.float32(1e-6)
    write_exr(folder / "a.exr", image)
    write_exr(folder / "z.exr", depth)
    return Found(differing(read_exr(folder / "a.exr"), image) + differing(read_exr(folder / "z.exr"), depth), 0.0)


@in_folder
def _exr_kept(folder: Path) -> Found:
    depth = picture()[..., 0]
    depth[0, :4] = (np.inf, -np.inf, np.nan, 1e-42)
    write_exr(folder / "z.exr", depth)
    found = read_exr(folder / "z.exr")
    return Found(float(not np.array_equal(found, depth, equal_nan=True)), 0.0)


@in_folder
def _half_exr(folder: Path) -> Found:
    image = picture() * np.float32(1000)
    image[0, 0] = (1e6, 7e4, 65504.0)
    write_exr(folder / "a.exr", image, half=True)
    found = read_exr(folder / "a.exr")
    saturated = np.minimum(image, 65504.0)
    return Found(off_each(found, saturated), 2.0**-11, "of each number")


@in_folder
def _one_channel(folder: Path) -> Found:
    grey = picture()[..., 0]
    write_grey_png(folder / "grey.png", grey)
    write_exr(folder / "grey.exr", grey)
    from_png, from_exr = read_image(folder / "grey.png"), read_image(folder / "grey.exr")
    repeated = np.repeat(grey[..., None], 3, axis=2)
    return Found(max(off(from_png, repeated, 1.0), off(from_exr, repeated, 1.0)), 0.5 * LEVEL + 2e-7)


@in_folder
def _alpha(folder: Path, bits: int, grey: bool) -> Found:
    import cv2

    steps = 2**bits - 1
    kind = np.uint8 if bits == 8 else np.uint16
    random = np.random.default_rng(0)
    colour, alpha = random.integers(0, steps + 1, (24, 32, 3)), random.integers(0, steps + 1, (24, 32, 1))
    if grey:  # OpenCV can't write grey with alpha, so a colour image with equal channels is used
        colour = np.repeat(colour[..., :1], 3, axis=2)
    cv2.imwrite(str(folder / "a.png"), np.concatenate([colour[..., ::-1], alpha], axis=2).astype(kind))
    expected = colour / steps * (alpha / steps)
    # The product of two levels may be rounded to a level by a reader that works in the file's bit depth.
    return Found(off(read_image(folder / "a.png"), expected, 1.0), 1.0 / steps + 2e-7)


def _resized(setting: Setting) -> Found:
    image = picture(5, 7)
    wrong = off(resize(image, 1, 1), image.mean(axis=(0, 1), keepdims=True))
    point = picture(1, 1)
    for width, height in ((1, 1), (3, 3), (1, 5)):
        grown = resize(point, width, height)
        wrong = max(wrong, off(grown, np.broadcast_to(point, (height, width, 3))))
    flat = np.full((9, 13, 3), 0.37, np.float32)
    wrong = max(wrong, *(off(resize(flat, w, h), np.full((h, w, 3), 0.37)) for w, h in ((4, 3), (20, 17), (1, 9))))
    return Found(wrong, 32 * setting.eps)


@in_folder
def _damaged(folder: Path) -> Found:
    write_png(folder / "whole.png", picture())
    content = (folder / "whole.png").read_bytes()
    wrong = 0.0
    for name, cut in (("empty.png", 0), ("header.png", 30), ("half.png", len(content) // 2)):
        (folder / name).write_bytes(content[:cut])
        wrong += refuses(InputError, partial(read_image, folder / name), name).error
    return Found(wrong, 0.0)


def _pure_power(setting: Setting) -> Found:
    tones = np.array([0.0, 1e-30, 1e-3, 0.5, 1.0], np.float32)
    wrong = max(off(encode(decode(tones, gamma), gamma), tones) for gamma in (1.0, 2.2))
    return Found(wrong, 32 * setting.eps)


def _cases() -> tuple[Case, ...]:
    images = Subject("files", "images", NUMPY)
    return (
        *images.each("png-{bits}-bit-{size_label}", _png, size=by_size((1, 1), (1, 9), (17, 33)), bits=(8, 16)),
        *images.each("exr-{size_label}", _exr, size=by_size((1, 1), (9, 1), (17, 33))),
        images.case("exr-not-finite", _exr_kept),
        images.case("exr-half", _half_exr),
        images.case("one-channel", _one_channel),
        *images.each("alpha-{bits}-bit{grey_label}", _alpha, bits=(8, 16), grey={"": False, "-grey": True}),
        images.case("damaged", _damaged),
        images.case("resize", _resized),
        images.case("pure-power", _pure_power),
    )


CASES = _cases()
