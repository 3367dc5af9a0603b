"""BLB, the benchmark of BokehMe: Blender scenes with bokeh images at five blur levels and ten focuses.

A scene is a folder with info.json ("blur_parameters", K in pixels times scene unit, and "focus_distances"), image.exr,
depth.exr and bokeh_KK_FF.exr, where KK and FF index the two lists. Colours are linear light. The signed radius is
K (1 / depth - 1 / focus distance) pixels, with disparity not normalised (the repository's README and its issue 4; the
sky's depth is 65504).
"""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file
from dofbench.core.images import image_size, read_exr, read_image
from dofbench.evaluation.renderer.renderer_truth import Case, Truth, existing

INFO, IMAGE, DEPTH = "info.json", "image.exr", "depth.exr"
_LISTS = ("blur_parameters", "focus_distances")


def is_blb(folder: Path) -> bool:
    """Whether a folder has an info.json with blur parameters and focus distances."""
    if not (folder / INFO).is_file():
        return False
    info = read_json(folder / INFO)
    return isinstance(info, dict) and all(key in info for key in _LISTS)


def blb_cases(folder: Path) -> list[Case]:
    """The bokeh images of one scene. Raises InputError for missing or inconsistent files."""
    info = read_json(folder / INFO)
    for key in _LISTS:
        if not isinstance(info[key], list) or not info[key] or not all(map(_is_positive, info[key])):
            raise InputError(folder / INFO, f"{key} = {info[key]!r}", "a list of positive numbers")
    blurs, distances = (info[key] for key in _LISTS)
    sharp = {name: sha256_file(existing(folder / name, "a file of BLB's layout")) for name in (IMAGE, DEPTH)}
    width, height = image_size(folder / IMAGE)
    cases = []
    for file in sorted(folder.glob("bokeh_*.exr")):
        match = re.fullmatch(r"bokeh_(\d+)_(\d+)", file.stem)
        if match is None:
            continue
        level, place = int(match[1]), int(match[2])
        if level >= len(blurs) or place >= len(distances):
            expected = f"{len(blurs)} x {len(distances)} of them by {INFO}"
            raise InputError(file, f"level {level}, focus {place}", expected)
        blur, distance = float(blurs[level]), float(distances[place])
        make, content = partial(_photograph, folder, file, blur, distance), [sharp, sha256_file(file)]
        cases.append(Case("BLB", folder.name, blur, distance, content, width * height / 1e6, make))
    if not cases:
        raise InputError(folder, "no bokeh_KK_FF.exr", "BLB's bokeh images")
    return cases


def _is_positive(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _photograph(folder: Path, file: Path, blur: float, distance: float) -> Truth:
    sharp, photograph, depth = read_image(folder / IMAGE), read_image(file), read_exr(folder / DEPTH)
    depth = depth if depth.ndim == 2 else depth[..., 0]
    for path, found in ((file, photograph.shape[:2]), (folder / DEPTH, depth.shape)):
        if found != sharp.shape[:2]:
            raise InputError(path, f"{found[1]} x {found[0]} pixels", f"{sharp.shape[1]} x {sharp.shape[0]}")
    if not (np.isfinite(depth).all() and (depth > 0).all()):
        raise InputError(folder / DEPTH, "depth that isn't finite or isn't positive", "z > 0 everywhere")
    signed = (blur * (1 / depth.astype(np.float64) - 1 / distance)).astype(np.float32)
    return Truth.from_linear(sharp, photograph, signed)
