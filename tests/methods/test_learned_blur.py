"""Each learned blur by its published formula, in training, and in saved models; and DOF-GS."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    BARE,
    CAMERA,
    RANGE,
    copying,
    enlarging,
    masked,
    no_view,
    one_gaussian,
    proposing,
    shot,
    with_outputs,
)
from made_up import Recorder, cloud, frontal
from small_scene import cameras, training_set
from tolerances import ADAM_FIRST_STEP, ADAM_TURNS, BLUR_INTEGRAL, FLOAT32_GRADIENT, FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.core.lens import PhysicalLens
from dofbench.methods.bags.method import BAGS, ProposedBlur, ThreeScales
from dofbench.methods.cocogaussian.method import CircleCopies, CoCoGaussian, CopiedOptions
from dofbench.methods.deblurring3dgs.method import Deblurring3DGS, EnlargedGaussians, EnlargingOptions
from dofbench.methods.dofgs.method import DOFGS, FocusedBlur, FocusOptions
from dofbench.methods.gsplat_deblur.method import MaskedDeblurring
from dofbench.methods.rgs.method import RobustSplatting, UniformBlur, UniformBlurOptions
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.blur_network import GaussianNetwork
from dofbench.training.gaussians.forward_model import BlurOptions, BlurStart, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.lens_models import LensSamples, OwnBlur, Pinhole, ScatterBlur, ScatterOptions
from dofbench.training.gaussians.lens_renderer import StillRasteriser
from dofbench.training.gaussians.model import PARAMETERS, Gaussians

SHORT = {"steps": 90, "sh_degree": 1, "densify_from": 0.1, "densify_every": 20, "reset_every": 0.0}


def trained(kind: type[GaussianMethod], **options) -> GaussianMethod:
    method = kind({**SHORT, **options}, 0, "cpu")
    outcome = method.fit(training_set(), Budget(steps=90), Recorder())
    assert outcome.status is Status.OK and outcome.steps == 90, outcome.message
    return method


def test_what_a_blur_begins_with_lies_where_the_gaussians_do() -> None:
    gaussians = Gaussians({name: torch.zeros(5, 3, device="meta") for name in PARAMETERS})
    start = BlurStart(gaussians, cameras(), 1.0, torch.Generator())
    assert start.means.device == torch.device("meta") and start.centre.device == start.means.device


@pytest.mark.parametrize(
    "model",
    [
        Pinhole(),
        ScatterBlur(BlurOptions(), ScatterOptions()),
        LensSamples(BlurOptions(), 1),
        OwnBlur(BlurOptions()),
        UniformBlur(2, UniformBlurOptions()),
        EnlargedGaussians(torch.zeros(3), 1.0, EnlargingOptions(), torch.Generator()),
        masked(),
        copying(),
        proposing(),
    ],
)
def test_a_model_says_what_it_needs(model, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sharp view is rasterised before the model, under its own name in the table of times; what rasterises from
    aperture samples is compiled before training."""
    scene, looked, moved = one_gaussian(3.0), [], []
    from_points = scene.rasterise_from_points
    monkeypatch.setattr(scene, "rasterise_from_points", lambda *given: moved.append(1) or from_points(*given))
    sharp = SharpView(lambda: looked.append(1) or scene.rasterise(CAMERA, "depth"))
    model.render(scene, sharp, shot(slope=0.1))
    assert (model.needs_sharp_render, model.samples_aperture) == (bool(looked), bool(moved))


@pytest.mark.parametrize("kind", [RobustSplatting, Deblurring3DGS, MaskedDeblurring, CoCoGaussian, BAGS])
def test_what_is_learned_explains_the_photographs_and_is_left_out_of_renderings(kind, tmp_path) -> None:
    enlarged = {"enlarge_lambda": 1.0, "enlarge_most": 3.0}
    strong = {RobustSplatting: {"view_blur_init": 20.0}, CoCoGaussian: {}, BAGS: {}}.get(kind, enlarged)
    method = trained(kind, **strong)
    trainer = method._trainer
    sharp = method.render(cameras()[0], None).image
    assert np.abs(trainer.render_view(0) - sharp).max() > 0.01
    assert method.lens_estimates() is None
    with pytest.raises(ValueError, match="no lens"):
        method.render(cameras()[0], PhysicalLens(1.0, 0.2, 48))
    method.save(tmp_path)
    loaded = kind({}, 0, "cpu")
    loaded.load(tmp_path)
    np.testing.assert_allclose(loaded.render(cameras()[0], None).image, sharp, atol=FLOAT32_VALUE)


