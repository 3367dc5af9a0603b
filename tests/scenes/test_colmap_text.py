"""COLMAP's text models as people have them: blanks in names, lines that are missing, headers that count."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from tolerances import POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap
from dofbench.scenes.readers.colmap import read_model

NAMES = ["c.png", "a.png", "b.png"]


def as_text(root):
    """Turn sparse/0 into text, as COLMAP before 3.12 wrote it: without rigs and frames."""
    model = root / "sparse/0"
    pycolmap.Reconstruction(str(model)).write_text(str(model))
    for file in (*model.glob("*.bin"), model / "rigs.txt", model / "frames.txt"):
        file.unlink()
    return model


@pytest.fixture
def cameras(make_cameras):
    return make_cameras(3)


@pytest.fixture
def model(tmp_path, cameras, make_cloud, write_images):
    write_images(tmp_path / "images", NAMES)
    write_colmap(tmp_path, NAMES, cameras, make_cloud(cameras))
    return as_text(tmp_path)


def edit(file, change):
    """Change the lines with data; the header stays."""
    lines = file.read_text().split("\n")[:-1]
    head = [line for line in lines if line.startswith("#")]
    file.write_text("\n".join([*head, *change(lines[len(head) :])]) + "\n")


def assert_same(found, expected):
    assert found.names == expected.names
    for ours, theirs in zip(found.world_to_camera, expected.world_to_camera, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=POSE_ROUND_TRIP)
    np.testing.assert_array_equal(found.points.xyz, expected.points.xyz)
    for ours, theirs in zip(found.points.views, expected.points.views, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_names_with_blanks_are_whole(tmp_path, cameras, write_images):
    names = ["DJI 2024 (1).png", "DJI 2024 (2).png", "DJI  two blanks.png"]
    # Other photographs have the first word for a name: cut names would take these.
    write_images(tmp_path / "images", ["DJI.png", *names])
    write_colmap(tmp_path, names, cameras, None)
    as_text(tmp_path)
    scene = load_scene(tmp_path)
    assert sorted(view.source.name for view in scene.views) == sorted(names)
    by_file = {view.source.name: view for view in scene.views}
    for name, camera in zip(names, cameras, strict=True):
        np.testing.assert_allclose(by_file[name].camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)
        assert np.array_equal(by_file[name].image(), read_image(tmp_path / "images" / name))


@pytest.mark.parametrize("header", [True, False])
def test_images_without_their_second_lines(model, header):
    expected = read_model(model)
    edit(model / "images.txt", lambda lines: lines[::2])
    if not header:
        text = (model / "images.txt").read_text().split("\n")
        (model / "images.txt").write_text("\n".join(line for line in text if not line.startswith("#")))
    found = read_model(model)
    assert_same(found, expected)
    assert found.notes and not expected.notes


def test_blank_second_lines_are_as_good_as_full_ones(model):
    expected = read_model(model)
    edit(model / "images.txt", lambda lines: [part for line in lines[::2] for part in (line, "")])
    found = read_model(model)
    assert_same(found, expected)
    assert not found.notes
    (model / "images.txt").write_text((model / "images.txt").read_text().rstrip("\n"))  # as editors leave it
    assert_same(read_model(model), expected)


def test_one_second_line_that_is_missing(model):
    (model / "points3D.txt").write_text("")
    expected = read_model(model)
    edit(model / "images.txt", lambda lines: [*lines[:1], *lines[2:]])
    found = read_model(model)
    assert found.names == expected.names and "1 of 3" in found.notes[0]


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_points_that_are_gone_are_named(model, suffix):
    whole = read_model(model)
    if suffix == ".bin":
        reconstruction = pycolmap.Reconstruction(str(model))
        reconstruction.write_binary(str(model))
        file = model / "points3D.bin"
        content = file.read_bytes()
        end = 8
        for _ in range(5):
            end += 51 + 8 * int.from_bytes(content[end + 43 : end + 51], "little")
        file.write_bytes((5).to_bytes(8, "little") + content[8:end])
    else:
        lines = (model / "points3D.txt").read_text().split("\n")
        (model / "points3D.txt").write_text("\n".join([line for line in lines if not line.startswith("#")][:5]))
    found = read_model(model)
    assert len(found.points) == 5 and not whole.notes
    assert any("has 5 points" in note for note in found.notes)


def test_byte_order_marks_and_line_ends_of_windows(model):
    expected = read_model(model)
    for file in model.iterdir():
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert_same(read_model(model), expected)


@pytest.mark.parametrize("part", ["cameras", "images", "points3D"])
def test_a_header_that_contradicts_the_lines_is_refused(model, part):
    keep = 0 if part == "cameras" else -2
    edit(model / f"{part}.txt", lambda lines: lines[:keep])
    with pytest.raises(InputError, match=rf"{part}\.txt: found \d+ \w+, expected the \d+ that its header counts"):
        read_model(model)


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("images", lambda lines: [*lines[:2], *lines], "a second time in line"),
        ("images", lambda lines: [lines[0].rsplit(" ", 1)[0], *lines[1:]], "line 5"),
        ("images", lambda lines: [lines[0], lines[1] + " 7", *lines[2:]], "of its 2D|words"),
        ("images", lambda lines: [line.replace("a.png", "b.png") for line in lines], r"several images called b\.png"),
        ("images", lambda lines: [line.replace("a.png", "../a.png") for line in lines], r"a path with \.\."),
        ("points3D", lambda lines: [*lines[:-1], lines[-1].rsplit(" ", 1)[0]], "a point and its whole track"),
        ("images", lambda lines: [line.replace("a.png", "ä.png") for line in lines], "no UTF-8 text"),
    ],
)
def test_contradictions_are_refused(model, part, change, said):
    edit(model / f"{part}.txt", change)
    if "UTF" in said:
        file = model / "images.txt"
        file.write_bytes(file.read_text().encode("latin-1"))
    with pytest.raises(InputError, match=said):
        read_model(model)


def test_two_images_of_one_name_in_a_binary_model(tmp_path, cameras, write_images):
    write_images(tmp_path / "images", NAMES)
    write_colmap(tmp_path, ["a.png", "a.png", "b.png"], cameras, None)
    with pytest.raises(InputError, match=r"several images called a\.png"):
        load_scene(tmp_path)


def test_a_rig_of_two_cameras(tmp_path, cameras, write_images):
    """Poses of a rig: sensors that a frame moves together, each with its camera, in text and in binary."""
    rig = pycolmap.Rig(rig_id=1)
    model = pycolmap.Reconstruction()
    sizes = {1: (48, 36), 2: (60, 60)}
    for key, (width, height) in sizes.items():
        focal = 50.0 + key
        model.add_camera(
            pycolmap.Camera(
                camera_id=key, model="PINHOLE", width=width, height=height, params=[focal, focal, width / 2, height / 2]
            )
        )
    rig.add_ref_sensor(pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=1))
    aside = pycolmap.Rigid3d(np.array([[1.0, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0]]))
    rig.add_sensor(pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=2), aside)
    model.add_rig(rig)
    expected = {}
    for index in range(2):
        frame = pycolmap.Frame(frame_id=index + 1, rig_id=1)
        pose = cameras[index].world_to_camera[:3]
        frame.rig_from_world = pycolmap.Rigid3d(pose)
        images = []
        for key, (width, height) in sizes.items():
            name = f"cam{key}/{index}.png"
            image = pycolmap.Image(name, np.empty((0, 2)), camera_id=key, image_id=10 * index + key)
            image.frame_id = index + 1
            frame.add_data_id(image.data_id)
            images.append(image)
            write_images(tmp_path / "images", [name], (width, height))
            expected[name] = (width, 50.0 + key, pose[:, 3] - [0.5 * (key == 2), 0, 0])
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
    folder = tmp_path / "sparse/0"
    folder.mkdir(parents=True)
    for write, suffix in ((model.write_binary, ".bin"), (model.write_text, ".txt")):
        for file in folder.iterdir():
            file.unlink()
        write(str(folder))
        assert (folder / f"rigs{suffix}").is_file() and (folder / f"frames{suffix}").is_file()
        scene = load_scene(tmp_path)
        assert [view.name for view in scene.views] == ["cam1_0", "cam1_1", "cam2_0", "cam2_1"]
        for view in scene.views:
            width, focal, translation = expected[view.source.relative_to(tmp_path / "images").as_posix()]
            assert (view.camera.width, view.camera.fx) == (width, focal)
            np.testing.assert_allclose(view.camera.world_to_camera[:3, 3], translation, atol=POSE_ROUND_TRIP)


def test_poses_of_images_that_contradict_those_of_frames(tmp_path, model):
    for write in ("write_text", "write_binary"):
        getattr(pycolmap.Reconstruction(str(model)), write)(str(model))
        read_model(model)  # one pose in both files
    file = model / "images.bin"
    content = file.read_bytes()
    file.write_bytes(content[:44] + np.float64(7).tobytes() + content[52:])  # the first image's translation along x
    with pytest.raises(InputError, match=r"images\.bin: found another pose of .* than in frames\.bin"):
        read_model(model)
    for binary in model.glob("*.bin"):
        binary.unlink()

    def moved(lines):
        words = lines[0].split()
        return [" ".join([*words[:5], "7", *words[6:]]), *lines[1:]]

    edit(model / "images.txt", moved)
    with pytest.raises(InputError, match=r"images\.txt: found another pose of .* than in frames\.txt"):
        read_model(model)
