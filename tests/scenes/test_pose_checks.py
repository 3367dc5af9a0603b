"""Poses that no points check: one place, and axes or matrices of another convention."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dofbench.core.cameras import Camera
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_transforms
from dofbench.scenes.loading import print_notes

COUNT = 12
FILES = [f"images/{index:02d}.png" for index in range(COUNT)]


def looking(inwards=True, target=(0.3, 0.2, -0.1)):
    """Cameras on two thirds of a circle, a little up and down, that look at a target, or away from it."""
    cameras = []
    for index in range(COUNT):
        angle = 4.2 * index / COUNT
        place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1 + 0.2 * (index % 3)])
        ahead = (np.array(target) - place) * (1 if inwards else -1)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        pose[:3, 3] = -pose[:3, :3] @ place
        cameras.append(Camera(48, 36, 50.0, 50.0, 24.0, 18.0, pose))
    return cameras


@pytest.fixture
def folder(tmp_path, write_images):
    write_images(tmp_path, FILES)
    write_transforms(tmp_path / "transforms.json", FILES, looking())
    return tmp_path


def change(folder, of_matrix):
    file = folder / "transforms.json"
    content = json.loads(file.read_text())
    for frame in content["frames"]:
        frame["transform_matrix"] = of_matrix(np.array(frame["transform_matrix"])).tolist()
    file.write_text(json.dumps(content))


FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def test_good_poses_have_no_note_but_are_said_to_be_unchecked(folder, capsys):
    scene = load_scene(folder)
    assert not scene.notes
    print_notes(scene)
    assert "poses are not checked" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("of_matrix", "said"),
    [
        (lambda m: m @ FLIP, "behind the cameras"),  # OpenCV's axes
        (lambda m: np.linalg.inv(m), "inverted"),  # OpenGL's, world-to-camera
        (lambda m: np.linalg.inv(m @ FLIP), "inverted"),  # OpenCV's, world-to-camera
    ],
)
def test_other_conventions_are_named(folder, of_matrix, said):
    change(folder, of_matrix)
    assert any(said in note for note in load_scene(folder).notes)


def test_world_to_camera_matrices_of_an_orbit_about_the_origin(folder):
    """All cameras stand at one place then."""
    write_transforms(folder / "transforms.json", FILES, looking(target=(0.0, 0.0, 0.0)))
    change(folder, np.linalg.inv)
    assert any("inverted" in note for note in load_scene(folder).notes)


def test_notes_on_other_arrangements_of_cameras(folder, make_cameras):
    write_transforms(folder / "transforms.json", FILES, looking(inwards=False))
    assert any("look outwards" in note for note in load_scene(folder).notes)
    write_transforms(folder / "transforms.json", FILES, make_cameras(COUNT))
    assert not load_scene(folder).notes
    change(folder, lambda m: m @ FLIP)
    assert not load_scene(folder).notes


def test_one_position_and_one_pose_are_said(folder):
    def still(matrix):
        return np.block([[matrix[:3, :3], np.full((3, 1), 2.0)], [np.zeros((1, 3)), np.ones((1, 1))]])

    change(folder, still)
    assert any("at one position" in note for note in load_scene(folder).notes)
    change(folder, lambda matrix: np.eye(4))
    assert any("12 cameras have one pose" in note for note in load_scene(folder).notes)


def test_points_check_poses(folder, make_cloud, capsys):
    cameras = looking(inwards=False)
    (folder / "transforms.json").unlink()
    rng = np.random.default_rng(0)
    cloud = make_cloud(cameras, tracks=False)
    directions = rng.normal(size=cloud.xyz.shape)
    cloud.xyz[:] = 20 * directions / np.linalg.norm(directions, axis=1, keepdims=True) * [1, 1, 0.1]
    write_colmap(folder, [file.removeprefix("images/") for file in FILES], cameras, cloud)
    scene = load_scene(folder)
    assert not scene.notes
    print_notes(scene)
    assert "not checked" not in capsys.readouterr().err
