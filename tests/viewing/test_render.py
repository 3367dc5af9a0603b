"""`dofbench render` as a user calls it: paths, lenses, sequences, depth, keyframes, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from known_scene import CAMERA
from tolerances import FLOAT64_VALUE, LEVEL_8BIT

from dofbench.cli.app import main
from dofbench.core.errors import InputError
from dofbench.core.images import read_exr, read_image
from dofbench.core.jobs import Outcome
from dofbench.core.lens import PhysicalLens
from dofbench.optics.tone import decode
from dofbench.running.load_run import load_run
from dofbench.viewing import camera_paths
from dofbench.viewing.keyframes import Keyframe, film_of, read_keyframes, write_keyframes
from dofbench.viewing.render import point_at

Call = Callable[..., Outcome]


def frames(folder: Path) -> list[np.ndarray]:
    return [read_image(file) for file in sorted((folder / "frames").glob("*.png"))]


def test_a_still_is_the_methods_own_rendering(call: Call, tmp_path: Path) -> None:
    end, out = call(), tmp_path / "still"
    words = "--path still --frames 1 --format png --aperture 0".split()
    assert main(["render", str(end.folder), "--out", str(out), *words]) == 0
    run = load_run(end.folder)
    view = run.dataset.test_views()[0]
    camera = camera_paths.resized_to(view.camera, view.camera.width)
    expected = run.method.render(camera, PhysicalLens(0.0, 0.2, camera.width)).image
    assert not (out / "film.mp4").exists()
    (found,) = frames(out)
    assert np.abs(found - np.clip(expected, 0, 1)).max() <= 0.51 * LEVEL_8BIT  # half a level, and float32


@pytest.mark.parametrize("path", ["training", "spiral", "orbit", "dolly", "dolly-zoom"])
def test_every_path_makes_frames_of_the_size_asked_for(call: Call, tmp_path: Path, path: str) -> None:
    end, out = call(), tmp_path / path
    words = ["--path", path, "--frames", "3", "--format", "png", "--width", "32"]
    assert main(["render", str(end.folder), "--out", str(out), *words]) == 0
    assert [frame.shape for frame in frames(out)] == [(24, 32, 3)] * 3


def test_linear_frames_and_depth(call: Call, tmp_path: Path) -> None:
    end = call()
    for kind in ("png", "exr"):
        words = f"--path dolly --frames 2 --format {kind} --depth".split()
        assert main(["render", str(end.folder), "--out", str(tmp_path / kind), *words]) == 0
    light = read_exr(tmp_path / "exr" / "frames" / "0002.exr")
    shown = frames(tmp_path / "png")[1]
    # Half a level of an 8-bit PNG, and a half float's 11 bits.
    slope = 2.2 * np.clip(shown + 0.5 / 255, 0, 1) ** 1.2
    assert (np.abs(light - decode(shown)) <= 0.51 * LEVEL_8BIT * slope + 2.0**-11).all()
    assert (read_exr(tmp_path / "exr" / "depth" / "0001.exr") == 1).all(), "the fake's depth"


def test_a_film_ends_in_a_video(call: Call, tmp_path: Path) -> None:
    pytest.importorskip("av", reason="no package av: pip install dofbench[film]")
    out = tmp_path / "film"
    assert main(["render", str(call().folder), "--out", str(out), "--frames", "2"]) == 0
    assert (out / "film.mp4").stat().st_size > 0 and len(frames(out)) == 2


def test_keyframes_lead_camera_and_lens(call: Call, tmp_path: Path) -> None:
    end = call()
    run = load_run(end.folder)
    first, last = (view.camera for view in (run.dataset.training_views()[0], run.dataset.training_views()[-1]))
    path = tmp_path / "keys.json"
    keys = [Keyframe.of(0, first, 0.2, 0.01), Keyframe.of(1, last, 0.5, 0.03)]
    write_keyframes(path, keys[::-1])
    assert read_keyframes(path) == keys, "sorted by moment"
    move, track = film_of(read_keyframes(path), first)
    for moment, camera in ((0.0, first), (1.0, last)):
        assert move(moment).world_to_camera == pytest.approx(camera.world_to_camera, abs=10 * FLOAT64_VALUE)
    lens = track.lens(0.5, move(0.5))
    assert lens.focus_disparity == pytest.approx(0.35) and lens.half_opening(move(0.5)) == pytest.approx(0.02)
    out = tmp_path / "film"
    words = ["--keyframes", str(path), "--frames", "2", "--format", "png"]
    assert main(["render", str(end.folder), "--out", str(out), *words]) == 0
    assert len(frames(out)) == 2


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda keys: keys[0].update(moment=0.5), "moments 0.5, 1"),
        (lambda keys: keys[1].update(moment=0.0), "moments 0, 0"),
        (lambda keys: keys[0].update(extra=1), "keyframes.0.extra"),
        (lambda keys: keys[0].update(half_opening=-1), "half_opening"),
        (lambda keys: keys[1].update(camera_to_world=(2 * np.eye(4)).tolist()), "keyframe 2 that isn't rigid"),
        (lambda keys: keys[1].update(camera_to_world=np.diag([1.0, 1, -1, 1]).tolist()), "isn't rigid"),
        (lambda keys: keys.clear(), "keyframes"),
    ],
)
def test_keyframes_that_are_wrong_are_named(change: Callable[[list[dict]], None], found: str, tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    write_keyframes(path, [Keyframe.of(0, CAMERA, 0.2, 0.01), Keyframe.of(1, CAMERA, 0.5, 0.03)])
    data = json.loads(path.read_text())
    change(data["keyframes"])
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=found):
        read_keyframes(path)


def test_a_point_of_an_image_is_found_in_space() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 2.5, np.float32)
    point = point_at(CAMERA, depth, (0.25, 0.75))
    xy, z = CAMERA.project(point[None])
    assert xy[0] == pytest.approx([0.25 * CAMERA.width, 0.75 * CAMERA.height]) and z[0] == pytest.approx(2.5)
    with pytest.raises(InputError, match="nothing at 0.25,0.75"):
        point_at(CAMERA, np.zeros_like(depth), (0.25, 0.75))


@pytest.mark.parametrize(
    "words",
    [
        "--blades 2",
        "--follow 0.5",
        "--follow 0.5,1.5",
        "--follow 0.5,0.5 --focus 0.3",
        "--keyframes keys.json --path orbit",
        "--keyframes missing.json",
        "--view nobody",
        "--frames 0",
    ],
)
def test_wrong_calls_end_with_status_2(call: Call, tmp_path: Path, words: str) -> None:
    assert main(["render", str(call().folder), "--out", str(tmp_path / "film"), *words.split()]) == 2


def test_frames_of_another_film_are_kept(call: Call, tmp_path: Path) -> None:
    end, out = call(), tmp_path / "film"
    assert main(["render", str(end.folder), "--out", str(out), *"--frames 2 --format png".split()]) == 0
    kept = frames(out)
    assert main(["render", str(end.folder), "--out", str(out), *"--frames 3 --format png".split()]) == 2
    assert all(np.array_equal(one, two) for one, two in zip(kept, frames(out), strict=True))
