"""Compiling with a second process leaves this one as it was."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator

import pytest
from made_up import Recorder, cloud, frontal
from small_scene import training_set

from dofbench.core.budget import Budget
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians import trainer, warmup
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians


@pytest.fixture
def collecting() -> Iterator[None]:
    """The garbage collector as it was, whatever a test did to it."""
    before = gc.isenabled()
    yield
    (gc.enable if before else gc.disable)()


@pytest.mark.parametrize("enabled", [True, False])
def test_the_garbage_collector_rests_while_compiling_and_is_then_as_before(
    enabled: bool, collecting: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    during = []
    monkeypatch.setattr(sys, "executable", "true")  # the other process has nothing to do
    monkeypatch.setattr(warmup, "is_warm", lambda op, device="cpu": False)
    monkeypatch.setattr(warmup, "_rasterise_once", lambda *_: during.append((gc.isenabled(), _[-1])))
    (gc.enable if enabled else gc.disable)()
    points = cloud([(0, 0, 2.0), (0, 1, 2.0), (1, 0, 2.0), (1, 1, 2.0)])
    later = ("full", "depth", "none")
    warmup.compile_kernels(Gaussians.from_points(points, 0), frontal(4, 4, 4.0), GaussianOptions(), later, False)
    assert gc.isenabled() is enabled
    # The geometry of every training first, beside the other process; then what else comes up, each once.
    assert during[0] == (False, "depth") and {geometry for _, geometry in during[1:]} == {"full", "none"}
    assert len(during) == 3


@pytest.mark.parametrize(("lens", "expected"), [(True, ["scatter", "tone"]), (False, [])])
def test_a_kernel_that_alone_is_cold_is_compiled_before_training(
    lens: bool, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise its compilation would count as training."""
    compiled: list[str] = []
    monkeypatch.setattr(warmup, "is_warm", lambda op, device="cpu": op not in ("scatter", "tone"))
    monkeypatch.setattr(warmup, "warm_up", lambda op, device: compiled.append(op))
    points = cloud([(0, 0, 2.0), (0, 1, 2.0), (1, 0, 2.0), (1, 1, 2.0)])
    options = GaussianOptions.of(lens=lens)
    warmup.compile_kernels(Gaussians.from_points(points, 0), frontal(4, 4, 4.0), options, (), False)
    assert compiled == expected


@pytest.mark.parametrize(
    ("options", "expected"),
    [({}, False), ({"lens_model": "samples"}, True), ({"lens_trials": "lens,model"}, True), ({"lens": False}, False)],
)
def test_views_from_the_lens_are_warmed_up_where_any_model_may_need_them(
    options: dict[str, object], expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Asked(Exception):
        pass

    def asked(*given: object) -> None:
        raise Asked(given[4])

    monkeypatch.setattr(trainer, "compile_kernels", asked)
    with pytest.raises(Asked, match=str(expected)):
        GaussianMethod({"steps": 5, **options}, 0, "cpu").fit(training_set(), Budget(steps=5), Recorder())


@pytest.mark.parametrize("absolute", [True, False])
def test_gradients_by_absolute_values_are_compiled_where_density_control_asks_for_them(
    absolute: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def rasterise(*_: object, statistics: ViewStatistics, **__: object) -> None:
        asked.append(statistics.want_abs)
        raise FloatingPointError

    monkeypatch.setattr(warmup, "rasterise", rasterise)
    monkeypatch.setattr(warmup, "rasterise_from_points", rasterise)
    points = cloud([(0, 0, 2.0), (0, 1, 2.0), (1, 0, 2.0), (1, 1, 2.0)])
    monkeypatch.setattr(warmup, "is_warm", lambda op, device="cpu": True)
    options = GaussianOptions.of(grow_absolute=absolute)
    warmup.compile_kernels(Gaussians.from_points(points, 0), frontal(4, 4, 4.0), options, ("full",), True)
    assert asked == [absolute, absolute]