@pytest.mark.parametrize("kind", [RobustSplatting, Deblurring3DGS])
def test_a_snapshot_has_the_blur(kind) -> None:
    method = trained(kind, **({} if kind is RobustSplatting else {"enlarge_lambda": 0.1, "enlarge_most": 9.0}))
    state = method._trainer.state
    before, kept = method._trainer.render_view(0), state.snapshot()
    state.blur.step(0, 0.0, 1.0)
    image = state.forward.at(0.9).render(StillRasteriser(state.gaussians, BARE), no_view(), shot(0))
    (-image.sum()).backward()  # a step enlarges
    state.blur.step(0, 0.0, 100.0)
    assert not np.array_equal(method._trainer.render_view(0), before)
    state.restore(kept)
    np.testing.assert_array_equal(method._trainer.render_view(0), before)


def test_dof_gs_learns_lenses_and_refocuses() -> None:
    method = trained(DOFGS)
    lenses = method.lens_estimates()
    assert set(lenses) == {"v0", "v1", "v2"}
    stages = method._trainer.stages
    assert stages["lens"] > 0
    wide = PhysicalLens(30.0, 1 / 6, 48)
    assert not np.array_equal(method.render(cameras()[0], wide).image, method.render(cameras()[0], None).image)


def test_a_uniform_blur_adds_its_variance_to_every_footprint_and_keeps_its_light() -> None:
    """A Gaussian of 1.5 px through a blur of 2 px is one of 2.5 px."""
    own, through = 1.5, 2.0
    blur = UniformBlur(2, UniformBlurOptions(view_blur_init=1e3 * through / CAMERA.width))
    image = blur.render(one_gaussian(own), no_view(), shot(1))
    sharp = one_gaussian(own).rasterise(CAMERA, "none").color
    rows, columns = np.mgrid[:36, :48] + 0.5
    square = (columns - CAMERA.cx) ** 2 + (rows - CAMERA.cy) ** 2
    colour = 0.5 + 0.5 / math.sqrt(math.pi)
    expected = 0.5 * colour * own**2 / 6.25 * np.exp(-square / (2 * 6.25))
    near = square < 16
    np.testing.assert_allclose(image.detach().numpy()[near][:, 0], expected[near], rtol=FLOAT32_GRADIENT)
    assert float(image.detach().sum()) == pytest.approx(float(sharp.detach().sum()), rel=BLUR_INTEGRAL)


def test_a_uniform_blur_is_found_for_each_photograph_by_itself() -> None:
    """The scene is known; photograph 0 was blurred by 0.5 px, photograph 1 by 2 px."""
    scene, true = one_gaussian(1.5), (0.5, 2.0)
    targets = [
        UniformBlur(1, UniformBlurOptions(view_blur_init=1e3 * one / CAMERA.width)).render(scene, no_view(), shot(0))
        for one in true
    ]
    blur = UniformBlur(2, UniformBlurOptions(view_blur_init=20.0, view_blur_lr=0.5))
    for step in range(300):
        view = step % 2
        found = blur.render(scene, no_view(), shot(view))
        (found - targets[view].detach()).square().sum().backward()
        assert blur.gradient() is not None
        blur.step(view, step / 300, 1.0 if step < 200 else 0.1)
    pixels = blur.deviations() * CAMERA.width * 1e-3
    step = 0.5 * 0.1 * CAMERA.width * 1e-3  # px, the last ones
    assert (pixels.abs() - torch.tensor(true)).abs().max() / step < ADAM_TURNS


