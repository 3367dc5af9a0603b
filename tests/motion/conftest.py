"""A few photographs of the built-in scene, whose cameras are exact, and the scene that comes of them."""

from __future__ import annotations

import shutil

import pytest

from dofbench.core.content import content_folder
from dofbench.core.progress import Silent
from dofbench.scenes import load_scene
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.reconstructing import run

NAMES = tuple(f"view_{index:03d}" for index in range(6, 12))


def _reconstruct(source, out, **options):
    return run(Reconstruct(source, out, **options), Silent(), say=lambda line: None)


@pytest.fixture(scope="session")
def reconstruct():
    """`reconstruct(source, out, **options)` without output."""
    return _reconstruct


@pytest.fixture(scope="session")
def true_scene():
    """The built-in scene with its exact cameras."""
    return load_scene(content_folder("datasets") / "tabletop")


@pytest.fixture(scope="session")
def photographs(tmp_path_factory):
    """A folder of six photographs with a table of EXIF. Nobody writes to it."""
    folder = tmp_path_factory.mktemp("photographs") / "table"
    folder.mkdir()
    for name in NAMES:
        shutil.copy(content_folder("datasets") / f"tabletop/images/{name}.png", folder)
    (folder / "exif.csv").write_text("name,f_number,focal_length_mm\n" + "".join(f"{n}.png,2.8,50\n" for n in NAMES))
    return folder


@pytest.fixture(scope="session")
def made(photographs, tmp_path_factory):
    """The scene made of `photographs`. Nobody writes to it."""
    out = tmp_path_factory.mktemp("scenes") / "table"
    assert _reconstruct(photographs, out).folder == out
    return out
