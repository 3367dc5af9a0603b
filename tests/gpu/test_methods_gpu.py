"""Every method whose card offers a GPU, on a pretended one: it trains, is kept and rendered there as on the CPU."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up import Recorder
from pretended_device import pretended
from tiny_scene import TINY_FIELD, tiny_scene
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.contracts import Rendering
from dofbench.core.errors import Status
from dofbench.core.lens import PhysicalLens
from dofbench.methods.cards import find_method, method_files

METHODS = sorted(name for name in method_files() if "cuda" in find_method(name).card.devices)
LENS = PhysicalLens(aperture=8.0, focus_disparity=1 / 6, width=12)
STEPS = 1  # test_training_gpu.py and test_field_training_gpu.py compare trainings step by step
OF_FIELDS = {**TINY_FIELD, "lens_points": 2, "patch_side": 4}  # as far as a method has them


def kept(name: str, device: str, folder: Path) -> list[Rendering]:
    """What a trained model renders that was read back from its files."""
    entry = find_method(name)
    _, options, _ = entry.preset("smoke")
    camera = tiny_scene().views[0].camera
    if "field" in entry.card.kernels:
        camera = camera.resized(4, 3)
        known = {option.name for option in entry.method_class().available_options()}
        options = {**options, **{name: value for name, value in OF_FIELDS.items() if name in known}}
    method, scene = entry.create(options, 0, device), tiny_scene()
    assert method.fit(scene, Budget(steps=STEPS), Recorder()).status is Status.OK
    assert method.describe().get("device_peak_mb") == {"cpu": None, "cuda": 5.0}[device]
    method.save(folder)
    again = entry.create({}, 0, device)
    again.load(folder)
    lenses = [None, LENS] if entry.card.capabilities.refocus else [None]
    return [again.render(camera, lens) for lens in lenses]


@pytest.mark.parametrize("name", METHODS)
def test_it_trains_is_kept_and_rendered_as_on_the_cpu(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    expected = kept(name, "cpu", tmp_path)
    with pretended(monkeypatch):
        found = kept(name, "cuda", tmp_path)
    for here, there in zip(expected, found, strict=True):
        np.testing.assert_allclose(there.image, here.image, rtol=0, atol=FLOAT32_VALUE)
        np.testing.assert_allclose(there.depth, here.depth, rtol=FLOAT32_VALUE)