def test_the_sharp_view_is_compared_where_the_photograph_is_in_focus() -> None:
    """Focused at z = 4: the circle of what lies there is 0. Elsewhere nothing is drawn."""
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    image = torch.full((36, 48, 3), 0.25)
    view = ScaledView(0, "v", CAMERA, image, None, None)
    focus = float(RANGE.normalise(torch.tensor(0.25)))
    model = FocusedBlur(BlurOptions(), FocusOptions(in_focus_weight=3.0, in_focus_circle=0.5))
    cost = model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * focus), view)
    drawn = raster.alpha.detach() > 0
    difference = (raster.color.detach() - 0.25).abs().mean(dim=2)
    assert float(cost.detach()) == pytest.approx(
        3 * float((difference * drawn).sum().detach()) / (36 * 48), rel=FLOAT32_VALUE
    )
    assert 0 < int(drawn.sum()) < drawn.numel()
    # Focused elsewhere nothing is compared, held-back pixels never.
    assert model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * (focus + 0.5)), view) == 0
    kept = ScaledView(0, "v", CAMERA, image, None, torch.ones(36, 48, dtype=torch.bool))
    assert float(model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * focus), kept).detach()) == 0


@pytest.mark.parametrize(("output", "factor"), [(0.0, 1.0), (-50.0, 1.0), (3.0, 1.02), (11.0, 1.1), (50.0, 1.1)])
def test_scales_grow_by_the_published_factor(output: float, factor: float) -> None:
    """clamp(0.01 o + 0.99, 1, 1.1)."""
    scene = one_gaussian(2.0)
    blur = with_outputs(enlarging(), output, 0.0)
    found = blur.enlarged(scene.gaussians.parameters, shot())["log_scales"] - scene.gaussians.parameters["log_scales"]
    assert found.detach().exp().unique().tolist() == pytest.approx([factor], rel=FLOAT32_SCALAR)
    image = blur.render(scene, no_view(), shot())
    expected = one_gaussian(2.0 * factor).rasterise(CAMERA, "none").color
    np.testing.assert_allclose(image.detach().numpy(), expected.detach().numpy(), atol=FLOAT32_VALUE)


def test_quaternions_change_by_component() -> None:
    scene = one_gaussian(2.0)
    with torch.no_grad():
        scene.gaussians.parameters["quaternions"][:] = torch.tensor([0.5, -0.5, 0.5, 0.5])
    blur = with_outputs(enlarging(), 0.0, 0.0)
    with torch.no_grad():
        blur._network.head.bias[3:] = torch.tensor([0.0, 11.0, 3.0, 99.0])
    found = blur.enlarged(scene.gaussians.parameters, shot())["quaternions"]
    assert found[0].tolist() == pytest.approx([0.5, -0.55, 0.51, 0.55], rel=FLOAT32_SCALAR)


def test_the_network_learns_and_what_it_sees_does_not() -> None:
    """Places, scales and rotations reach the network detached: a Gaussian learns by its picture alone."""
    scene = one_gaussian(2.0)
    blur = with_outputs(enlarging(), 5.0, 0.0)
    head = blur._network.head
    with torch.no_grad():
        head.weight.normal_(0, 1e-3, generator=torch.Generator().manual_seed(1))
    changed = blur.enlarged(scene.gaussians.parameters, shot())
    changed["log_scales"].sum().backward()
    assert float(blur.gradient().abs().sum()) > 0
    assert scene.gaussians.parameters["log_scales"].grad.unique().tolist() == [1.0]
    assert scene.gaussians.parameters["means"].grad is None
    before = head.weight.detach().clone()
    blur.step(0, 0.0, 1.0)
    assert not torch.equal(head.weight, before) and blur.gradient() is None


def test_the_network_tells_gaussians_and_cameras_apart() -> None:
    scene = one_gaussian(2.0)
    blur = enlarging(enlarge_lambda=1.0, enlarge_most=100.0)
    with torch.no_grad():
        blur._network.head.bias.fill_(50.0)
    here = blur.enlarged(scene.gaussians.parameters, shot())["log_scales"]
    there = Shot(frontal(48, 36, 45.0, (0.3, 0.0, 0.0)), RANGE, 0.0, 0.0, number=1)
    assert not torch.equal(here, blur.enlarged(scene.gaussians.parameters, there)["log_scales"])
    grown = here - scene.gaussians.parameters["log_scales"]
    assert len(grown.unique(dim=0)) > 1


def test_the_network_may_begin_later() -> None:
    assert [start for start, _ in enlarging(enlarge_from=0.2).models()] == [0.0, 0.2]
    assert [start for start, _ in enlarging().models()] == [0.0]


