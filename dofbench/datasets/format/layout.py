"""The paths of the files in a dataset folder. A view whose name leads out of the folder has none: InputError."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dofbench.core.names import inside

TRANSFORMS, POSES_BOUNDS, SPARSE = "transforms.json", "poses_bounds.npy", "sparse/0"
SHALLOW, LINEAR, SHARP, DEPTH = "images/{}.png", "images_linear/{}.exr", "all_in_focus/{}.png", "depth/{}.exr"
CONFIDENCE, MASK = "confidence/{}.png", "masks/{}.png"
SHARP_LINEAR = "all_in_focus_linear/{}.exr"


def shallow_path(root: Path, name: str) -> Path:
    """The view's shallow photograph, encoded, 8 bit."""
    return root / SHALLOW.format(inside(name, "view"))


def linear_path(root: Path, name: str) -> Path:
    """The view's shallow photograph before encoding."""
    return root / LINEAR.format(inside(name, "view"))


def sharp_path(root: Path, name: str) -> Path:
    """The view's all-in-focus photograph, encoded, 8 bit."""
    return root / SHARP.format(inside(name, "view"))


def sharp_linear_path(root: Path, name: str) -> Path:
    """The view's all-in-focus photograph before encoding: only of a view whose source is linear light."""
    return root / SHARP_LINEAR.format(name)


def depth_path(root: Path, name: str) -> Path:
    """The view's z-depth, float32, scene units."""
    return root / DEPTH.format(inside(name, "view"))


def confidence_path(root: Path, name: str) -> Path:
    """The confidence of the view's depth, 8 bit: 0 unknown ... 255 certain."""
    return root / CONFIDENCE.format(inside(name, "view"))


def mask_path(root: Path, name: str) -> Path:
    """The view's mask, 8 bit: 255 valid, 0 masked; no such file for a view without masked pixels."""
    return root / MASK.format(inside(name, "view"))


def relative(place: Callable[[Path, str], Path], name: str) -> str:
    """The path of a view's file relative to the dataset's folder; place: one of the functions above."""
    return place(Path(), name).as_posix()
