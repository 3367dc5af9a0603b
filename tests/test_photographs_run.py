"""From photographs of unknown lens to a report, by the command line: shallow ones to train on, sharp ones to test."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tolerances import ROUGH_APERTURE

from dofbench.cli import app
from dofbench.core.content import content_folder
from dofbench.core.images import read_image, write_png
from dofbench.core.lens import Lens
from dofbench.datasets.synthesis import Dataset
from dofbench.evaluation.results.result import read_result
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import export, load_scene
from dofbench.scenes.depth.disparity import scene_range

HOLD, STEPS, WIDTH = 8, 60, 64
METRES = 0.5  # to a scene unit
APERTURE, FOCUS = 3.0, (0.2, 0.5, 0.8)  # up to 3.8 px a unit of disparity, as photographs of a common width have


@pytest.fixture(scope="module")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built-in scene at 64x48 in Deblur-NeRF's layout: photographs through a lens, and every eighth a sharp one."""
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH, hold=HOLD)
    root = tmp_path_factory.mktemp("blurred") / "defocustable"
    disparity_range = scene_range(lambda: (view.depth() for view in scene.views))
    for index, view in enumerate(scene.views):
        image = view.image()
        if view.split == "train":
            lens = Lens(APERTURE, FOCUS[index % len(FOCUS)]).physical(disparity_range, WIDTH)
            image, _ = defocus_numpy(image, view.depth(), lens)
        write_png(root / "images" / f"{view.name}.png", image)
    cameras, names = [view.camera for view in scene.views], [f"{view.name}.png" for view in scene.views]
    export.write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (len(cameras), 1)))
    export.write_colmap(root, names, cameras, scene.points)
    (root / f"hold={HOLD}").touch()
    return root