def test_every_part_of_the_network_learns() -> None:
    network = GaussianNetwork((2,), (1.0,), torch.zeros(3), 1.0, torch.Generator().manual_seed(0))
    names = dict(network.named_parameters())
    # The camera's part of the first layer has no bias of its own.
    hidden = [name for name in names if name.startswith("hidden")]
    assert set(names) == {"first.weight", "first.bias", "camera.weight", "head.weight", "head.bias", *hidden}
    (found,) = network(one_gaussian(2.0).gaussians.parameters, CAMERA)
    found.square().sum().backward()
    assert all(float(one.grad.abs().max()) > 0 for one in names.values())


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_mask_mixes_the_blurred_and_the_sharp_view(share: float) -> None:
    scene, blur = one_gaussian(3.0), masked(mask_cost=2.0)
    with_outputs(blur._enlarged, 11.0, 0.0)
    with torch.no_grad():
        blur._network.head.weight.zero_()
        blur._network.head.bias.fill_(
            math.log(share / (1 - share)) if 0 < share < 1 else math.copysign(99, share - 0.5)
        )
    raster = scene.rasterise(CAMERA, "depth")
    image = blur.render(scene, SharpView(lambda: raster), shot())
    wide = one_gaussian(3.3).rasterise(CAMERA, "none").color
    expected = share * wide + (1 - share) * raster.color
    np.testing.assert_allclose(image.detach().numpy(), expected.detach().numpy(), atol=FLOAT32_VALUE)
    view = ScaledView(0, "v", CAMERA, torch.zeros(36, 48, 3), None, None)
    cost = blur.cost(SharpView(lambda: raster), shot(), view)
    assert float(cost.detach()) == pytest.approx(2 * share, rel=FLOAT32_SCALAR)


def test_a_mask_depends_on_photograph_depth_and_place() -> None:
    blur = masked()

    def mask(number: int, z: float) -> np.ndarray:
        raster = one_gaussian(30.0, z).rasterise(CAMERA, "depth")
        return blur.mask(SharpView(lambda: raster), shot(number)).detach().numpy()

    first = mask(0, 4.0)
    assert first.shape == (36, 48) and 0 < first.min() < first.max() < 1
    assert not np.allclose(first, mask(1, 4.0)) and not np.allclose(first, mask(0, 2.0))


def test_both_networks_of_a_mask_learn() -> None:
    scene, blur = one_gaussian(3.0), masked()
    with_outputs(blur._enlarged, 5.0, 0.0)
    with torch.no_grad():
        blur._enlarged._network.head.weight.normal_(0, 1e-3, generator=torch.Generator().manual_seed(1))
    raster = scene.rasterise(CAMERA, "depth")
    before = [
        parameter.detach().clone()
        for part in (blur._network, blur._enlarged._network)
        for parameter in (part.head.weight,)
    ]
    blur.render(scene, SharpView(lambda: raster), shot()).square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all())
    blur.step(0, 0.0, 1.0)
    after = [blur._network.head.weight, blur._enlarged._network.head.weight]
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True)) and blur.gradient() is None


def test_the_enlarged_gaussians_of_a_mask_learn_as_they_do_alone() -> None:
    """At the end of the training, cooled down: the rates of photograph, progress and cooldown reach them."""
    gradient = torch.Generator().manual_seed(2)
    alone, blur = enlarging(), masked()
    for network in (alone._network, blur._enlarged._network):
        gradient.manual_seed(2)
        for parameter in network.parameters():
            parameter.grad = torch.randn(parameter.shape, generator=gradient)
    for parameter in blur._network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    alone.step(2, 1.0, 0.5)
    blur.step(2, 1.0, 0.5)
    pairs = zip(alone._network.parameters(), blur._enlarged._network.parameters(), strict=True)
    assert all(torch.equal(*pair) for pair in pairs)


def test_what_is_in_focus_is_not_copied_elsewhere() -> None:
    """At the focused distance, on the axis, the circle is 0: all copies are the scene itself."""
    scene = one_gaussian(2.0)
    blur = copying(4.0)
    copies = blur.copies(scene.gaussians.parameters, shot())
    assert len(copies) == 5 and "means" not in copies[0]
    for changes in copies:
        for name, value in changes.items():
            difference = (value - scene.gaussians.parameters[name])[0].abs().max()
            assert float(difference.detach()) < FLOAT32_SCALAR, name
    elsewhere = copying(8.0).copies(scene.gaussians.parameters, shot())
    moved = (elsewhere[1]["means"] - scene.gaussians.parameters["means"]).detach()
    assert float(moved[0].abs().max()) > 0.001


