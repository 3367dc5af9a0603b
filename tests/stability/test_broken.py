"""Each kind of check fails when the code under test is broken on purpose."""

from __future__ import annotations

from contextlib import nullcontext
from importlib import import_module

import numpy as np
import pytest
import torch

from dofbench.core.budget import Budget
from dofbench.evaluation.stability import files_cases, short_trainings, training_scene
from dofbench.evaluation.stability.case import Setting
from dofbench.evaluation.stability.catalogue import catalogue
from dofbench.evaluation.stability.measure import measured
from dofbench.methods.cards import find_method
from dofbench.runtime.ops import load
from dofbench.training.common import monitor
from dofbench.training.gaussians import trainer
from dofbench.training.gaussians.gaussian_method import GaussianMethod

CPU = Setting("cpu", "float32")
CASES = {case.id: case for case in catalogue()}


def error_of(name: str, setting: Setting = CPU):
    return measured(CASES[name], setting)


@pytest.fixture
def broken(monkeypatch):
    """`broken(op, change)`: the compiled kernel of the op, its result changed."""

    def replace(op: str, change, function: str | None = None) -> None:
        kernel = load(op, "cpu", function=function)
        monkeypatch.setattr(
            import_module(f"dofbench.runtime.ops.{op}.cpu"),
            function or op,
            lambda *args, **options: change(kernel, *args, **options),
        )

    return replace


class Bent(torch.autograd.Function):
    """The identity whose gradient is changed: times a factor, and turned."""

    @staticmethod
    def forward(ctx, value, factor, turn):
        ctx.bend = factor, turn
        return value.clone()

    @staticmethod
    def backward(ctx, gradient):
        factor, turn = ctx.bend
        other = gradient.flip(0) if turn else 0.0
        return factor * gradient + turn * other, None, None


SCATTERS = {
    "without the area term": lambda kernel, *args, **options: kernel(*args, **{**options, "energy": "algorithm1"}),
    "a little brighter": lambda kernel, *args, **options: 1.001 * kernel(*args, **options),
    "with a wider circle": lambda kernel, image, radius, **options: kernel(image, 1.001 * radius, **options),
    "by another edge": lambda kernel, *args, **options: kernel(*args, **{**options, "alpha": 3.9}),
    "shifted by a pixel": lambda kernel, *args, **options: kernel(*args, **options).roll(1, 0),
}


@pytest.mark.parametrize("how", SCATTERS)
def test_a_wrong_scatter_is_not_the_formula(broken, how):
    assert error_of("lens/focus-0").met
    broken("scatter", SCATTERS[how])
    assert not error_of("lens/focus-0").met


def test_a_constant_that_changes_is_seen(broken):
    assert error_of("invariants/constant").met
    broken("scatter", lambda kernel, *args, **options: kernel(*args, **options) + 1e-3)
    assert not error_of("invariants/constant").met


def test_light_that_gets_lost_is_seen(broken):
    assert error_of("invariants/energy-3").met and error_of("light/highlight-1e6").met
    broken("scatter", lambda kernel, *args, **options: 0.999 * kernel(*args, **options))
    assert not error_of("invariants/energy-3").met
    assert not error_of("light/highlight-1e6").met


def test_a_result_that_depends_on_its_place_is_seen(broken):
    def uneven(kernel, image, radius, **options):
        return kernel(image, radius, **options) * torch.linspace(1, 1.01, image.shape[1])[None, :, None]

    assert error_of("invariants/mirrored").met and error_of("invariants/shifted").met
    broken("scatter", uneven)
    assert not error_of("invariants/mirrored").met and not error_of("invariants/shifted").met


SWALLOWED = ("light/nan-in-the-image", "lens/radius-nan", "lens/radius-infinite")


def test_swallowed_numbers_are_seen(broken):
    assert all(error_of(name).met for name in SWALLOWED)
    broken(
        "scatter",
        lambda kernel, image, radius, **options: kernel(
            image.nan_to_num(posinf=1.0), radius.nan_to_num(posinf=5.0, neginf=5.0), **options
        ),
    )
    for name in SWALLOWED:
        assert not error_of(name).met, name


def test_a_leak_at_aperture_0_is_seen(monkeypatch):
    assert error_of("lens/aperture-0").met
    defocus = import_module("dofbench.evaluation.stability.lens_cases").defocus
    monkeypatch.setattr(
        "dofbench.evaluation.stability.lens_cases.defocus",
        lambda *args, **options: defocus(*args, **options) * (1 + 2.0**-23),
    )
    assert not error_of("lens/aperture-0").met


def test_unknown_depth_taken_for_near_is_seen(monkeypatch):
    assert error_of("lens/depth-nan").met and error_of("lens/depth-0").met
    blur = import_module("dofbench.evaluation.stability.lens_cases").defocus_numpy

    def near(image, depth, lens, **options):
        return blur(image, np.where(np.isfinite(depth) & (depth > 0), depth, 0.5), lens, **options)

    monkeypatch.setattr("dofbench.evaluation.stability.lens_cases.defocus_numpy", near)
    assert not error_of("lens/depth-nan").met and not error_of("lens/depth-0").met


@pytest.mark.parametrize(
    "name", ["gaussians/scale-0.1", "images/rasterize-1x9", "gaussians/half-a-pixel", "gaussians/thousand-on-a-tile"]
)
def test_a_wrong_rasteriser_is_not_the_reference(broken, name):
    assert error_of(name).met
    broken(
        "rasterize",
        lambda kernel, *args, **options: kernel(*args, **options)._replace(alpha=1.05 * kernel(*args, **options).alpha),
    )
    assert not error_of(name).met


