"""The public names of `dofbench`: fast to import, complete, documented."""

from __future__ import annotations

import base64
import dataclasses
import inspect
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from called import imported_by
from fake_method import fake_run
from small_dataset import write_dataset
from tolerances import LEVEL_8BIT

import dofbench

NAMES = [name for name in dofbench.__all__ if not name.startswith("_")]


def test_import_is_light() -> None:
    loaded = imported_by("import dofbench")
    assert not {"numpy", "torch", "pydantic", "numba", "tyro"} & loaded
    assert {name for name in loaded if name.startswith("dofbench")} == {"dofbench"}


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        _ = dofbench.nothing


def test_completion_shows_the_public_names_alone() -> None:
    import dofbench.core.files  # makes modules attributes of the package
    import dofbench.reporting

    assert set(dir(dofbench)) == set(dofbench.__all__) and "core" in vars(dofbench)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_there_and_documented(name: str) -> None:
    thing = getattr(dofbench, name)
    if inspect.isclass(thing) or inspect.isfunction(thing):  # else a table: its type's docstring says what it holds
        assert thing.__doc__ and not thing.__doc__.startswith(f"{name}("), "dataclass made the docstring up"


def _parameters_with_paths() -> list[tuple[str, str]]:
    found = []
    for name in NAMES:
        thing = getattr(dofbench, name)
        if dataclasses.is_dataclass(thing) and hasattr(thing, "__pydantic_fields__"):
            continue  # options, which convert what they are given
        functions = {name: thing} if inspect.isfunction(thing) else {}
        if inspect.isclass(thing) and thing is not dofbench.Method:
            functions = {f"{name}.{key}": one for key, one in vars(thing).items() if not key.startswith("_")}
        for label, function in functions.items():
            function = getattr(function, "__func__", function)
            for key, kind in getattr(function, "__annotations__", {}).items():
                if key != "return" and "Path" in str(kind):
                    found.append((f"{label} {key}", str(kind)))
    return found


def test_every_path_may_be_text() -> None:
    parameters = _parameters_with_paths()
    assert {"read_image path", "Dataset.load folder", "load_run data"} <= {name for name, _ in parameters}
    assert [name for name, kind in parameters if "str" not in kind] == []


def test_paths_given_as_text_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "data")
    image = dofbench.Dataset.load("data").image("v0")
    dofbench.write_png("deep.png", image, bits=16)
    dofbench.write_png("copy.png", image)
    assert np.array_equal(dofbench.read_image("copy.png"), image)
    assert np.abs(dofbench.read_image("deep.png") - image).max() < LEVEL_8BIT
    assert isinstance(dofbench.check_dataset("data"), list)
    assert len(dofbench.load_scene("data").views) == 6
    assert dofbench.RunSpec(method="3dgs", data="data", out="results").data == Path("data")
    assert dofbench.Report(results="results", merge=("more",)).merge == (Path("more"),)
    assert dofbench.MakeScene(recipe="fence", out="scenes/fence").out == Path("scenes/fence")
    for read in (dofbench.read_result, dofbench.load_run):
        with pytest.raises(dofbench.InputError, match="results"):
            read("results")


def test_images_of_bytes_are_refused_alike(tmp_path: Path) -> None:
    """Read as floats they would be light far above white. A PNG's writer alone takes them, as its levels."""
    levels = np.random.default_rng(1).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    image, depth, lens = levels / np.float32(255), np.full((12, 16), 2.0), dofbench.PhysicalLens(4.0, 0.2, 16)
    camera = dofbench.Camera(16, 12, 20.0, 20.0, 8.0, 6.0, np.eye(4))
    calls = {
        "defocus": lambda given: dofbench.defocus(given, depth, lens),
        "defocus_numpy": lambda given: dofbench.defocus_numpy(given, depth, lens),
        "score_image": lambda given: dofbench.score_image(given, image, ["psnr"]),
        "TrainingView": lambda given: dofbench.TrainingView("a", camera, given),
        "Rendering": lambda given: dofbench.Rendering(given, depth),
        "write_png": lambda given: dofbench.write_png(tmp_path / "a.png", given, bits=16),
    }
    for name, call in calls.items():
        with pytest.raises(dofbench.InputError, match=r"found uint8, expected floats in \[0, 1\]: divide by 255"):
            call(levels)
        assert call(image) is not False, name
    dofbench.write_png(tmp_path / "b.png", levels)
    assert np.array_equal(np.rint(255 * dofbench.read_image(tmp_path / "b.png")), levels)
    with pytest.raises(dofbench.InputError, match="found int64, expected floats"):
        dofbench.write_png(tmp_path / "c.png", levels.astype(np.int64))


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a session holds: a dataset and what it gives, a run and its result."""
    folder = tmp_path_factory.mktemp("things")
    with pytest.MonkeyPatch.context() as patch:
        end = fake_run(folder, patch)()
        run = dofbench.load_run(end.folder)
        dataset, scene, model = run.dataset, dofbench.load_scene(run.data), run.model
        rendering = model.render(dataset.views[0].camera)
    training = dataset.training_set()
    found = [dataset, dataset.views[0], dataset.views[0].camera, training, training.views[0], training.points]
    found += [scene, scene.views[0], run, run.result, model, rendering]
    return {type(one).__name__: one for one in found}


def test_what_a_session_holds_is_shown_in_a_line(things: dict[str, Any]) -> None:
    for name, thing in things.items():
        for shown in (repr(thing), str(thing)):
            assert shown.startswith(f"{name}(") and len(shown) < 300 and "\n" not in shown and "array" not in shown, (
                shown
            )


def pictures(page: str) -> list[np.ndarray]:
    """The pictures of a fragment of HTML, decoded."""
    import cv2

    coded = re.findall(r'src="data:image/webp;base64,([^"]+)"', page)
    return [cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_COLOR) for one in coded]


def test_datasets_runs_and_renderings_have_a_picture(things: dict[str, Any]) -> None:
    for name, least in {"Dataset": 3, "LoadedRun": 2, "Rendering": 2}.items():
        page = things[name]._repr_html_()
        found = pictures(page)
        assert len(found) >= least and all(max(one.shape) <= 220 for one in found) and len(page) < 100_000, name
    first = pictures(things["Rendering"]._repr_html_())[0][..., ::-1] / 255
    assert np.abs(first - np.clip(things["Rendering"].image, 0, 1)).mean() < 0.05  # WebP at full size
    assert "PSNR" in things["Result"]._repr_html_() and "PSNR" in things["LoadedRun"]._repr_html_()


def test_a_run_whose_files_are_gone_is_shown_all_the_same(things: dict[str, Any], tmp_path: Path) -> None:
    shutil.copy(things["LoadedRun"].folder / "result.json", tmp_path / "result.json")
    page = dofbench.load_run(tmp_path, tmp_path / "nowhere")._repr_html_()
    assert pictures(page) == [] and "PSNR" in page