def test_a_copy_moves_and_grows_by_the_published_formulae() -> None:
    """d = |1/4 - 1/8| times the unit of 2: moves of 2 d o, factors log(clamp(d o + e - 0.01, e, e^1.1))."""
    scene, blur = one_gaussian(2.0), copying(8.0)
    with torch.no_grad():
        blur._network.head.weight.zero_()
        blur._network.head.bias[:12], blur._network.head.bias[12:] = 0.5, 0.4
    copies = blur.copies(scene.gaussians.parameters, shot())
    circle = 2 * (1 / 4 - 1 / 8)
    moved = (copies[3]["means"] - scene.gaussians.parameters["means"]).detach()[0]
    assert moved.tolist() == pytest.approx([2 * circle * 0.5] * 3, rel=FLOAT32_GRADIENT)
    factor = math.log(min(max(circle * 0.4 + math.e - 0.01, math.e), math.e**1.1))
    grown = (copies[0]["log_scales"] - scene.gaussians.parameters["log_scales"]).detach()[0].exp()
    assert grown.tolist() == pytest.approx([factor] * 3, rel=FLOAT32_GRADIENT)
    assert copies[2]["quaternions"][0].tolist() == pytest.approx([factor, 0, 0, 0], rel=FLOAT32_GRADIENT)


def test_copies_are_mixed_evenly_at_first() -> None:
    scene, blur = one_gaussian(2.0), copying(8.0, copies=2)
    views = [scene.rasterise_with(CAMERA, changes) for changes in blur.copies(scene.gaussians.parameters, shot())]
    expected = torch.stack(views).mean(dim=0).detach()
    found = blur.render(scene, no_view(), shot()).detach()
    np.testing.assert_allclose(found.numpy(), expected.numpy(), atol=FLOAT32_VALUE)


def test_focus_and_networks_of_copies_learn() -> None:
    scene, blur = one_gaussian(2.0), copying(8.0, focus_lr=0.1)
    blur.render(scene, no_view(), shot(1)).square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all())
    blur.step(1, 0.0, 1.0)
    found = blur.focuses()
    assert float(found[0]) == 8.0 and abs(math.log(float(found[1]) / 8.0)) == pytest.approx(0.1, rel=FLOAT32_VALUE)
    assert [start for start, _ in blur.models()] == [0.0, 0.05]


def test_the_rate_of_copies_falls_and_is_cooled_down() -> None:
    """Adam's first step is as long as its rate: a hundredth of the first at the end, and half of that cooled down."""
    scene, blur = one_gaussian(2.0), copying(8.0, focus_lr=0.1, copies_lr=0.02)
    with torch.no_grad():
        blur._network.head.weight.normal_(0, 1e-2, generator=torch.Generator().manual_seed(1))
    blur.render(scene, no_view(), shot(1)).square().sum().backward()
    before = blur._network.head.bias.detach().clone()
    blur.step(1, 1.0, 0.5)
    change = (blur._network.head.bias.detach() - before).abs().max()
    assert float(change) == pytest.approx(0.02 / 100 / 2, rel=ADAM_FIRST_STEP)
    assert abs(math.log(float(blur.focuses()[1]) / 8.0)) == pytest.approx(0.05, rel=FLOAT32_VALUE)


def test_photographs_begin_to_be_focused_at_the_mean_distance_of_the_gaussians() -> None:
    gaussians = Gaussians.from_points(cloud([(0, 0, 3.0), (0, 4, 0.0), (0, 0, 13.0), (12, 0, 5.0)]), 0)
    cameras = [frontal(8, 6, 8.0), frontal(8, 6, 8.0, (12.0, 0.0, 0.0))]
    blur = CopiedOptions().learned_blur(BlurStart(gaussians, cameras, 1.0, torch.Generator().manual_seed(0)))
    places = gaussians.parameters["means"].detach().double().numpy()
    expected = [np.linalg.norm(places - camera.centre, axis=1).mean() for camera in cameras]
    assert isinstance(blur, CircleCopies)
    assert blur.focuses().tolist() == pytest.approx(expected, rel=FLOAT32_VALUE)


