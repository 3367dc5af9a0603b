"""Forward models: which one is used when in training, which one renders, and how often they rasterise."""

import itertools

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import cameras, options, training_set

from dofbench.core.budget import Budget
from dofbench.core.lens import PhysicalLens
from dofbench.methods.dofgaussian.method import DoFGaussian
from dofbench.training.gaussians import lens_renderer
from dofbench.training.gaussians.forward_model import BlurOptions, SharpView, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import (
    LensSamples,
    OwnBlur,
    Pinhole,
    SamplesOptions,
    ScatterBlur,
    ScatterOptions,
    rendering_model,
)
from dofbench.training.gaussians.lens_renderer import LensRenderer
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.surface_terms import richest
from dofbench.training.gaussians.trainer import Trainer
from dofbench.training.gaussians.trials import possible_models

LENS = PhysicalLens(aperture=30.0, focus_disparity=1 / 6, width=48)
SAMPLES = {"lens_model": "samples", "lens_samples_from": 0.3}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"lens": False, **SAMPLES}, [Pinhole] * 5),
        ({}, [ScatterBlur] * 5),
        ({**SAMPLES, "lens_rings": 0}, [ScatterBlur, OwnBlur, OwnBlur, OwnBlur, OwnBlur]),
        ({**SAMPLES, "lens_rings_from": 0.0}, [ScatterBlur] + [LensSamples] * 4),
        ({**SAMPLES, "lens_rings_from": 0.6}, [ScatterBlur, OwnBlur, OwnBlur, LensSamples, LensSamples]),
        ({**SAMPLES, "lens_samples_from": 0.0}, [LensSamples] * 5),
    ],
)
def test_which_model_trains_when(changes, expected):
    models = GaussianOptions.of(**changes).forward_models()
    assert [type(models.at(progress)) for progress in (0.0, 0.3, 0.59, 0.6, 1.0)] == expected


def test_points_of_the_lens_replace_the_scatter_in_the_middle_unless_asked_otherwise():
    models = GaussianOptions.of(lens_model="samples").forward_models()
    assert isinstance(models.at(0.499), ScatterBlur) and isinstance(models.at(0.5), LensSamples)


def test_a_scene_is_rendered_through_more_points_than_it_was_trained_through():
    def chosen(model, rings):
        return rendering_model(BlurOptions(lens_model=model), ScatterOptions(), SamplesOptions(lens_rings=rings))

    assert isinstance(chosen("scatter", 1), ScatterBlur) and isinstance(chosen("samples", 0), OwnBlur)
    assert [chosen("samples", rings)._most for rings in (1, 5)] == [3, 5]


def test_what_a_trial_may_bring_is_known_before_training():
    def kinds(**changes):
        return {type(model) for model in possible_models(GaussianOptions.of(**changes))}

    assert kinds(lens_trials="lens,model") == {ScatterBlur, OwnBlur, LensSamples}
    assert kinds(lens_trials="lens") == {ScatterBlur}
    assert kinds(lens_trials="model", lens=False) == {Pinhole}


def test_the_richest_geometry_holds_what_all_want():
    assert richest([]) == "none" and richest(["depth", "none"]) == "depth"
    assert richest(["full", "depth"]) == "full" and richest(["distortion", "full"]) == "distortion"


@pytest.fixture
def rasterised(monkeypatch) -> list[str]:
    """A list to which the geometry of every following rasterisation is added."""
    seen: list[str] = []

    def counted(*given, geometry, **more):
        seen.append(geometry)
        return rasterise(*given, geometry=geometry, **more)

    monkeypatch.setattr(lens_renderer, "rasterise", counted)
    return seen