@pytest.fixture(scope="module")
def two_apertures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same scene by one lens at f/2 and, every third view, at f/8, and one view at f/4, which stands alone."""
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH)
    root = tmp_path_factory.mktemp("apertures") / "sitting"
    disparity_range = scene_range(lambda: (view.depth() for view in scene.views))
    lines = ["name,f_number,focal_length_mm,focus_distance_m"]
    for index, view in enumerate(scene.views):
        number = 4.0 if index == 1 else 8.0 if index % 3 == 0 else 2.0
        lens = Lens(2 * APERTURE / number, FOCUS[index % len(FOCUS)]).physical(disparity_range, WIDTH)
        write_png(root / "images" / f"{view.name}.png", defocus_numpy(view.image(), view.depth(), lens)[0])
        lines.append(f"{view.name}.png,{number:g},50,{METRES / lens.focus_disparity:.3f}")
    (root / "exif.csv").write_text("\n".join(lines) + "\n")
    export.write_colmap(
        root, [f"{view.name}.png" for view in scene.views], [view.camera for view in scene.views], scene.points
    )
    return root


def training(data: Path, steps: int, out: Path) -> list[str]:
    """The words of a short training."""
    method = ["run", "--method", "lensselect", "--preset", "smoke"]
    return [*method, "--data", str(data), "--budget", f"{steps}it", "--out", str(out)]


@pytest.mark.slow
def test_one_aperture_predicts_the_photographs_of_another(
    two_apertures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, results = tmp_path / "data", tmp_path / "results"
    make = ["make-dataset", str(two_apertures), "--photographs", "shallow", "--out", str(data)]
    assert app.main([*make, "--train-f-number", "2", "--test-f-number", "8"]) == 0
    assert app.main(["check", str(data)]) == 0
    numbers = {
        split: {view.exif.f_number for view in Dataset.load(data).views if view.split == split}
        for split in ("train", "test")
    }
    assert numbers == {"train": {2.0}, "test": {8.0}}
    run = ["run", "--preset", "smoke", "--data", str(data), "--budget", "8it", "--out", str(results), "--method"]
    assert app.main([*run, "lensselect"]) == 0 and app.main([*run, "mipsplatting"]) == 0
    plan = capsys.readouterr().out
    assert (
        "across-apertures-v2" in plan and "exif_spread, exif_ratio, exif_focus, exif_focus_scatter: the method" in plan
    )
    found = {result.spec.method: result for result in map(read_result, results.rglob("result.json"))}
    lens, none = found["lensselect"], found["mipsplatting"]
    median = sorted(view.aperture for view in lens.apertures)[len(lens.apertures) // 2]
    expected = pytest.approx(median / 4, rel=ROUGH_APERTURE)
    assert all(half.aperture in (None, expected) for fit in lens.fits for half in fit.halves)
    assert {"across_psnr", "across_blurred_psnr", "unscaled_psnr", "in_focus_psnr"} <= lens.scores.keys()
    assert {"photo_fit_psnr", "lens_energy", "lens_seen"} <= lens.scores.keys()
    # Of one f-number there is a spread, once training has moved most of the lenses, and no ratio.
    assert "half of them" in lens.left_out["exif_spread"] and "fewer than two" in lens.left_out["exif_ratio"]
    assert {"across_psnr", "in_focus_blurred_psnr"} <= none.scores.keys() and "unscaled_psnr" in none.left_out
    assert app.main(["check", str(results)]) == 0
    assert app.main(["report", str(results), "--out", str(tmp_path / "report")]) == 0
    page = (tmp_path / "report" / "leaderboard.md").read_text()
    assert "other aperture, PSNR where blurred" in page and "aperture spread" in page


@pytest.mark.slow
def test_an_aperture_that_is_not_determined_is_no_number(two_apertures: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert app.main(["make-dataset", str(two_apertures), "--photographs", "shallow", "--out", str(data)]) == 0
    # After six steps the scene doesn't stand.
    assert app.main([*training(data, 20, tmp_path / "results"), "--set", "lens_measured_at=0.3"]) == 0
    (file,) = (tmp_path / "results").rglob("result.json")
    result = read_result(file)
    (stage,) = (stage for stage in result.plan["stages"] if stage["name"] == "lens_measured")
    assert not stage["runs"]
    assert result.apertures == [] and not {"exif_spread", "exif_ratio"} & result.scores.keys()
    assert result.left_out["exif_ratio"] == stage["reason"]
    assert app.main(["check", str(tmp_path / "results")]) == 0


@pytest.mark.slow
def test_spread_and_ratio_come_from_a_sitting_of_several_apertures(two_apertures: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert app.main(["make-dataset", str(two_apertures), "--photographs", "shallow", "--out", str(data)]) == 0
    for setting, there in (("lens_per=view", {"exif_spread", "exif_ratio"}), ("lens_per=scene", {"exif_ratio"})):
        run = training(data, 60, tmp_path / setting)
        assert app.main([*run, "--set", setting]) == 0
        (file,) = (tmp_path / setting).rglob("result.json")
        result = read_result(file)
        assert result.spec.protocol == "photographs-v2"
        assert {"exif_spread", "exif_ratio"} & result.scores.keys() == there
        assert len(result.apertures) == len(result.foci) == 17
        assert ("exif_focus" in result.scores) == ("exif_focus_scatter" in result.scores) == ("exif_spread" in there)
    assert "all views of an f-number share one aperture" in result.left_out["exif_spread"]
    assert "all views have one learned focus" in result.left_out["exif_focus"]
    assert result.scores["exif_ratio"] == pytest.approx(300), "f/8 : f/2, told apart by nothing"
    stored = json.loads(file.read_text())
    for view in stored["apertures"]:
        view["aperture"] *= 1.5 if view["f_number"] == 8 else 1
    file.write_text(json.dumps(stored))
    assert app.main(["check", str(file.parent)]) == 1
    (file,) = (tmp_path / "lens_per=view").rglob("result.json")
    assert app.main(["check", str(file.parent)]) == 0
    stored = json.loads(file.read_text())
    stored["foci"][0]["distance"] *= 2
    file.write_text(json.dumps(stored))
    assert app.main(["check", str(file.parent)]) == 1


def test_photographs_are_trained_on_scored_checked_and_reported(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, results, report = tmp_path / "data", tmp_path / "results", tmp_path / "report"
    assert app.main(["make-dataset", str(blurred), "--layout", "deblurnerf", "--out", str(data)]) == 0
    assert app.main(["check", str(data)]) == 0
    run = training(data, STEPS, results)
    assert app.main([*run, "--dry-run"]) == 0
    plan = capsys.readouterr().out
    assert "scores aif_psnr, aif_ssim, aif_flip" in plan and "no psnr, ssim" in plan and ": no test lens" in plan
    assert "lens: on (estimated CoC radius up to" in plan
    assert app.main(run) == 0
    (folder,) = (path.parent for path in results.rglob("result.json"))
    result = read_result(folder)
    assert result.scores["steps"] == STEPS and not {"psnr", "delta_a"} & result.scores.keys()
    assert (folder / "model" / "lenses.json").is_file(), "learned, though nobody knows how well"
    # The pictures are of the sharp photographs' views, and the start is left behind.
    assert result.curve[-1].scores["aif_psnr"] > result.curve[0].scores["aif_psnr"]
    name = Dataset.load(data).test_views()[0].name
    assert read_image(folder / "predictions" / "all_in_focus" / f"{name}.png").shape == (48, 64, 3)
    assert app.main(["check", str(results)]) == 0
    assert app.main(["report", str(results), "--out", str(report)]) == 0
    assert "trained on unknown lenses" in (report / "leaderboard.md").read_text()


@pytest.mark.slow
def test_photographs_that_are_sharp_after_all_are_trained_on_without_a_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    assert (
        app.main(["make-dataset", "tabletop", "--width", str(WIDTH), "--photographs", "shallow", "--out", str(data)])
        == 0
    )
    assert app.main([*training(data, 5, tmp_path / "results"), "--verbose"]) == 0
    plan = capsys.readouterr().out
    assert "lens: off (estimated CoC radius" in plan and "lens=False" in plan
    # Beside what the photographs themselves say, the scene's own depth is known.
    assert "photo_psnr, photo_ssim, photo_sharp_psnr" in plan and "photographs-v2" in plan
    assert "no photo_no_lens, photo_at_bound: test views are predicted without a lens: lens dis" in plan
    (file,) = (tmp_path / "results").rglob("result.json")
    result = read_result(file)
    assert 0 < result.scores["disparity_error"] < 1
    assert [len(fit.halves) for fit in result.fits] == [1] * 3 and result.fits[0].halves[0].aperture is None
    assert app.main(["check", str(tmp_path / "results")]) == 0


@pytest.mark.slow
def test_shallow_photographs_alone_are_scored_by_half_of_each(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, results, report = tmp_path / "data", tmp_path / "results", tmp_path / "report"
    assert app.main(["make-dataset", str(blurred), "--photographs", "shallow", "--out", str(data)]) == 0
    assert app.main(["check", str(data)]) == 0
    assert app.main([*training(data, 8, results), "--verbose"]) == 0
    plan = capsys.readouterr().out
    assert "photographs-v2" in plan and "photo_psnr, photo_ssim, photo_sharp_psnr" in plan
    (file,) = results.rglob("result.json")
    result = read_result(file)
    assert len(result.fits) == len(result.views) == 3 and all(fit.seconds > 0 for fit in result.fits)
    assert all(half.aperture is None or half.aperture >= 0 for fit in result.fits for half in fit.halves)
    assert "photo_psnr" in result.curve[-1].scores
    assert app.main(["check", str(results)]) == 0
    assert app.main(["report", str(results), "--out", str(report)]) == 0
    assert "photograph PSNR" in (report / "leaderboard.md").read_text()


def test_sharp_photographs_to_train_on_are_asked_for_in_vain(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    assert app.main(["make-dataset", str(blurred), "--layout", "deblurnerf", "--out", str(data)]) == 0
    capsys.readouterr()
    assert app.main(["run", "--method", "lensselect", "--data", str(data), "--inputs", "all-in-focus"]) == 2
    line = capsys.readouterr().err
    assert "no all-in-focus photograph of 17 training views" in line and line.count("\n") == 1
