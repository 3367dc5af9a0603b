"""What is compiled before a training of Gaussians."""

from __future__ import annotations

import pytest
from made_up import Recorder, cloud, frontal
from small_scene import training_set

from dofbench.core.budget import Budget
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians import trainer, warmup
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, ["rasterize", "ssim", "surface", "tone", "scatter"]),
        ({"lens": False}, ["rasterize", "ssim", "surface"]),
        ({"lens": False, "colour_per_view": "affine"}, ["rasterize", "ssim", "surface", "colours"]),
        ({"lens": False, "depth_prior": "stereo"}, ["rasterize", "stereo", "ssim", "surface"]),
    ],
)
def test_the_kernels_of_the_training_are_compiled_before_it(
    options: dict[str, object], expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise their compilation would count as training."""
    compiled: list[str] = []
    monkeypatch.setattr(warmup, "compile_all", lambda ops, device: compiled.extend(ops))
    warmup.compile_kernels(_gaussians(), frontal(4, 4, 4.0), GaussianOptions.of(**options), (), False)
    assert compiled == expected


def test_each_other_geometry_is_rasterised_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[object] = []
    monkeypatch.setattr(warmup, "compile_all", lambda ops, device: None)
    monkeypatch.setattr(warmup, "_rasterise_once", lambda *given: found.append(given[-1]))
    later = ("full", "depth", "none", "full")
    warmup.compile_kernels(_gaussians(), frontal(4, 4, 4.0), GaussianOptions(), later, False)
    assert sorted(map(str, found)) == ["full", "none"]


def _gaussians() -> Gaussians:
    return Gaussians.from_points(cloud([(0, 0, 2.0), (0, 1, 2.0), (1, 0, 2.0), (1, 1, 2.0)]), 0)


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
    monkeypatch.setattr(warmup, "compile_all", lambda ops, device: None)
    options = GaussianOptions.of(grow_absolute=absolute)
    warmup.compile_kernels(_gaussians(), frontal(4, 4, 4.0), options, ("full",), True)
    assert asked == [absolute, absolute]
