"""Points of transforms.json: its own .ply, or a COLMAP model in the same folder, in one frame with the poses or not."""

import json

import numpy as np
import pytest
from made_up import ply_text
from tolerances import POSE_ROUND_TRIP
from transforms_file import edit

from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap


@pytest.fixture
def folder(transforms_folder):
    return transforms_folder


def test_points_of_a_ply_file(folder, make_cameras, make_cloud):
    xyz = make_cloud(make_cameras(4)).xyz
    (folder / "points.ply").write_text(ply_text(xyz))
    edit(folder, lambda content: content.update(ply_file_path="points.ply"))
    points = load_scene(folder).points
    np.testing.assert_allclose(points.xyz, xyz)
    assert points.views is None


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_points_of_a_model_follow_the_applied_transform(folder, make_cameras, make_cloud, scale):
    cameras = make_cameras(4)
    cloud = make_cloud(cameras)
    write_colmap(folder, [f"{index}.png" for index in range(4)], cameras, cloud)
    scene = load_scene(folder)
    np.testing.assert_array_equal(scene.points.xyz, cloud.xyz)
    assert all(np.array_equal(a, b) for a, b in zip(scene.points.views, cloud.views, strict=True))
    # nerfstudio turns the world and may scale it; poses in the file are in the new frame, the model's are not.
    turn = np.array([[0.0, 1, 0, 0.5], [0, 0, 1, -2], [1, 0, 0, 3]])

    def change(content):
        content["applied_transform"] = turn.tolist()
        content["applied_scale"] = scale
        for frame in content["frames"]:
            pose = np.vstack([turn, [0, 0, 0, 1]]) @ np.array(frame["transform_matrix"])
            pose[:3, 3] *= scale
            frame["transform_matrix"] = pose.tolist()

    edit(folder, change)
    moved = load_scene(folder)
    np.testing.assert_allclose(moved.points.xyz, scale * (cloud.xyz @ turn[:, :3].T + turn[:, 3]))
    for before, after in zip(scene.views, moved.views, strict=True):
        a, _ = before.camera.project(scene.points.xyz)
        b, _ = after.camera.project(moved.points.xyz)
        np.testing.assert_allclose(a, b, atol=POSE_ROUND_TRIP)


@pytest.fixture
def beside(folder, make_cameras, make_cloud):
    """The same views as a COLMAP model in sparse/0, whole and in one frame with transforms.json."""
    cameras = make_cameras(4)
    write_colmap(folder, [f"{index}.png" for index in range(4)], cameras, make_cloud(cameras))
    return folder


def moved(turn, scale=1.0):
    """Move the file's poses to another frame, without recording it in the file."""

    def change(content):
        for frame in content["frames"]:
            pose = np.array(turn) @ np.array(frame["transform_matrix"])
            pose[:3, 3] *= scale
            frame["transform_matrix"] = pose.tolist()

    return change