@pytest.mark.parametrize("changes", [{}, {"lens_model": "samples"}, {"lens_model": "samples", "lens_rings": 0}])
def test_many_lenses_on_one_camera_take_one_sharp_view(rasterised, changes):
    trainer, chosen = Trainer(training_set(), options(), 0), GaussianOptions.of(sh_degree=1, **changes)
    renderer, (camera, other, _) = LensRenderer(trainer.gaussians, chosen), cameras()
    lenses = [PhysicalLens(aperture, LENS.focus_disparity, 48) for aperture in (10.0, 30.0, 60.0)]
    pictures = [renderer.render(camera, lens).image for lens in lenses]
    assert rasterised.count("depth") == 1
    for lens, picture in zip(lenses, pictures, strict=True):
        assert np.array_equal(picture, LensRenderer(trainer.gaussians, chosen).render(camera, lens).image)
    del rasterised[:]
    apart = renderer.render(other, LENS).image
    assert rasterised.count("depth") == 1 and not np.array_equal(apart, pictures[1])


def test_a_picture_without_a_lens_is_always_rasterised(rasterised):
    """Because the speed of such renderings is a score (frames per second)."""
    trainer = Trainer(training_set(), options(), 0)
    renderer, camera = LensRenderer(trainer.gaussians, options()), cameras()[0]
    for lens in (LENS, None, None):
        renderer.render(camera, lens)
    assert rasterised == ["depth"] * 3


def test_what_is_done_to_a_picture_does_not_reach_the_next():
    trainer, camera = Trainer(training_set(), options(), 0), cameras()[0]
    renderer, closed = LensRenderer(trainer.gaussians, options()), PhysicalLens(0.0, 0.2, 48)
    first = renderer.render(camera, closed)
    kept = first.image.copy(), first.depth.copy()
    first.image[:], first.depth[:] = 7.0, 7.0
    second = renderer.render(camera, closed)
    assert np.array_equal(second.image, kept[0]) and np.array_equal(second.depth, kept[1])


def test_a_method_in_training_renders_what_it_has_become():
    """An observer that renders between steps must not get a sharp view that was kept from an earlier step."""
    method, seen = DoFGaussian({"steps": 12, "sh_degree": 0, "normal_weight": 0.0}, 0, "cpu"), []

    class Looking(Recorder):
        def after_step(self, step, loss):
            seen.append(method.render(camera, LENS).image)
            return super().after_step(step, loss)

    camera, given = cameras()[0], training_set()
    for _ in range(2):  # when the second training begins, the sharp view of the first is still kept
        method.fit(given, Budget(steps=3), Looking())
        seen.append(method.render(camera, LENS).image)
    assert all(not np.array_equal(one, other) for one, other in itertools.pairwise(seen[:3]))
    assert np.array_equal(seen[:4], seen[4:])


def test_the_order_of_photographs_does_not_depend_on_how_many_points_look_at_them():
    orders = []
    for rings in (0, 1):
        trainer = Trainer(training_set(), options(lens_model="samples", lens_samples_from=0.0, lens_rings=rings), 0)
        taken = []
        record = trainer.state.order.record
        trainer.state.order.record = lambda view, loss, taken=taken, record=record: (
            taken.append(view),
            record(view, loss),
        )
        trainer.fit(Budget(steps=12), Recorder())
        orders.append(taken)
    assert orders[0] == orders[1] and len(orders[0]) == 12


def test_the_blurs_gradient_reaches_the_depth_where_it_is_asked_to():
    trainer, camera = Trainer(training_set(), options(), 0), cameras()[0]
    raster = rasterise(trainer.gaussians, camera, trainer.options.appearance)
    for to_depth in (False, True):
        depth = raster.depth.detach().requires_grad_()
        seen = raster._replace(color=raster.color.detach(), alpha=raster.alpha.detach(), depth=depth)
        sharp = SharpView(lambda seen=seen: seen)
        model = ScatterBlur(BlurOptions(blur_to_depth=to_depth), ScatterOptions())
        slope = torch.tensor(8.0, requires_grad=True)
        model.render(None, sharp, Shot(camera, trainer.state.range, slope, -2.0)).square().sum().backward()
        assert (depth.grad is not None and bool(depth.grad.any())) is to_depth and float(slope.grad) != 0
