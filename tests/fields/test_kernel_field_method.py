"""Radiance fields with blur kernels learn, and render without the kernel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import Recorder
from small_scene import cameras, field_options, training_set
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import InputError, Status
from dofbench.methods.deblurnerf.method import DeblurNeRF
from dofbench.methods.dpnerf.method import DPNeRF
from dofbench.methods.pdrf.method import PDRF
from dofbench.training.fields.blur_kernels import unit_of_depth
from dofbench.training.fields.field_method import FieldMethod

SHORT = field_options()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [DeblurNeRF, DPNeRF, PDRF])
def test_it_learns_and_renders_without_its_kernel(kind: type[FieldMethod], tmp_path: Path) -> None:
    method, recorder = kind(SHORT, 0, "cpu"), Recorder()
    assert method.fit(training_set(), Budget(), recorder).status is Status.OK
    assert np.mean(recorder.losses[-20:]) < 0.8 * np.mean(recorder.losses[2:20])
    method.save(tmp_path)
    plain = kind({}, 0, "cpu")
    plain.load(tmp_path)
    for camera in cameras():
        assert np.array_equal(plain.render(camera, None).image, method.render(camera, None).image)


def test_the_unit_follows_the_nearest_points() -> None:
    shown = training_set()
    assert unit_of_depth(shown) == pytest.approx(0.75 * 3.0, rel=FLOAT32_VALUE)
    assert shown.points is not None
    farther = TrainingSet(shown.views, replace(shown.points, xyz=2 * shown.points.xyz))
    assert unit_of_depth(farther) > 1.9 * unit_of_depth(shown)


def test_a_kernel_has_at_least_two_points() -> None:
    with pytest.raises(InputError, match="kernel_points"):
        DeblurNeRF({"kernel_points": 1}, 0, "cpu")
