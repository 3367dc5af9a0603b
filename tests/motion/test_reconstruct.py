"""Photographs in, a scene out: against exact cameras, again with the same bytes, after a kill, and when it fails."""

from __future__ import annotations

import itertools
import json
import shutil
import signal
import time

import cv2
import numpy as np
import pycolmap
import pytest
from called import called, dofbench, killed
from tolerances import (
    FAR_POSITION,
    MOTION_BASELINE,
    MOTION_FOCAL,
    MOTION_ROTATION_DEG,
    POSE_ROUND_TRIP,
    TRIANGULATED_DEPTH,
)

from dofbench.cli import app
from dofbench.core.cameras import NO_OFFSET
from dofbench.core.content import content_folder
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import read_image, write_exr, write_png
from dofbench.core.progress import Silent
from dofbench.scenes import export, load_scene
from dofbench.scenes.reconstruction.kept_steps import wait
from dofbench.scenes.reconstruction.photograph_source import find_source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.reconstructing import run


def result_files(folder):
    """All of a scene but reconstruct.json, which holds how long things took."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "reconstruct.json"
    }


def relative(scene, names):
    """Rotations and distances from each view to the next: what no choice of frame or unit changes, but for a factor."""
    poses = [next(view.camera.world_to_camera for view in scene.views if view.name == name) for name in names]
    steps = [second @ np.linalg.inv(first) for first, second in itertools.pairwise(poses)]
    return np.stack([step[:3, :3] for step in steps]), np.array([np.linalg.norm(step[:3, 3]) for step in steps])


def test_the_scene_is_the_one_that_was_photographed(made, true_scene):
    scene = load_scene(made)
    names = [view.name for view in scene.views]
    assert scene.layout == "colmap" and names == [f"view_{index:03d}" for index in range(6, 12)]
    rotations, distances = relative(scene, names)
    true_rotations, true_distances = relative(true_scene, names)
    cosines = (np.einsum("nij,nij->n", rotations, true_rotations) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < MOTION_ROTATION_DEG
    ratios = distances / true_distances
    assert np.abs(ratios / np.median(ratios) - 1).max() < MOTION_BASELINE
    focal = true_scene.views[0].camera.fx
    assert abs(scene.views[0].camera.fx / focal - 1) < MOTION_FOCAL
    assert scene.points is not None and len(scene.points) > 200 and min(len(track) for track in scene.points.views) >= 2
    assert all(view.exif == Exif(f_number=2.8, focal_length=50.0) for view in scene.views)


def test_the_record_says_what_was_done(made):
    content = json.loads((made / "reconstruct.json").read_text())
    assert content["matching"] == {"mode": "exhaustive", "pairs": 15, "verified_pairs": 15}
    assert [view["registered"] for view in content["views"]] == [True] * 6
    assert all(view["features"] > view["coarse_features"] > 0 and view["points"] > 30 for view in content["views"])
    assert 0 < content["mean_reprojection_error"] < 1 and content["settings"]["seed"] == 0
    assert {"photographs", "features", "matches", "mapping", "undistortion"} <= content["seconds"].keys()
    # 50 mm can't be used without the sensor's width, so the usual field of view was the initial value.
    (camera,) = content["cameras"]
    assert camera["focal_prior"] == pytest.approx(1.2 * 320) and "nothing" in camera["told_by"]
    assert not (made / ".work").exists()


def test_a_finished_scene_is_left_as_it_is(made, photographs, capsys, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in made.rglob("*")}
    assert app.main(["reconstruct", str(photographs), "--out", str(made)]) == 0
    assert "up to date: 6 of 6 photographs have poses" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in made.rglob("*")} == before
    assert app.main(["reconstruct", str(photographs), "--out", str(made), "--seed", "1"]) == 2
    assert "found another reconstruction" in capsys.readouterr().err


@pytest.mark.slow
def test_killed_it_goes_on_and_gives_the_same_bytes(made, photographs, tmp_path):
    out = tmp_path / "again"
    command = dofbench("reconstruct", photographs, "--out", out)
    # Another number of threads, too.
    done = killed(command, (out / ".work/pairs.txt").is_file, environment={"OMP_NUM_THREADS": "2"})
    assert done.returncode == -signal.SIGKILL, done.stdout
    assert (out / ".work/database.db").is_file() and not (out / "reconstruct.json").exists()
    done = called(command, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    assert "6 of 6 photographs have poses" in done.stdout and "features: 6 of 6" in done.stderr
    assert result_files(out) == result_files(made)


def bare(root, layout, offset=NO_OFFSET):
    """The built-in scene's photographs and exact poses, moved by an offset, without its points and depth."""
    scene = load_scene(content_folder("datasets") / "tabletop")
    views = scene.views[6:10]
    names = [f"{view.name}.png" for view in views]
    (root / "images").mkdir(parents=True)
    for view, name in zip(views, names, strict=True):
        shutil.copy(view.source, root / "images" / name)
    cameras = [view.camera for view in views]
    if layout == "llff":
        export.write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([0.5, 9.0], (len(cameras), 1)), offset)
    elif layout == "nerfstudio":
        splits = ["test", "train", "train", "test"]
        paths = [f"images/{name}" for name in names]
        export.write_transforms(root / "transforms.json", paths, cameras, splits=splits, offset=offset)
    else:
        export.write_colmap(root, names, cameras, None, offset)
    return root


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["llff", "nerfstudio", "colmap"])
def test_poses_without_points_are_kept_and_points_found(tmp_path, true_scene, layout, capsys):
    source = bare(tmp_path / "bare", layout)
    if layout == "llff":
        # The error of make-dataset says what to do.
        assert app.main(["make-dataset", str(source), "--out", str(tmp_path / "never"), "--depth", "sfm"]) == 2
        assert f"dofbench reconstruct {source} --out SCENE" in capsys.readouterr().err
    assert app.main(["reconstruct", str(source), "--out", str(tmp_path / "out")]) == 0
    given, found = load_scene(source), load_scene(tmp_path / "out")
    assert [view.split for view in found.views] == [view.split for view in given.views]
    for before, after in zip(given.views, found.views, strict=True):
        np.testing.assert_allclose(after.camera.world_to_camera, before.camera.world_to_camera, atol=POSE_ROUND_TRIP)
        assert after.camera.fx == before.camera.fx
        np.testing.assert_array_equal(after.image(), before.image())
    assert found.points is not None and len(found.points) > 100
    errors = []
    truth = {view.name: view for view in true_scene.views}
    for index, view in enumerate(found.views):
        depth = truth[view.name].depth()
        seen = [point for point, track in enumerate(found.points.views) if index in track]
        pixels, z = view.camera.project(found.points.xyz[seen])
        errors.append(np.abs(z / depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] - 1))
    assert np.median(np.concatenate(errors)) < TRIANGULATED_DEPTH


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
def test_known_poses_far_from_the_origin_stay_where_they_are(tmp_path, layout):
    offset = (448262.0, 5411932.0, 135.0)
    near, far = bare(tmp_path / "near", layout), bare(tmp_path / "far", layout, offset)
    for source in (near, far):
        assert app.main(["reconstruct", str(source), "--out", str(source.with_suffix(".out"))]) == 0
    found = [pycolmap.Reconstruction(tmp_path / f"{name}.out" / "sparse" / "0") for name in ("near", "far")]
    centres, points = (
        [np.array([one.projection_center() for one in model.images.values()]) for model in found],
        [np.array([one.xyz for one in model.points3D.values()]) for model in found],
    )
    np.testing.assert_allclose(centres[1], centres[0] + np.array(offset), rtol=0, atol=FAR_POSITION)
    assert len(points[1]) == len(points[0])
    place = np.median(points[1] - np.array(offset), axis=0)
    np.testing.assert_allclose(place, np.median(points[0], axis=0), rtol=TRIANGULATED_DEPTH)
    given, made = load_scene(far), load_scene(far.with_suffix(".out"))
    for before, after in zip(given.views, made.views, strict=True):
        assert np.allclose(before.camera.centre + given.offset, after.camera.centre + made.offset, atol=FAR_POSITION)
        assert before.split == after.split
    # The same photographs with other poses are another scene.
    assert app.main(["reconstruct", str(near), "--out", str(far.with_suffix(".out"))]) == 2


