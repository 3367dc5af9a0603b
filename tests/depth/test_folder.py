"""Depth maps in a folder: every format gives the same map, and what is missing is named."""

from __future__ import annotations

import re

import numpy as np
import pytest
from made_up import frontal, scene_of
from tolerances import FLOAT32_SCALAR

from dofbench.core.errors import InputError
from dofbench.core.images import write_exr
from dofbench.datasets.synthesis.depth_sources import open_source
from dofbench.scenes.depth.given import with_folder_depth

DEPTH = (1 + np.arange(12, dtype=np.float32).reshape(3, 4)) / 4
SCENE = scene_of([frontal(4, 3, 4.0)], suffix=".JPG")


def write_colmap(path, depth):
    height, width = depth.shape
    path.write_bytes(f"{width}&{height}&1&".encode() + depth.astype("<f4").tobytes())


def write_png(path, depth):
    import cv2

    cv2.imwrite(str(path), np.rint(depth * 4).astype(np.uint16))


@pytest.mark.parametrize(
    ("name", "write", "unit"),
    [
        ("v0.exr", write_exr, 1.0),
        ("v0.npy", np.save, 1.0),
        ("v0.bin", write_colmap, 1.0),
        ("v0.JPG.geometric.bin", write_colmap, 1.0),
        ("v0.png", write_png, 0.25),
        ("v0.npy", lambda path, depth: np.save(path, depth * 1000), 1e-3),
    ],
)
def test_every_format_gives_the_same_map(tmp_path, name, write, unit):
    write(tmp_path / name, DEPTH)
    scene = with_folder_depth(SCENE, tmp_path, unit)
    source = open_source("folder", scene, steps=1, seed=0, work=tmp_path)
    np.testing.assert_allclose(source.estimate(scene.views[0]).depth, DEPTH, rtol=FLOAT32_SCALAR)
    assert source.id == "folder" and "folder" in source.provenance()["from"]


def test_infinity_and_zero_are_unknown(tmp_path):
    depth = DEPTH.copy()
    depth[0, :2] = (np.inf, 0)
    np.save(tmp_path / "v0.npy", depth)
    view = with_folder_depth(SCENE, tmp_path, 1.0).views[0]
    assert view.depth is not None and np.array_equal(view.depth()[0, :2], np.zeros(2))


@pytest.mark.parametrize(
    ("files", "word"), [({}, "no map for view v0"), ({"v0.npy": b"1", "v0.exr": b"1"}, "v0.exr and v0.npy for view v0")]
)
def test_one_map_a_view(tmp_path, files, word):
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=word):
        with_folder_depth(SCENE, tmp_path, 1.0)


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("v0.npy", b"no array", "no readable array"),
        ("v0.bin", b"4&3&1&short", "no depth map of COLMAP"),
        ("v0.bin", b"4&3&3&" + bytes(144), "3 channels"),
        ("v0.bin", b"", "no depth map of COLMAP"),
    ],
)
def test_a_damaged_map_is_one_line_that_names_it(tmp_path, name, content, word):
    (tmp_path / name).write_bytes(content)
    view = with_folder_depth(SCENE, tmp_path, 1.0).views[0]
    with pytest.raises(InputError, match=re.escape(word)) as caught:
        assert view.depth is not None
        view.depth()
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_maps_of_another_size_and_missing_folders(tmp_path):
    np.save(tmp_path / "v0.npy", DEPTH.T)
    scene = with_folder_depth(SCENE, tmp_path, 1.0)
    with pytest.raises(InputError, match="shape"):
        open_source("folder", scene, steps=1, seed=0, work=tmp_path).estimate(scene.views[0])
    with pytest.raises(InputError, match="no such folder"):
        with_folder_depth(SCENE, tmp_path / "none", 1.0)
