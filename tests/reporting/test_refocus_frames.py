"""Refocus frames of a run: rendered once, kept next to the result, and made anew for another model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from relisted import edit_json

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.errors import InputError
from dofbench.core.images import image_size, read_image
from dofbench.core.lens import PhysicalLens
from dofbench.running import refocus_frames as module
from dofbench.running.load_run import LoadedRun, load_run
from dofbench.running.refocus_frames import FRAMES, refocus_frames


class Shades:
    """A method whose pictures are as light as their focus is near. lenses: those that it was given."""

    def __init__(self, learned: dict[str, PhysicalLens] | None = None):
        self.lenses: list[PhysicalLens] = []
        self._learned = learned

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        shape = (camera.height, camera.width)
        self.lenses += [lens] if lens is not None else []
        shade = 0.1 * len(self.lenses) + 0.1
        return Rendering(np.full((*shape, 3), shade, np.float32), np.ones(shape, np.float32))

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        return self._learned


@pytest.fixture
def run(call: Callable) -> Callable[[Shades], LoadedRun]:
    """A function that opens one finished run with another method in place of its own."""
    folder = call().folder

    def opened(method: Shades) -> LoadedRun:
        found = load_run(folder)
        found.__dict__["method"] = method
        return found

    return opened


def test_frames_go_from_far_to_near_and_are_kept(run: Callable[[Shades], LoadedRun]) -> None:
    first = Shades()
    files = refocus_frames(run(first))
    foci = [lens.focus_disparity for lens in first.lenses]
    bounds = run(first).dataset.disparity_range
    assert foci == pytest.approx(np.linspace(bounds.q_min, bounds.q_max, FRAMES)) and len(files) == FRAMES
    shades = [float(read_image(file).mean()) for file in files]
    assert shades == sorted(shades) and len(set(shades)) == FRAMES
    assert {file.parent.parent for file in files} == {run(first).folder}
    again = Shades()
    assert refocus_frames(run(again)) == files and again.lenses == []


def test_another_model_has_frames_of_its_own(run: Callable[[Shades], LoadedRun]) -> None:
    files = refocus_frames(run(Shades()))
    before = files[0].read_bytes()
    edit_json(run(Shades()).folder / "result.json", lambda data: data["model"].update({"model/model.json": "0" * 64}))
    other = Shades()
    other.lenses.append(PhysicalLens(1.0, 0.0, 64))  # so that its shades differ
    refocus_frames(run(other))
    assert len(other.lenses) == FRAMES + 1 and files[0].read_bytes() != before


def test_the_aperture_is_the_median_learned_one(run: Callable[[Shades], LoadedRun]) -> None:
    views = run(Shades()).dataset.training_views()
    openings = dict(zip((view.name for view in views), (3.0, 1.0, 2.0, 9.0, 8.0), strict=False))
    learned = {name: PhysicalLens(one, 0.3, views[0].camera.width) for name, one in openings.items()}
    method = Shades(learned)
    refocus_frames(run(method))
    assert [lens.aperture for lens in method.lenses] == pytest.approx(
        [float(np.median(list(openings.values())))] * FRAMES
    )


def test_frames_are_small(run: Callable[[Shades], LoadedRun], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SIDE", 32)
    (width, height), camera = image_size(refocus_frames(run(Shades()))[0]), run(Shades()).dataset.views[0].camera
    assert max(width, height) == 32 and width / height == pytest.approx(camera.width / camera.height, rel=0.05)


def test_a_method_that_cannot_refocus_has_none(call: Callable) -> None:
    assert refocus_frames(load_run(call(method="pinhole").folder)) == ()
    run = load_run(call(set=("lens=false",)).folder)
    assert refocus_frames(run) == ()
    assert refocus_frames(run) == ()  # which is kept too


def test_slow_frames_and_a_lost_dataset_are_one_line(run: Callable[[Shades], LoadedRun]) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match="a frame, expected at most"):
        patch.setattr(module, "_PATIENCE", 0.0)
        refocus_frames(run(Shades()))
    found = run(Shades())
    for file in Path(found.data).glob("dataset.json"):
        file.unlink()
    with pytest.raises(InputError, match="found no dataset"):
        refocus_frames(found)