def test_poses_may_be_ignored(tmp_path):
    source = bare(tmp_path / "bare", "llff")
    rows = np.load(source / "poses_bounds.npy")
    np.save(source / "poses_bounds.npy", rows[:3])
    with pytest.raises(ValueError, match="4 images.*or --poses ignore"):
        find_source(Reconstruct(source, tmp_path / "out"))
    assert find_source(Reconstruct(source, tmp_path / "out", poses="ignore")).kind == "photographs"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda root: None, "no such file or folder"),
        (lambda root: root.mkdir(), "0 photographs, expected at least 3"),
        (lambda root: write_png(root / "a.png", np.full((64, 64, 3), 0.5)), "one photograph, expected at least 3"),
        (
            lambda root: (root.mkdir(), [(root / f"{n}.jpg").write_bytes(b"no") for n in "abc"]),
            "a.jpg: found no readable",
        ),
        (lambda root: root.write_bytes(b"no video"), "a file that is no video"),
    ],
)
def test_a_wrong_source_is_one_line(tmp_path, make, said, capsys):
    make(tmp_path / "in")
    assert app.main(["reconstruct", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "dofbench:" in line]
    assert len(lines) == 1 and said in lines[0]


@pytest.mark.parametrize("out", ["in/scene", "file", "file/below"])
def test_a_wrong_place_is_one_line(tmp_path, out, capsys):
    for name in "abc":
        write_png(tmp_path / "in" / f"{name}.png", np.full((64, 64, 3), 0.5))
    (tmp_path / "file").touch()
    assert app.main(["reconstruct", str(tmp_path / "in"), "--out", str(tmp_path / out)]) == 2
    assert capsys.readouterr().err.startswith("dofbench:")


def test_what_does_not_hang_together_is_no_scene(tmp_path, capsys):
    """Three photographs of different things and one without features: for each the reason and advice are printed."""
    generator = np.random.default_rng(0)
    for name in "abc":
        patches = np.kron(generator.random((32, 32)), np.ones((6, 6)))
        write_png(tmp_path / "in" / f"{name}.png", np.repeat(patches[..., None], 3, axis=2))
    write_png(tmp_path / "in/plain.png", np.full((96, 96, 3), 0.5))
    assert app.main(["reconstruct", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "plain: no pose: 0 features" in said.err and "a: no pose: no other photograph shows" in said.err
    assert "no scene: no 3 of the 4 photographs hang together" in said.err and not said.out
    assert not (tmp_path / "out/reconstruct.json").exists()


@pytest.mark.slow
def test_one_that_does_not_belong_is_left_out_and_named(photographs, tmp_path, capsys):
    source = shutil.copytree(photographs, tmp_path / "in")
    for name in ("view_010", "view_011"):
        (source / f"{name}.png").unlink()
    write_png(source / "wall.png", np.full((240, 320, 3), 0.5))
    assert app.main(["reconstruct", str(source), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert "4 of 5 photographs have poses" in said.out and "wall: no pose: 0 features" in said.err
    assert [view.name for view in load_scene(tmp_path / "out").views] == [f"view_00{n}" for n in range(6, 10)]


def test_make_dataset_names_the_command_for_photographs_without_poses(photographs, tmp_path, capsys):
    assert app.main(["make-dataset", str(photographs), "--out", str(tmp_path / "never")]) == 2
    error = capsys.readouterr().err
    assert "6 photographs without poses" in error and f"dofbench reconstruct {photographs} --out SCENE" in error


@pytest.mark.slow
def test_all_at_once_gives_poses_too(photographs, tmp_path, reconstruct):
    outcome = reconstruct(photographs, tmp_path / "out", mapping="global", matching="retrieval")
    assert outcome.folder is not None
    content = json.loads((tmp_path / "out/reconstruct.json").read_text())
    assert content["mapping"]["how"] == "global" and sum(view["registered"] for view in content["views"]) == 6


@pytest.mark.slow
def test_a_video_becomes_a_scene(photographs, tmp_path, capsys):
    """Of each of five windows of three frames the sharp one is in the middle."""
    writer = cv2.VideoWriter(str(tmp_path / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (320, 240))
    for file in sorted(photographs.glob("*.png"))[:5]:
        sharp = cv2.imread(str(file))
        for frame in (cv2.blur(sharp, (5, 5)), sharp, cv2.blur(sharp, (9, 9))):
            writer.write(frame)
    writer.release()
    command = ["reconstruct", str(tmp_path / "walk.avi"), "--out", str(tmp_path / "out"), "--frames", "5"]
    assert app.main([*command, "--matching", "sequential"]) == 0
    said = capsys.readouterr()
    assert "5 of 5 photographs have poses" in said.out and "frames: 15 of 15" in said.err
    assert [view.name for view in load_scene(tmp_path / "out").views] == [f"frame_{n:06d}" for n in (1, 4, 7, 10, 13)]
    content = json.loads((tmp_path / "out/reconstruct.json").read_text())
    assert content["source"]["kind"] == "video" and content["matching"]["mode"] == "sequential"


def test_waiting_raises_what_the_call_raised_and_looks_meanwhile():
    looks: list[int] = []
    assert wait(lambda: time.sleep(0.3) or 5, lambda: looks.append(1)) == 5
    assert looks
    with pytest.raises(ZeroDivisionError):
        wait(lambda: 1 / 0)


@pytest.mark.slow
def test_photographs_of_light_become_a_scene_of_light(photographs, tmp_path):
    source = tmp_path / "light"
    for file in photographs.glob("*.png"):
        light = read_image(file) ** 2.2
        write_exr(source / f"{file.stem}.exr", np.where(light > 0.8, light * 8, light))
    said: list[str] = []
    outcome = run(Reconstruct(source, tmp_path / "out"), Silent(), say=said.append)
    assert outcome.folder is not None and any("linear light" in line for line in said)
    views = load_scene(outcome.folder).views
    assert len(views) == 6 and all(view.linear is not None for view in views)
    assert max(view.linear().max() for view in views if view.linear is not None) > 4
    assert max(view.image().max() for view in views) <= 1
    assert "linear light" in json.loads((outcome.folder / "reconstruct.json").read_text())["notes"][0]
