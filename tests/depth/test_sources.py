"""Depth sources: which one is chosen, which input it refuses, and that a reconstruction is trained only once."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import frontal, scene_of

from dofbench.core.errors import InputError
from dofbench.datasets.synthesis.depth_sources import open_source, source_for
from dofbench.training.gaussians import scene_fit
from dofbench.training.gaussians.scene_fit import Surface


def scene(*maps):
    """A scene with one view per depth map; None is a view without one."""
    return scene_of([frontal(4, 3, 4.0)] * len(maps), maps)


PLANE = np.full((3, 4), 2.0, np.float32)


def test_auto_takes_given_depth_only_where_every_view_has_it():
    assert source_for("auto", scene(PLANE, PLANE)) == "given"
    assert source_for("auto", scene(PLANE, None)) == "splat"
    assert source_for("splat", scene(PLANE)) == "splat"
    assert source_for("given", scene(PLANE)) == "given"
    with pytest.raises(InputError, match=r"no depth for 1 of 2 views \(v1 first\)"):
        source_for("given", scene(PLANE, None))


def test_given_depth_is_passed_on(tmp_path):
    there = scene(PLANE)
    source = open_source("given", there, steps=1, seed=0, work=tmp_path)
    estimate = source.estimate(there.views[0])
    np.testing.assert_array_equal(estimate.depth, PLANE)
    np.testing.assert_array_equal(estimate.confidence, np.ones_like(PLANE))
    assert source.id == "given" and source.provenance()


@pytest.mark.parametrize(
    "wrong, word", [(np.ones((4, 3), np.float32), "shape"), (-PLANE, "negative"), (PLANE * np.nan, "NaN")]
)
def test_given_depth_that_can_be_none(tmp_path, wrong, word):
    there = scene(wrong)
    with pytest.raises(InputError, match=word):
        open_source("given", there, steps=1, seed=0, work=tmp_path).estimate(there.views[0])


class FakeReconstruction:
    """A plane at the depth that the file says."""

    def __init__(self, z):
        self.z = z

    def surface(self, camera):
        size = (camera.height, camera.width)
        return Surface(np.full(size, self.z, np.float32), np.full(size, 0.75, np.float32), np.zeros(size))

    def settings(self):
        return {"made": "up"}

    def save(self, path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(str(self.z))

    @staticmethod
    def load(path, *, steps):
        return FakeReconstruction(float(path.read_text()))


def test_a_reconstruction_is_made_once(monkeypatch, tmp_path):
    calls, told = [], []

    def reconstruct(scene, *, steps, seed, progress, at_once):
        calls.append((len(scene.views), steps, seed))
        progress(steps, steps)
        return FakeReconstruction(3.0)

    monkeypatch.setattr(scene_fit, "reconstruct", reconstruct, raising=False)
    monkeypatch.setattr(scene_fit, "Reconstruction", FakeReconstruction, raising=False)
    there = scene(None, None)
    for _ in range(2):
        source = open_source(
            "splat",
            there,
            steps=7,
            seed=5,
            work=tmp_path / "work",
            progress=lambda step, steps: told.append((step, steps)),
        )
        estimate = source.estimate(there.views[1])
        assert estimate.depth.tolist() == np.full((3, 4), 3.0).tolist()
        assert estimate.confidence.tolist() == np.full((3, 4), 0.75).tolist()
        assert source.provenance()["steps"] == 7 and source.provenance()["options"] == {"made": "up"}
    assert calls == [(2, 7, 5)] and told == [(7, 7)]


def test_a_scene_without_points_cannot_be_reconstructed(tmp_path):
    with pytest.raises(InputError, match="points"):
        open_source("splat", scene(None), steps=1, seed=0, work=tmp_path)
