"""Every shipped method through the contract, on two small photographs: it learns what its card says that it can, calls
the kernels that its card names, and comes back from its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up import Recorder, record_ops
from small_scene import cameras, training_set
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.errors import Status
from dofbench.core.lens import PhysicalLens
from dofbench.methods.cards import find_method

METHODS = sorted(file.parent.name for file in content_folder("methods").glob("*/method.toml"))
LENS = PhysicalLens(aperture=30.0, focus_disparity=1 / 6, width=48)


# Each field takes seconds; of these the first and the paper's rival stand for the rest in the fast suite.
SLOW = {"deblurnerf", "dpnerf", "lensnerf", "pdrf"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in METHODS]
)
def test_it_keeps_the_contract(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    called = record_ops(monkeypatch)
    entry, given, camera = find_method(name), training_set(), cameras()[0]
    _, options, _ = entry.preset("smoke")
    method, recorder = entry.create({**options, "steps": 40}, 0, "cpu"), Recorder()
    outcome = method.fit(given, Budget(steps=40), recorder)
    assert outcome.status is Status.OK and outcome.steps == 40 == len(recorder.losses), outcome.message
    # Later than the first steps, since blur that begins later may come with a second term of the loss.
    assert np.mean(recorder.losses[-9:]) < np.mean(recorder.losses[4:13])
    can, sharp = entry.card.capabilities, method.render(camera, None)
    assert sharp.image.shape == given.views[0].image.shape and np.isfinite(sharp.image).all()
    assert (sharp.depth > 0).any()
    estimates = method.lens_estimates()
    assert (set(estimates) == {view.name for view in given.views}) if can.learns_lens else estimates is None
    if can.refocus:
        assert np.abs(method.render(camera, LENS).image - sharp.image).max() > 0.01
    else:
        with pytest.raises(ValueError, match="no lens"):
            method.render(camera, LENS)
    assert called <= set(entry.card.kernels)
    method.save(tmp_path)
    again = entry.create({}, 0, "cpu")
    again.load(tmp_path)
    assert np.abs(again.render(camera, None).image - sharp.image).max() < FLOAT32_VALUE
    assert again.lens_estimates() == estimates
