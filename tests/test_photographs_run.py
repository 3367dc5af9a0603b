"""From photographs of unknown lens to a report, by the command line: shallow ones to train on, sharp ones to test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dofbench import cli
from dofbench.content import content_folder
from dofbench.defocus import defocus_numpy
from dofbench.harness.result import read_result
from dofbench.images import read_image, write_png
from dofbench.lens import Lens
from dofbench.scenes import export, load_scene
from dofbench.synthesis import Dataset
from dofbench.synthesis.disparity import scene_range

HOLD, STEPS, WIDTH = 8, 60, 64
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


def test_photographs_are_trained_on_scored_checked_and_reported(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, results, report = tmp_path / "data", tmp_path / "results", tmp_path / "report"
    assert cli.main(["make-dataset", str(blurred), "--layout", "deblurnerf", "--out", str(data)]) == 0
    assert cli.main(["check", str(data)]) == 0
    run = ["run", "--method", "dofgaussian", "--preset", "smoke", "--data", str(data), "--budget", f"{STEPS}it",
           "--out", str(results)]
    assert cli.main([*run, "--dry-run"]) == 0
    plan = capsys.readouterr().out
    assert "scores aif_psnr, aif_ssim, aif_flip" in plan and "no psnr, ssim" in plan and ": no test lens" in plan
    assert "stage lens: runs: the photographs show circles of confusion" in plan
    assert cli.main(run) == 0
    (folder,) = (path.parent for path in results.rglob("result.json"))
    result = read_result(folder)
    assert result.scores["steps"] == STEPS and not {"psnr", "delta_a"} & result.scores.keys()
    assert (folder / "model" / "lenses.json").is_file(), "learned, though nobody knows how well"
    # The pictures are of the sharp photographs' views, and the start is left behind.
    assert result.curve[-1].scores["aif_psnr"] > result.curve[0].scores["aif_psnr"]
    name = Dataset.load(data).test_views()[0].name
    assert read_image(folder / "predictions" / "all_in_focus" / f"{name}.png").shape == (48, 64, 3)
    assert cli.main(["check", str(results)]) == 0
    assert cli.main(["report", str(results), "--out", str(report)]) == 0
    assert "trained on unknown lenses" in (report / "leaderboard.md").read_text()


def test_photographs_that_are_sharp_after_all_are_trained_on_without_a_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    assert cli.main(["make-dataset", "tabletop", "--width", str(WIDTH), "--photographs", "shallow", "--out",
                     str(data)]) == 0
    assert cli.main(["run", "--method", "dofgaussian", "--preset", "smoke", "--data", str(data), "--budget", "5it",
                     "--out", str(tmp_path / "results")]) == 0
    plan = capsys.readouterr().out
    assert "stage lens: left out: the photographs show" in plan and "lens=False" in plan
    # Beside what the photographs themselves say, the scene's own depth is known.
    assert "scores photo_psnr, photo_ssim, disparity_error, depth_rel" in plan and "photographs-v1" in plan
    assert "no photo_blur_psnr: photographs are predicted by one Gaussian blur in place of a lens: the lens was" in plan
    (file,) = (tmp_path / "results").rglob("result.json")
    result = read_result(file)
    assert 0 < result.scores["disparity_error"] < 1
    assert [len(fit.halves) for fit in result.fits] == [2] * 3 and result.fits[0].halves[0].aperture is None
    assert cli.main(["check", str(tmp_path / "results")]) == 0


def test_shallow_photographs_alone_are_scored_by_half_of_each(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, results, report = tmp_path / "data", tmp_path / "results", tmp_path / "report"
    assert cli.main(["make-dataset", str(blurred), "--photographs", "shallow", "--out", str(data)]) == 0
    assert cli.main(["check", str(data)]) == 0
    assert cli.main(["run", "--method", "dofgaussian", "--preset", "smoke", "--data", str(data), "--budget", "8it",
                     "--out", str(results)]) == 0
    plan = capsys.readouterr().out
    assert "photographs-v1" in plan and "scores photo_psnr, photo_ssim, photo_blur_psnr" in plan
    (file,) = results.rglob("result.json")
    result = read_result(file)
    assert len(result.fits) == len(result.views) == 3 and all(fit.seconds > 0 for fit in result.fits)
    assert all(half.aperture >= 0 for fit in result.fits for half in fit.halves)
    assert "photo_psnr" in result.curve[-1].scores
    assert cli.main(["check", str(results)]) == 0
    assert cli.main(["report", str(results), "--out", str(report)]) == 0
    assert "photograph PSNR" in (report / "leaderboard.md").read_text()


def test_sharp_photographs_to_train_on_are_asked_for_in_vain(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    assert cli.main(["make-dataset", str(blurred), "--layout", "deblurnerf", "--out", str(data)]) == 0
    capsys.readouterr()
    assert cli.main(["run", "--method", "dofgaussian", "--data", str(data), "--inputs", "all-in-focus"]) == 2
    line = capsys.readouterr().err
    assert "no all-in-focus photograph of 17 training views" in line and line.count("\n") == 1
