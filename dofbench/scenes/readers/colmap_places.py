"""Find the COLMAP model of a scene folder, and its images."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.scenes.readers.colmap_files import count_images, model_suffix
from dofbench.scenes.readers.folders import image_folders

PLACES = (
    "sparse/0, sparse, colmap/sparse/0, dense/0/sparse, undistorted/sparse, distorted/sparse/0, colmap_sparse/0 or "
    "colmap_text"
)
# What the output folder of COLMAP's image_undistorter is called, besides dense.
_UNDISTORTED = ("undistorted", "undistort", "mvs")
# A folder with a model, or with numbered ones, and its images': COLMAP and 3DGS; nerfstudio; COLMAP's automatic
# reconstruction; 3DGS's convert.py before it takes the distortion out (its images/ have none); instant-ngp.
_PLACES = (
    ("sparse", "images"),
    ("colmap/sparse", "images"),
    ("colmap/sparse", "colmap/images"),
    ("dense/*/sparse", "dense/*/images"),
    ("dense/sparse", "dense/images"),
    *((f"{name}{inner}/sparse", f"{name}{inner}/images") for name in _UNDISTORTED for inner in ("", "/*")),
    ("distorted/sparse", "input"),
    ("colmap_sparse", "images"),
    ("colmap_text", "images"),
)
# Steps from a model up to its scene, at most: dense/0/sparse.
_DEEPEST = 3


@dataclass(frozen=True)
class FoundModel:
    """A model's folder. images: of its images, relative to the scene. choice: why it was chosen among several."""

    folder: Path
    images: str
    choice: str = ""


def find_model(root: Path) -> Path | None:
    """The folder with the COLMAP model of a scene folder, as `choose_model`; None without one."""
    found = choose_model(root)
    return None if found is None else found.folder


def choose_model(root: Path) -> FoundModel | None:
    """The model with most images in the first place that has any, preferably with image files; None without one."""
    groups = [group for place in _PLACES if (group := list(_models(root, *place)))]
    if not groups:
        return None
    models = next((group for group in groups if any(image_folders(root, found.images) for found in group)), groups[0])
    if len(models) == 1:
        return models[0]
    counts = {found: _count(found.folder) for found in models}
    largest = max(models, key=counts.__getitem__)  # the first of equal ones
    others = ", ".join(f"{_name(root, other)} has {counts[other]}" for other in models if other is not largest)
    choice = f"{len(models)} COLMAP models: {_name(root, largest)} with {counts[largest]} images is read ({others})"
    return FoundModel(largest.folder, largest.images, choice)


def scene_folder(folder: Path) -> Path:
    """The scene's folder where `folder` is the place of its model, as sparse or sparse/0; else `folder` itself.

    Raises InputError for a model that isn't the scene's largest.
    """
    here = folder.resolve()
    above = [scene for scene in here.parents[:_DEEPEST] if here in _model_places(scene)]
    if not above:
        return folder
    found = {scene: choose_model(scene) for scene in above}
    whole = (scene for scene, model in found.items() if model is not None and image_folders(scene, model.images))
    scene = next(whole, above[0])
    chosen = found[scene]
    if chosen is not None and here != chosen.folder and model_suffix(here):
        contradiction = f"a model of {_count(here)} images, where {chosen.folder} has {_count(chosen.folder)}"
        raise InputError(folder, contradiction, f"{scene}, whose largest model is read, or that model alone")
    return scene


def _model_places(scene: Path) -> set[Path]:
    """Folders with a model of the scene, and those above them that belong to its place: sparse of sparse/0."""
    models = {found.folder for place in _PLACES for found in _models(scene, *place)}
    return models | {model.parent for model in models if model.name.isdigit()}


def _models(root: Path, place: str, images: str) -> Iterator[FoundModel]:
    """The models of a place: numbered ones in the order of their numbers, then one in the place itself."""
    for folder in sorted(root.glob(place)) if "*" in place else [root / place]:
        number = folder.parent.name
        if not folder.is_dir() or ("*" in place and not number.isdigit()):
            continue
        numbered = [inner for inner in folder.iterdir() if inner.name.isdigit() and inner.is_dir()]
        for model in (*sorted(numbered, key=lambda inner: int(inner.name)), folder):
            if model_suffix(model):
                yield FoundModel(model, images.replace("*", number))


def _count(folder: Path) -> int:
    """Images of a model; 0 where it can't be read."""
    try:
        if model_suffix(folder) == ".txt":
            return count_images(folder)
        with (folder / "images.bin").open("rb") as stream:
            return int(struct.unpack("<Q", stream.read(8))[0])
    except (InputError, OSError, struct.error):
        return 0


def _name(root: Path, found: FoundModel) -> str:
    return found.folder.relative_to(root).as_posix()
