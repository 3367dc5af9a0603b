"""Datasets of scenes far from their origin: files with the scene's coordinates, and a local frame in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from tolerances import FAR_POSITION

from dofbench.core.digests import write_with_digest
from dofbench.core.files import read_json
from dofbench.core.progress import Silent
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.synthesis import check_dataset, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes.loading import load_scene
from dofbench.scenes.readers.poses import llff_to_opencv

AT = (448262.0, 5411932.0, 135.0)


@pytest.fixture(scope="module")
def far(write_scene, tmp_path_factory) -> Path:
    """A dataset of the scene in a UTM zone. Nobody writes to it."""
    root = tmp_path_factory.mktemp("far")
    scene = write_scene(root / "planes", offset=AT)
    return make_dataset(MakeDataset(scene=str(scene), out=root / "out"), progress=Silent())


def close(found, expected) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=FAR_POSITION)


def test_it_is_the_dataset_of_the_scene_near_the_origin(far, dataset_folder):
    near, dataset = Dataset.load(dataset_folder), Dataset.load(far)
    assert np.abs(np.array(dataset.offset) - AT).max() < 10 and near.offset == (0, 0, 0)
    rest = np.array(AT) - np.array(dataset.offset)  # a small part that the rounded offset doesn't have
    for one, other in zip(near.views, dataset.views, strict=True):
        close(other.camera.centre, one.camera.centre + rest)
        assert other.lens == one.lens and other.physical_lens == one.physical_lens
    close(dataset.points.xyz, near.points.xyz + rest)
    assert dataset.training_set().offset == dataset.offset
    same = {name for name in near.manifest.files if not name.startswith(("sparse", "transforms", "poses", "README"))}
    assert {name for name in same if dataset.manifest.files[name] != near.manifest.files[name]} == set()


def test_its_files_have_the_scenes_own_coordinates(far, dataset_folder):
    near = Dataset.load(dataset_folder)
    centres = np.array([view.camera.centre for view in near.views]) + AT
    frames = read_json(far / "transforms.json")["frames"]
    close([[row[3] for row in frame["transform_matrix"][:3]] for frame in frames], centres)
    rows = np.load(far / "poses_bounds.npy")
    close([llff_to_opencv(row[:15].reshape(3, 5)[:, :4])[:, 3] for row in rows], centres)
    model = pycolmap.Reconstruction(far / "sparse" / "0")
    close([model.images[key].projection_center() for key in sorted(model.images)], centres)
    close([model.points3D[key].xyz for key in sorted(model.points3D)], near.points.xyz + AT)
    stated = read_json(far / "dataset.json")
    assert tuple(stated["offset"]) == Dataset.load(far).offset
    assert "offset" not in read_json(dataset_folder / "dataset.json")


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap", "llff"])
def test_it_is_a_scene_again(far, layout):
    dataset, scene = Dataset.load(far), load_scene(far, layout=layout, images="images")
    assert scene.offset == dataset.offset
    for one, other in zip(scene.views, dataset.views, strict=True):
        close(one.camera.world_to_camera, other.camera.world_to_camera)


def test_it_is_good_and_another_place_is_another_dataset(far, write_scene, tmp_path):
    assert check_dataset(far) == []
    scene = write_scene(tmp_path / "planes", offset=(AT[0] + 1000, *AT[1:]))
    with pytest.raises(ValueError, match="another dataset"):
        make_dataset(MakeDataset(scene=str(scene), out=far), progress=Silent())


def test_the_dataset_says_what_is_subtracted(far, tmp_path):
    """Not the rule once more, whose choice may differ with the points that a dataset has."""
    before = Dataset.load(far)
    content = read_json(far / "dataset.json")
    content["offset"] = [value + 8 for value in content["offset"]]
    other = tmp_path / "other"
    other.mkdir()
    for entry in far.iterdir():
        (other / entry.name).symlink_to(entry)
    (other / "dataset.json").unlink()
    write_with_digest(other / "dataset.json", content)
    close(Dataset.load(other).views[0].camera.centre, before.views[0].camera.centre - 8)
