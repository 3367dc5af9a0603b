"""Each kind of check fails when the code under test is broken on purpose."""

from __future__ import annotations

from contextlib import nullcontext
from importlib import import_module

import numpy as np
import pytest
import torch

from dofbench.core.budget import Budget
from dofbench.evaluation.stability import files_cases, lens_cases, short_trainings, training_scene
from dofbench.evaluation.stability.case import Setting
from dofbench.evaluation.stability.catalogue import catalogue
from dofbench.evaluation.stability.measure import measured
from dofbench.methods.cards import find_method
from dofbench.optics.defocus import defocus_numpy, scatter_defocus
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


def scatter(change):
    return lambda kernel, image, radius, **options: change(kernel(image, radius, **options))


def filled(kernel, image, radius, **options):
    return kernel(image.nan_to_num(posinf=1.0), radius.nan_to_num(posinf=5.0, neginf=5.0), **options)


def moved_nearer(kernel, **options):
    means = options["means"].nan_to_num(4.0) + torch.tensor([0.0, 0.0, 8.0])
    return kernel(**{**options, "means": means})


def opaque(kernel, *args, **options):
    return kernel(*args, **options)._replace(alpha=1.05 * kernel(*args, **options).alpha)


# (op, its function, what replaces it, cases that must then fail)
BROKEN = {
    "no area term": ("scatter", None, lambda k, *a, **o: k(*a, **{**o, "energy": "algorithm1"}), ["lens/focus-0"]),
    "brighter": ("scatter", None, scatter(lambda found: 1.001 * found), ["lens/focus-0"]),
    "wider": ("scatter", None, lambda k, image, radius, **o: k(image, 1.001 * radius, **o), ["lens/focus-0"]),
    "other edge": ("scatter", None, lambda k, *a, **o: k(*a, **{**o, "alpha": 3.9}), ["lens/focus-0"]),
    "shifted": ("scatter", None, scatter(lambda found: found.roll(1, 0)), ["lens/focus-0"]),
    "offset": ("scatter", None, scatter(lambda found: found + 1e-3), ["invariants/constant"]),
    "darker": ("scatter", None, scatter(lambda found: 0.999 * found), ["invariants/energy-3", "light/highlight-1e6"]),
    "uneven": (
        "scatter",
        None,
        scatter(lambda found: found * torch.linspace(1, 1.01, found.shape[1])[None, :, None]),
        ["invariants/mirrored", "invariants/shifted"],
    ),
    "swallows": ("scatter", None, filled, ["light/nan-in-the-image", "lens/radius-nan", "lens/radius-infinite"]),
    "opaque": (
        "rasterize",
        None,
        opaque,
        ["gaussians/scale-0.1", "images/rasterize-1x9", "gaussians/half-a-pixel", "gaussians/thousand-on-a-tile"],
    ),
    "stored order": (
        "rasterize",
        None,
        lambda k, **o: k(**{**o, "sh_dc": o["sh_dc"].roll(1, 0)}),
        ["invariants/order"],
    ),
    "draws all": (
        "rasterize",
        None,
        moved_nearer,
        ["gaussians/behind", "gaussians/near-plane-on", "gaussians/nan-means"],
    ),
    "loss": (
        "ssim",
        "l1_ssim",
        lambda k, *a, **o: k(*a, **o) + 1e-3,
        ["invariants/ssim-of-itself-textured", "images/ssim-1x1"],
    ),
    "planes": ("stereo", None, lambda k, *a, **o: k(*a, **o).roll(1, 2), ["invariants/stereo-shift"]),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_kernel_fails_its_cases(broken, how):
    op, function, change, names = BROKEN[how]
    assert [name for name in names if not error_of(name).met] == []
    broken(op, change, function)
    assert [name for name in names if error_of(name).met] == []


@pytest.mark.parametrize(("factor", "turn"), [(1.001, 0.0), (1.0, 0.01), (-1.0, 0.0), (float("nan"), 0.0)])
def test_a_wrong_gradient_is_seen_by_length_and_by_direction(broken, factor, turn):
    names = "gradients/ssim-away", "gradients/raster-away-from-kinks"
    assert all(error_of(name).met for name in names)
    broken("ssim", lambda kernel, image, *a, **o: kernel(Bent.apply(image, factor, turn), *a, **o), "l1_ssim")
    broken("rasterize", lambda kernel, **o: kernel(**{**o, "sh_dc": Bent.apply(o["sh_dc"], factor, turn)}))
    assert not any(error_of(name).met for name in names)


def test_a_leak_at_aperture_0_is_seen(monkeypatch):
    assert error_of("lens/aperture-0").met
    monkeypatch.setattr(lens_cases, "scatter_defocus", lambda *a, **o: scatter_defocus(*a, **o) * (1 + 2.0**-23))
    assert not error_of("lens/aperture-0").met


def test_unknown_depth_taken_for_near_is_seen(monkeypatch):
    def near(image, depth, lens, **options):
        return defocus_numpy(image, np.where(np.isfinite(depth) & (depth > 0), depth, 0.5), lens, **options)

    assert error_of("lens/depth-nan").met and error_of("lens/depth-0").met
    monkeypatch.setattr(lens_cases, "defocus_numpy", near)
    assert not error_of("lens/depth-nan").met and not error_of("lens/depth-0").met


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