def fixed(blur: ProposedBlur, logit: float, neighbour: int, mask: float) -> ProposedBlur:
    """The network gives this neighbour a weight of its own, and this mask's logit, everywhere: its last features are
    made constant."""
    network = blur._network
    with torch.no_grad():
        network.base.weight.zero_()
        network.photograph.weight.zero_()
        network.photograph.weight[0] = 1.0
        network.embedding.fill_(1 / 32)  # so the first feature is 1, and the others are 0
        for layer in network.deeper:
            layer.weight.copy_(torch.eye(64))
        for head in network.heads.values():
            head.weight.zero_()
            head.weight[neighbour, 0], head.weight[-1, 0] = logit, mask
    return blur


@pytest.mark.parametrize(("width", "size"), [(48, 17), (96, 9), (192, 5), (150, 5), (1000, 5)])
def test_the_kernel_is_as_large_as_the_scale_asks(width: int, size: int) -> None:
    """A picture 48 px wide of photographs of other widths: all weight on the first neighbour moves it by half a
    kernel."""
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    blur = fixed(proposing(width), 300.0, 0, 300.0)
    found = blur.render(scene, SharpView(lambda: raster), shot()).detach().numpy()
    half = size // 2
    expected = np.zeros_like(found)
    expected[half:, half:] = raster.color.detach().numpy()[:-half, :-half]
    np.testing.assert_allclose(found, expected, atol=FLOAT32_VALUE)


def test_a_proposal_is_mixed_by_its_mask_and_charged_for_it() -> None:
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    blur = fixed(proposing(192, proposal_cost=3.0), 300.0, 0, math.log(0.25 / 0.75))
    found = blur.render(scene, SharpView(lambda: raster), shot()).detach().numpy()
    sharp = raster.color.detach().numpy()
    moved = np.zeros_like(sharp)
    moved[2:, 2:] = sharp[:-2, :-2]
    np.testing.assert_allclose(found, 0.25 * moved + 0.75 * sharp, atol=FLOAT32_VALUE)
    view = ScaledView(0, "v", CAMERA, torch.zeros(36, 48, 3), None, None)
    cost = blur.cost(SharpView(lambda: raster), shot(), view)
    assert float(cost.detach()) == pytest.approx(3 * 0.25, rel=FLOAT32_VALUE)


def test_the_network_of_proposals_learns_from_the_picture_and_tells_photographs_apart() -> None:
    scene, blur = one_gaussian(4.0), proposing(96)
    raster = scene.rasterise(CAMERA, "depth")
    pictures = [blur.render(scene, SharpView(lambda: raster), shot(number)) for number in (0, 1)]
    assert not torch.equal(*pictures)
    pictures[1].square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all()) and float(blur.gradient().abs().sum()) > 0
    before = blur._network.heads["2"].weight.detach().clone()
    blur.step(1, 0.0, 1.0)
    assert not torch.equal(blur._network.heads["2"].weight, before) and blur.gradient() is None


def test_three_scales() -> None:
    scales = ThreeScales()
    assert [scales.size(progress) for progress in (0.0, 0.0999, 0.1, 0.1999, 0.2, 1.0)] == [4, 4, 2, 2, 1, 1]
    assert scales.sizes == (1, 2, 4)
    assert ThreeScales(quarter_until=0.0).sizes == (1, 2) and ThreeScales(quarter_until=0.2).sizes == (1, 4)


@pytest.mark.parametrize(("width", "deeper"), [(192, 0), (96, 1), (48, 2)])
def test_each_finer_scale_has_a_layer_more(width: int, deeper: int) -> None:
    """A picture of a quarter, of half and of all of the photographs' size: the coarse scales come first."""
    scene, blur = one_gaussian(4.0), proposing(width)
    raster = scene.rasterise(CAMERA, "depth")
    blur.render(scene, SharpView(lambda: raster), shot()).square().sum().backward()
    sizes = {factor: head.weight.grad is not None for factor, head in blur._network.heads.items()}
    assert sum(sizes.values()) == 1
    learned = [layer.weight.grad is not None and bool(layer.weight.grad.any()) for layer in blur._network.deeper]
    assert learned == [index < deeper for index in range(len(learned))]