# As instant-ngp's scripts leave it: turned upright, moved to the middle, scaled. The last three leave the points
# inside the images, so that only the cameras can tell.
FRAMES = {
    "turned": moved(np.diag([-1.0, 1, -1, 1])),
    "moved": moved([[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    "told wrong": lambda content: content.update(applied_transform=np.diag([-1.0, 1, -1, 1])[:3].tolist()),
    "told a wrong scale": lambda content: content.update(applied_scale=0.5),
    "upside down": moved(np.diag([-1.0, -1, 1, 1])),
    "scaled": moved(np.eye(4), 0.7),
    "tilted": moved([[1, 0, 0, 0], [0, np.cos(0.1), -np.sin(0.1), 0], [0, np.sin(0.1), np.cos(0.1), 0], [0, 0, 0, 1]]),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_model_that_is_good_by_itself_is_not_hidden_by_a_file_in_another_frame(beside, name):
    good = load_scene(beside, layout="colmap")
    edit(beside, FRAMES[name])
    scene = load_scene(beside)
    (note,) = scene.notes
    assert "different frames" in note and "--layout colmap" in note
    assert scene.layout == "colmap" and len(scene.points) == len(good.points)
    for found, expected in zip(scene.views, good.views, strict=True):
        assert np.array_equal(found.camera.world_to_camera, expected.camera.world_to_camera)
    # If a layout is asked for by name, it is read, or the error says why it can't be.
    with pytest.raises(InputError, match="--layout colmap reads the COLMAP model by itself") as caught:
        load_scene(beside, layout="nerfstudio")
    assert "\n" not in str(caught.value)
    assert load_scene(beside, layout="colmap").layout == "colmap" and load_scene(beside, layout="colmap").notes == ()


def test_a_file_in_another_frame_still_says_the_split(beside):
    edit(beside, FRAMES["turned"])
    paths = [frame["file_path"] for frame in json.loads((beside / "transforms.json").read_text())["frames"]]
    edit(beside, lambda content: content.update(train_filenames=[paths[0], *paths[2:]], test_filenames=[paths[1]]))
    scene = load_scene(beside)
    assert scene.layout == "colmap" and [view.name for view in scene.test_views()] == ["1"]
    assert "transforms.json" in scene.split_by
    assert [view.name for view in load_scene(beside, hold=3).test_views()] == ["0", "3"]


def test_refined_poses_are_in_one_frame_with_the_model_that_they_came_from(beside, make_cameras, capsys):
    spread = np.std([camera.camera_to_world[:3, 3] for camera in make_cameras(4)])
    rng = np.random.default_rng(0)

    def refine(content):
        for frame in content["frames"]:
            pose = np.array(frame["transform_matrix"])
            pose[:3, 3] += rng.normal(0, 0.02 * spread, 3)
            frame["transform_matrix"] = pose.tolist()

    edit(beside, refine)
    scene = load_scene(beside)
    assert scene.layout == "nerfstudio" and scene.points.views is not None and capsys.readouterr().err == ""


def test_points_of_its_own_need_no_model(beside, make_cloud, make_cameras, capsys):
    """A file that names its own points is read in its own frame, whatever other models are beside it."""
    edit(beside, lambda content: content.update(applied_transform=np.diag([-1.0, 1, -1, 1])[:3].tolist()))
    xyz = make_cloud(make_cameras(4)).xyz
    (beside / "points.ply").write_text(ply_text(xyz))
    edit(beside, lambda content: content.update(ply_file_path="points.ply"))
    assert load_scene(beside).layout == "nerfstudio" and capsys.readouterr().err == ""


@pytest.mark.parametrize("lacking", ["views", "points", "whole files"])
def test_a_model_that_is_not_complete_does_not_replace_the_file(folder, make_cameras, make_cloud, lacking, capsys):
    cameras = make_cameras(4)[: 3 if lacking == "views" else 4]
    write_colmap(folder, [f"{index}.png" for index in range(len(cameras))], cameras, make_cloud(cameras))
    edit(folder, moved(np.diag([-1.0, 1, -1, 1])))
    if lacking == "points":
        write_colmap(folder, [f"{index}.png" for index in range(4)], cameras, None)
        assert load_scene(folder).layout == "nerfstudio", "without points nothing contradicts the file"
        return
    if lacking == "whole files":
        model = folder / "sparse/0/images.bin"
        model.write_bytes(model.read_bytes()[:-9])
    with pytest.raises(InputError, match="images.bin" if lacking == "whole files" else "--layout colmap"):
        load_scene(folder)
    assert capsys.readouterr().err == ""


def test_a_folder_with_both_from_the_command_line(beside, tmp_path_factory, capsys):
    from dofbench.cli.app import DONE, WRONG_CALL, main

    edit(beside, FRAMES["turned"])
    out = tmp_path_factory.mktemp("made")
    call = ["make-dataset", str(beside), "--photographs", "shallow"]
    assert main([*call, "--out", str(out / "auto")]) == DONE
    assert "read as --layout colmap" in capsys.readouterr().err
    assert main([*call, "--layout", "colmap", "--out", str(out / "asked")]) == DONE
    assert "different frames" not in capsys.readouterr().err
    assert (out / "auto/poses_bounds.npy").read_bytes() == (out / "asked/poses_bounds.npy").read_bytes()
    assert main([*call, "--layout", "nerfstudio", "--out", str(out / "none")]) == WRONG_CALL
    assert "--layout colmap reads the COLMAP model by itself" in capsys.readouterr().err


def test_a_model_of_other_images_gives_points_without_tracks(folder, make_cameras, make_cloud):
    cameras = make_cameras(4)
    write_colmap(folder, [f"frame{index}.png" for index in range(4)], cameras, make_cloud(cameras))
    points = load_scene(folder).points
    assert points is not None and points.views is None