def test_a_rasteriser_that_goes_by_the_stored_order_is_seen(broken):
    assert error_of("invariants/order").met
    broken("rasterize", lambda kernel, **options: kernel(**{**options, "sh_dc": options["sh_dc"].roll(1, 0)}))
    assert not error_of("invariants/order").met


def test_a_gaussian_that_should_be_left_out_or_refused_is_seen(broken):
    names = ("gaussians/behind", "gaussians/near-plane-on", "gaussians/nan-means")
    assert all(error_of(name).met for name in names)
    broken(
        "rasterize",
        lambda kernel, **options: kernel(
            **{**options, "means": options["means"].nan_to_num(4.0) + torch.tensor([0.0, 0.0, 8.0])}
        ),
    )
    for name in names:
        assert not error_of(name).met, name


@pytest.mark.parametrize(("factor", "turn"), [(1.001, 0.0), (1.0, 0.01), (-1.0, 0.0), (float("nan"), 0.0)])
def test_a_wrong_gradient_is_seen_by_length_and_by_direction(broken, factor, turn):
    assert error_of("gradients/ssim-away").met and error_of("gradients/raster-away-from-kinks").met
    broken(
        "ssim",
        lambda kernel, image, *args, **options: kernel(Bent.apply(image, factor, turn), *args, **options),
        "l1_ssim",
    )
    assert not error_of("gradients/ssim-away").met
    broken(
        "rasterize",
        lambda kernel, **options: kernel(**{**options, "sh_dc": Bent.apply(options["sh_dc"], factor, turn)}),
    )
    assert not error_of("gradients/raster-away-from-kinks").met


def test_a_wrong_loss_and_wrong_scores_are_seen(broken):
    assert error_of("invariants/ssim-of-itself-textured").met and error_of("invariants/stereo-shift").met
    broken("ssim", lambda kernel, *args, **options: kernel(*args, **options) + 1e-3, "l1_ssim")
    assert not error_of("invariants/ssim-of-itself-textured").met and not error_of("images/ssim-1x1").met
    broken("stereo", lambda kernel, *args, **options: kernel(*args, **options).roll(1, 2))
    assert not error_of("invariants/stereo-shift").met


def test_files_that_change_what_they_keep_are_seen(monkeypatch):
    read = files_cases.read_image
    monkeypatch.setattr(files_cases, "read_image", lambda path: read(path) + np.float32(1 / 255))
    for name in ("files/png-8-bit-9x1", "files/alpha-8-bit", "files/one-channel"):
        assert not error_of(name, Setting("numpy", "float32")).met, name


def test_a_half_float_that_overflows_is_seen(monkeypatch):
    assert error_of("files/exr-half", Setting("numpy", "float32")).met
    monkeypatch.setattr("dofbench.core.images._LARGEST_HALF", np.inf)
    assert not error_of("files/exr-half", Setting("numpy", "float32")).met


def test_a_dataset_that_is_not_what_it_says_is_seen(monkeypatch):
    shallow = import_module("dofbench.datasets.synthesis.builder").shallow_image
    monkeypatch.setattr(
        "dofbench.datasets.synthesis.builder.shallow_image", lambda *args: tuple(0.9 * part for part in shallow(*args))
    )
    assert not error_of("datasets/33x17", Setting("numpy", "float32")).met


def test_a_trainer_that_does_not_look_is_seen(monkeypatch):
    assert error_of("training/dofgaussian-planted-nan-lens").met
    monkeypatch.setattr(monitor.Place, "located", lambda *args: nullcontext())
    assert not error_of("training/dofgaussian-planted-nan-lens").met
    assert not error_of("training/dofgaussian-planted-nan-means").met


def test_an_absurd_lens_or_picture_with_status_ok_is_seen(monkeypatch):
    monkeypatch.setattr(short_trainings, "STEPS", 4)
    entry = find_method("dofgaussian")
    assert short_trainings.run(entry, training_scene.scene(3)).wrong == ""
    estimates = trainer.Trainer.lens_estimates

    def blown_up(self):
        return {name: type(lens)(1e9, lens.focus_disparity, lens.width) for name, lens in estimates(self).items()}

    monkeypatch.setattr(trainer.Trainer, "lens_estimates", blown_up)
    assert short_trainings.run(entry, training_scene.scene(3)).wrong != ""
    monkeypatch.setattr(trainer.Trainer, "lens_estimates", estimates)
    render = GaussianMethod.render

    def white_hot(self, camera, lens):
        rendering = render(self, camera, lens)
        return type(rendering)(rendering.image * 1e3, rendering.depth)

    monkeypatch.setattr(GaussianMethod, "render", white_hot)
    assert "times white" in short_trainings.run(entry, training_scene.scene(3)).wrong


def test_a_fit_without_a_status_is_seen(monkeypatch):
    def fails(self, *args):
        raise ZeroDivisionError("nothing left")

    monkeypatch.setattr(trainer.Trainer, "fit", fails)
    end = short_trainings.run(find_method("dofgaussian"), training_scene.scene(3))
    assert end.status == "no status" and "ZeroDivisionError" in end.wrong


def test_a_lens_that_is_not_learned_is_not_found(monkeypatch):
    monkeypatch.setattr(short_trainings, "STEPS", 4)
    entry = find_method("dofgaussian")
    method = entry.create(short_trainings.options_of(entry), 0, "cpu")
    method.fit(training_scene.scene(3), Budget(steps=4), short_trainings.Watch())
    assert not short_trainings.lens_found(method, one_plane=False)
    unit, width = training_scene.true_range(), training_scene.WIDTH
    true = {f"v{k}": training_scene.true_lens(k).physical(unit, width) for k in range(3)}
    monkeypatch.setattr(trainer.Trainer, "lens_estimates", lambda self: true)
    assert short_trainings.lens_found(method, one_plane=False)
