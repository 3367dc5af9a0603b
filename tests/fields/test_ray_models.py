"""Forward models of rays before a wall whose pattern is known."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import torch
from hypothesis import given
from hypothesis import strategies as st
from plane_scene import FOCAL, HEIGHT, WIDTH, PlaneScene, cameras, waves
from tolerances import (
    DISC_OF_A_PIXEL,
    FLOAT32_GRADIENT,
    FLOAT32_SCALAR,
    FLOAT32_VALUE,
    FLOAT64_VALUE,
    LENS_FOUND_BY_RAYS,
    SAMPLED_DISC,
)
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.contracts import TrainingView
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange
from dofbench.methods.deblurnerf.method import DeformableKernel, DeformableOptions
from dofbench.methods.dofnerf.method import PatchOptions, RenderedPatch
from dofbench.methods.dpnerf.method import RigidKernel, screw_motion
from dofbench.methods.dpnerf.weight_proposal import (
    WeightProposal,
    WeightProposalOptions,
    _CurveAttention,
    integrated,
)
from dofbench.methods.lensnerf.method import LensRayOptions, LensRays
from dofbench.methods.pdrf.method import ProgressiveKernel, ProgressiveOptions
from dofbench.optics.defocus import scatter_defocus
from dofbench.training.common.lenses import LearnedLenses, LensOptions
from dofbench.training.common.networks import redraw
from dofbench.training.fields.blur_kernels import KernelOptions
from dofbench.training.fields.cube_rays import RaysSeen
from dofbench.training.fields.lens_field import disc_points
from dofbench.training.fields.pixels import Pixels, TrainingPixels, whole_image
from dofbench.training.fields.ray_model import RAYS_AT_ONCE, RayModel, mixed

UNIT = 2.0  # depth that counts as 1 for the kernels
RANGE = DisparityRange(0.1, 0.6)


def pixels(view: int = 0, count: int = 25) -> Pixels:
    generator = torch.Generator().manual_seed(4)
    places = torch.rand(count, 2, generator=generator) * torch.tensor([WIDTH, HEIGHT])
    return Pixels(torch.full((count,), view), places, torch.zeros(count, 3), view)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def deformable(**changes: Any) -> DeformableKernel:
    return DeformableKernel(2, UNIT, KernelOptions(), DeformableOptions(**changes), generator())


def rigid(proposal: bool = False) -> RigidKernel:
    own = WeightProposalOptions(weight_proposal=proposal, proposal_samples=4)
    return RigidKernel(2, np.zeros(3), UNIT, 3, KernelOptions(), own, generator())


def progressive(**changes: Any) -> ProgressiveKernel:
    options = ProgressiveOptions(kernel_points=4, kernel_from=0.006, kernel_lr_final=0.16, **changes)
    return ProgressiveKernel(2, UNIT, 3, options, generator())


def lenses(aperture: float = 0.5, focus: float = 0.5, rate: float = 5e-3) -> LearnedLenses:
    options = LensOptions(lens_init_aperture=aperture, lens_init_focus=focus, lens_lr=rate, lens_lr_final=rate)
    return LearnedLenses(2, RANGE, options)


def colours(model: RayModel, scene: PlaneScene, at: Pixels, progress: float) -> Tensor:
    """What the model says first."""
    return model.predict(scene, at, progress)[0].colours


def sharp(scene: PlaneScene, at: Pixels) -> Tensor:
    return colours(RayModel(), scene, at, 0.0)


def test_a_pinhole_shows_the_wall() -> None:
    scene, at = PlaneScene(3.0, waves), pixels(1)
    where = (at.places - torch.tensor([WIDTH / 2, HEIGHT / 2])) / FOCAL * 3.0 + torch.tensor([0.2, -0.1])
    torch.testing.assert_close(sharp(scene, at), waves(where), rtol=FLOAT32_VALUE, atol=0)


KERNELS = {"deformable": deformable(), "rigid": rigid(), "proposed": rigid(True), "progressive": progressive()}


@pytest.mark.parametrize("model", KERNELS.values(), ids=KERNELS)
def test_kernels_begin_after_a_while(model: RayModel) -> None:
    scene, at = PlaneScene(3.0, waves), pixels()
    assert torch.equal(colours(model, scene, at, 0.005), sharp(scene, at))
    assert model.cost(0.005) is None
    assert not torch.equal(colours(model, scene, at, 0.007), sharp(scene, at))


def test_kernels_draw_as_many_rays_as_a_pinhole() -> None:
    views = [TrainingView("v", cameras()[0], np.zeros((HEIGHT, WIDTH, 3), np.float32))]
    photographs = TrainingPixels(views, np.random.default_rng(0))
    for model, pixels_of_a_step in ((deformable(), 20), (rigid(), 20), (progressive(), 12)):
        assert [len(model.draw(photographs, 100, progress).views) for progress in (0.0, 0.5)] == [100, pixels_of_a_step]


def test_a_kernel_whose_rays_are_all_the_pixel_s_own_changes_nothing() -> None:
    model, scene, at = deformable(kernel_noise=0.0), PlaneScene(3.0, waves), pixels()
    for name, parameter in model._network.named_parameters():
        if name == "pattern" or name.startswith("head"):
            parameter.data.zero_()
    torch.testing.assert_close(colours(model, scene, at, 0.5), sharp(scene, at), rtol=FLOAT32_VALUE, atol=0)
    assert float(model.cost(0.5).detach()) == 0 and model.cost(0.95) is None


def test_a_kernel_s_points_are_pixels_of_its_window() -> None:
    """With the head at 0 the canonical points remain: tanh(0.3) of the window to the right, in equal parts."""
    model, at = deformable(kernel_noise=0.0), pixels()
    for name, parameter in model._network.named_parameters():
        if name.startswith("head"):
            parameter.data.zero_()
    model._network.pattern.data[:] = torch.tensor([0.3, 0.0])
    moved = Pixels(at.views, at.places + torch.tensor([10 * math.tanh(0.3), 0.0]), at.colours)
    scene = PlaneScene(3.0, waves)
    torch.testing.assert_close(colours(model, scene, at, 0.5), sharp(scene, moved), rtol=FLOAT32_VALUE, atol=0)
    assert float(model.cost(0.5).detach()) == pytest.approx(0.1 * 10 * math.tanh(0.3) / 2, rel=FLOAT32_VALUE)


def test_a_progressive_kernel_s_points_are_pixels_of_its_window() -> None:
    """With the head at 0 the canonical points remain, at (2, 1) pixels and the same noise, whatever the window."""
    scene, at, found = PlaneScene(3.0, waves), pixels(), []
    for window in (10.0, 5.0):
        model = progressive(kernel_window=window)
        for name, parameter in model._network.named_parameters():
            if name.startswith("kernel.head"):
                parameter.data.zero_()
        model._network.kernel.pattern.data[:] = torch.atanh(torch.tensor([2.0, 1.0]) / window)
        found.append(colours(model, scene, at, 0.5))
    torch.testing.assert_close(found[0], found[1], rtol=FLOAT32_VALUE, atol=0)


def test_origins_turn_rays_about_the_unit_of_depth() -> None:
    """The head's bias moves origins alone: at that depth nothing changes, beyond it things move the other way."""
    at = pixels()
    for depth in (UNIT, 2 * UNIT):
        model, scene = deformable(kernel_noise=0.0), PlaneScene(depth, waves)
        for name, parameter in model._network.named_parameters():
            if name == "pattern" or name.startswith("head"):
                parameter.data.zero_()
        model._network.head.bias.data[0] = 5.0
        along = 0.01 * 5 * UNIT * (1 - depth / UNIT) / depth * FOCAL  # pixels
        moved = Pixels(at.views, at.places + torch.tensor([along, 0.0]), at.colours)
        torch.testing.assert_close(colours(model, scene, at, 0.5), sharp(scene, moved), rtol=FLOAT32_VALUE, atol=0)


@pytest.mark.parametrize("model", KERNELS.values(), ids=KERNELS)
def test_a_network_is_learned(model: RayModel) -> None:
    scene, at = PlaneScene(3.0, waves), pixels()
    target = sharp(scene, Pixels(at.views, at.places + 1.0, at.colours))
    losses = []
    for _ in range(60):
        loss = sum(one.weight * (one.colours - target).square().mean() for one in model.predict(scene, at, 0.5))
        loss.backward()
        assert all(g is not None and bool(torch.isfinite(g).all()) for g in model.gradients().values())
        losses.append(float(loss.detach()))
        model.step(0.5)
    assert np.mean(losses[-5:]) < 0.7 * np.mean(losses[:5])


@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_a_screw_motion_is_the_matrix_exponential(numbers: list[float]) -> None:
    rotation, velocity = np.array(numbers[:3]), np.array(numbers[3:])
    x, y, z = rotation
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = velocity
    turn, slide = screw_motion(torch.from_numpy(rotation)[None], torch.from_numpy(velocity)[None])
    expected = scipy.linalg.expm(twist)
    if np.linalg.norm(rotation) > 1e-3:  # below, the formula's own least angle of 1e-10 shows
        np.testing.assert_allclose(turn[0].numpy(), expected[:3, :3], atol=FLOAT64_VALUE)
        np.testing.assert_allclose(slide[0].numpy(), expected[:3, 3], atol=FLOAT64_VALUE)


def test_no_motion_is_the_pixel_s_own_ray() -> None:
    model, scene, at = rigid(), PlaneScene(3.0, waves), pixels()
    for branch in (model._network.rotation, model._network.velocity):
        for parameter in branch[-1].parameters():
            parameter.data.zero_()
    torch.testing.assert_close(colours(model, scene, at, 0.5), sharp(scene, at), rtol=FLOAT32_VALUE, atol=0)
    weights = model._network()[2].detach()
    torch.testing.assert_close(weights.sum(1), torch.ones(2), rtol=FLOAT32_SCALAR, atol=0)


def test_a_rigid_motion_moves_all_rays_alike() -> None:
    """A translation by 0.1 of the unit along x, weighed alone: the wall moves by as much the other way."""
    model, scene, at = rigid(), PlaneScene(3.0, waves), pixels()
    network = model._network
    for branch in (network.rotation, network.velocity, network.weights):
        for parameter in branch[-1].parameters():
            parameter.data.zero_()
    network.velocity[-1].bias.data[3] = 1.0  # the second motion's x, times 0.1
    network.weights[-1].bias.data[:] = torch.tensor([-60.0, -60.0, 60.0, -60.0, -60.0])
    moved = Pixels(at.views, at.places + torch.tensor([0.1 * UNIT / 3.0 * FOCAL, 0.0]), at.colours)
    torch.testing.assert_close(colours(model, scene, at, 0.5), sharp(scene, moved), rtol=FLOAT32_GRADIENT, atol=0)


def test_a_rotation_turns_rays_about_the_centre() -> None:
    """The third motion by 0.1 about z; the others, and the pixel's own ray, stay."""
    centre = np.array([0.5, -0.3, 2.0])
    own = WeightProposalOptions(weight_proposal=False)
    model = RigidKernel(2, centre, UNIT, 3, KernelOptions(), own, generator())
    for branch in (model._network.rotation, model._network.velocity):
        for parameter in branch[-1].parameters():
            parameter.data.zero_()
    model._network.rotation[-1].bias.data[3 * 2 + 2] = 1.0  # times 0.1
    scene, at, traced = PlaneScene(3.0, waves), pixels(1), []
    trace = scene.trace
    scene.trace = lambda *rays: traced.append(rays) or trace(*rays)
    model.predict(scene, at, 0.5)
    origins, directions = (one.detach().double().view(len(at.views), 5, 3).numpy() for one in traced[0])
    turn = scipy.linalg.expm(np.array([[0, -0.1, 0], [0.1, 0, 0], [0, 0, 0]]))
    starts, ways = (one.double().numpy() for one in scene.cameras.rays(at.views, at.places))
    for number in range(5):
        moved = number == 3
        wanted = ((starts - centre) @ turn.T + centre, ways @ turn.T) if moved else (starts, ways)
        np.testing.assert_allclose(origins[:, number], wanted[0], atol=FLOAT32_VALUE)
        np.testing.assert_allclose(directions[:, number], wanted[1], atol=FLOAT32_VALUE)


def test_the_first_ray_of_both_proposals_is_the_pixel_s_own() -> None:
    model, scene, at = progressive(), PlaneScene(3.0, waves), pixels()
    for told in (torch.zeros(25, 4, 15), torch.rand(25, 4, 15)):
        rays = model._propose(scene, at, told)
        assert not rays.places[:, 0].any() and not rays.origins[:, 0].any()
        assert bool((rays.places[:, 1:] != 0).all()) and bool((rays.origins[:, 1:] != 0).all())


def test_the_second_proposal_follows_what_the_first_one_met() -> None:
    """Both models draw the same noise; the wall of one stores other numbers. The second prediction is the mean of both
    stages."""
    stages = []
    for stored in (1.0, 3.0):
        scene = PlaneScene(3.0, waves)
        scene.features_met = lambda origins, directions, seen, stored=stored: torch.full((len(origins), 3), stored)
        second, mean = (one.colours.detach() for one in progressive().predict(scene, pixels(), 0.5))
        stages.append((2 * mean - second, second))
    torch.testing.assert_close(stages[0][0], stages[1][0], rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)
    assert float((stages[0][1] - stages[1][1]).abs().max()) > 100 * FLOAT32_VALUE


def test_proposed_weights_count_more_and_more() -> None:
    model, scene, at = rigid(True), PlaneScene(3.0, waves), pixels()
    shares = {}
    for progress in (0.007, 0.049, 0.5, 0.54, 0.999, 1.0):
        by_photograph, proposed = model.predict(scene, at, progress)
        assert by_photograph.weight + proposed.weight == pytest.approx(1)
        shares[progress] = proposed.weight
    assert shares[0.007] == shares[0.049] == pytest.approx(0.1)
    assert shares[0.5] == shares[0.54] == pytest.approx(0.1 * 9 ** (0.494 / 0.994))
    assert shares[0.999] == pytest.approx(0.1 * 9 ** (0.944 / 0.994)) and shares[1.0] == pytest.approx(0.9)
    [only] = rigid().predict(scene, at, 0.5)
    assert only.weight == 1


def test_weights_are_proposed_by_what_lies_along_the_rays() -> None:
    proposal = WeightProposal(5, 7, 4, generator())
    samples, about = torch.rand(6, 5, 3, 7, generator=generator()), torch.zeros(6, 4)
    directions = torch.nn.functional.normalize(torch.ones(6, 3), dim=1)
    weights = proposal(samples, about, directions).detach()
    assert weights.shape == (6, 5) and bool((weights > 0).all())
    torch.testing.assert_close(weights.sum(1), torch.ones(6), rtol=FLOAT32_SCALAR, atol=0)
    alike = proposal(samples[:1].expand(6, -1, -1, -1), about, directions).detach()
    assert float((weights - weights[:1]).abs().max()) > 10 * FLOAT32_VALUE > float((alike - alike[:1]).abs().max())


def test_rays_are_told_what_matters_most_of_all_rays_and_of_all_samples() -> None:
    """Sum by sum, in float64: for each ray over its samples, for each sample over the rays."""
    pixels_, rays, count, width = 2, 3, 4, 8
    attention = _CurveAttention(width).double()
    redraw(attention, generator())
    seen, local = (
        torch.rand(pixels_, *size, width, generator=generator()).double() for size in ((rays,), (rays, count))
    )
    weight = {name: value.detach().numpy() for name, value in attention.named_parameters()}

    def share(values: np.ndarray) -> np.ndarray:
        return np.exp(values) / np.exp(values).sum()

    joined = np.zeros((pixels_, rays, width))
    for p in range(pixels_):
        samples = local[p].numpy()
        importance = samples @ weight["importance.weight"][0]
        of_rays = np.array([share(importance[n]) @ samples[n] for n in range(rays)]) @ weight["ray_key.weight"].T
        of_samples = np.array([share(importance[:, k]) @ samples[:, k] for k in range(count)])
        of_samples = of_samples @ weight["sample_key.weight"].T
        for n in range(rays):
            query = weight["query.weight"] @ seen[p, n].numpy()
            told = [
                share(key @ query) @ (key @ weight[f"{value}_value.weight"].T)
                for key, value in ((of_rays, "ray"), (of_samples, "sample"))
            ]
            joined[p, n] = weight["join.weight"] @ np.concatenate(told)
    flat = joined.reshape(-1, width)
    normed = (joined - flat.mean(0)) / np.sqrt(flat.var(0) + 1e-5)
    expected = seen.numpy() + normed
    expected = np.where(expected > 0, expected, 0.2 * expected)
    np.testing.assert_allclose(attention(seen, local).detach().numpy(), expected, atol=FLOAT64_VALUE)


@given(st.lists(st.floats(0, 20), min_size=1, max_size=8))
def test_what_lies_along_a_ray_is_rendered_as_a_volume(values: list[float]) -> None:
    """Sample by sample: each takes its share of the light that is left. A constant c gives c (1 - exp(-c))."""
    left, expected = 1.0, 0.0
    for value in values:
        taken = 1 - math.exp(-value / len(values))
        expected, left = expected + left * taken * value, left * (1 - taken)
    found = integrated(torch.tensor(values, dtype=torch.float64)[:, None])
    assert float(found) == pytest.approx(expected, abs=FLOAT64_VALUE)
    constant = integrated(torch.full((5, 1), values[0], dtype=torch.float64))
    assert float(constant) == pytest.approx(values[0] * (1 - math.exp(-values[0])), abs=FLOAT64_VALUE)


def test_light_is_mixed_linearly() -> None:
    colours = torch.tensor([[[0.2, 1.0, 0.5], [0.8, 0.0, 0.5]]])
    found = mixed(colours, torch.tensor([[0.25, 0.75]]))
    expected = (0.25 * np.array([0.2, 1.0, 0.5]) ** 2.2 + 0.75 * np.array([0.8, 0.0, 0.5]) ** 2.2) ** (1 / 2.2)
    np.testing.assert_allclose(found[0].numpy(), expected, rtol=FLOAT32_VALUE)


def test_points_of_the_lens_cover_it_evenly() -> None:
    points = disc_points(4000, 9, generator())
    radius = points.norm(dim=2)
    strata = (radius.square() * 9).floor()
    assert bool((strata == torch.arange(9)).all())  # one in each ring of equal area
    moments = points.reshape(-1, 2).T.cov()
    np.testing.assert_allclose(moments.numpy(), np.eye(2) / 4, atol=SAMPLED_DISC)


@pytest.mark.parametrize("aperture", [0.5, 3.0])
@pytest.mark.parametrize("depth", [2.0, 4.0, 8.0])
def test_a_lens_blurs_the_wall_over_its_circle_of_confusion(aperture: float, depth: float) -> None:
    """The mean of x^2 over a disc of radius R is x0^2 + R^2 / 4."""

    def pattern(where: Tensor) -> Tensor:
        light = 0.05 + (where[:, :1] * FOCAL / depth / WIDTH).square()
        return light.pow(1 / 2.2).expand(-1, 3)

    scene, at, learned = PlaneScene(depth, pattern), pixels(0, 40), lenses(aperture, 0.3)
    model = LensRays(learned, LensRayOptions(lens_points=400), generator())
    light = colours(model, scene, at, 0.5).detach().pow(2.2)[:, 0]
    radius = learned.estimate(0, WIDTH).signed_radius(np.array(1 / depth), WIDTH)
    place = (at.places[:, 0] - WIDTH / 2) / WIDTH
    expected = 0.05 + place.square() + float(radius / WIDTH) ** 2 / 4
    found = float((light - 0.05 - place.square()).mean())
    assert found == pytest.approx(float(radius / WIDTH) ** 2 / 4, rel=SAMPLED_DISC, abs=FLOAT32_SCALAR)
    assert float((light - expected).abs().max()) < DISC_OF_A_PIXEL * float(expected.max())


@pytest.mark.slow
def test_a_lens_is_found_before_two_walls() -> None:
    """Photographs of walls at two depths through a known lens: aperture and focus follow."""
    true, learned = lenses(1.2, 0.25), lenses(rate=0.01)
    scenes = [PlaneScene(depth, lambda where: waves(8 * where)) for depth in (2.0, 9.0)]
    target = LensRays(true, LensRayOptions(lens_points=64), generator())
    model = LensRays(learned, LensRayOptions(lens_points=16), torch.Generator().manual_seed(1))
    for step in range(400):
        scene, at = scenes[step % 2], pixels(0, 60)
        with torch.no_grad():
            wanted = colours(target, scene, at, 0.0)
        (colours(model, scene, at, step / 400) - wanted).square().mean().backward()
        gradient = model.gradients()["lens"]
        assert gradient is not None and bool(torch.isfinite(gradient).all())
        model.step(step / 400)
    found, expected = learned.aperture_and_focus(0), true.aperture_and_focus(0)
    assert found == pytest.approx(expected, abs=LENS_FOUND_BY_RAYS)


def test_a_patch_is_the_sharp_patch_through_the_lens() -> None:
    scene, learned = PlaneScene(2.5, lambda where: waves(20 * where)), lenses(1.5, 0.2)
    model = RenderedPatch(learned, PatchOptions(patch_from=0.3))
    places = whole_image(cameras()[1])
    at = Pixels(torch.ones(len(places)).long(), places, torch.zeros(len(places), 3), view=1, width=WIDTH)
    assert torch.equal(colours(model, scene, at, 0.29), sharp(scene, at))
    model.step(0.29)  # no lens was used: nothing happens
    found = colours(model, scene, at, 0.3)
    radius = float(learned.estimate(1, WIDTH).signed_radius(np.array(1 / 2.5), WIDTH))
    image = sharp(scene, at).view(HEIGHT, WIDTH, 3)
    expected = scatter_defocus(image, torch.full((HEIGHT, WIDTH), radius), Blur(2.0)).view(-1, 3)
    torch.testing.assert_close(found, expected, rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)
    found.square().sum().backward()
    assert float(model.gradients()["lens"].abs().min()) > 0
    before = learned.aperture_and_focus(1)
    model.step(0.3)
    assert learned.aperture_and_focus(1) != before


def whole_view(view: int) -> Pixels:
    """All pixels of a view, as a patch."""
    places = whole_image(cameras()[view])
    return Pixels(torch.full((len(places),), view), places, torch.zeros(len(places), 3), view, WIDTH)


@pytest.mark.parametrize("model", [RayModel(), *KERNELS.values(), LensRays(lenses(), LensRayOptions(), generator())])
def test_a_view_is_predicted_as_its_pixels_are_in_training(model: RayModel) -> None:
    scene, at = PlaneScene(3.0, waves), whole_view(1)
    asked = torch.rand(len(at.views), generator=torch.Generator().manual_seed(1)) < 0.3
    with random_from_the_start(model):
        found = model.predict_view(scene, at, asked)
    with random_from_the_start(model):
        ways = model.predict(scene, at.at(asked.nonzero()[:, 0]), 1.0)
    heaviest = max(way.weight for way in ways)
    expected = next(way.colours for way in ways if way.weight == heaviest)
    assert torch.equal(found[asked], expected) and not found.requires_grad
    assert not found[~asked].any()


@contextmanager
def random_from_the_start(model: RayModel) -> Iterator[None]:
    """The model's random numbers from the first on."""
    if hasattr(model, "_generator"):
        model._generator.manual_seed(0)
    yield


def test_a_view_is_predicted_in_parts_that_fit_in_memory() -> None:
    class Counting(PlaneScene):
        most = 0

        def trace(self, origins: Tensor, directions: Tensor) -> RaysSeen:
            self.most = max(self.most, len(origins))
            return super().trace(origins, directions)

    at, all_of_it = whole_view(0), torch.ones(WIDTH * HEIGHT, dtype=torch.bool)
    learned = LensRays(lenses(), LensRayOptions(lens_points=16), generator())
    scene = Counting(3.0, waves)
    assert learned.predict_view(scene, at, all_of_it).shape == (WIDTH * HEIGHT, 3)
    assert RAYS_AT_ONCE // 2 < scene.most <= RAYS_AT_ONCE < 16 * WIDTH * HEIGHT


def test_a_scattered_view_is_predicted_whole() -> None:
    scene, at = PlaneScene(2.5, lambda where: waves(20 * where)), whole_view(1)
    model, nothing = RenderedPatch(lenses(1.5, 0.2), PatchOptions()), torch.zeros(len(at.views), dtype=torch.bool)
    assert torch.equal(model.predict_view(scene, at, nothing), colours(model, scene, at, 1.0).detach())
    never, one = RenderedPatch(lenses(1.5, 0.2), PatchOptions(patch_from=1.1)), ~nothing
    assert torch.equal(never.predict_view(scene, at, one), sharp(scene, at))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: KernelOptions(kernel_points=1), "kernel_points"),
        (lambda: LensRayOptions(lens_points=0), "lens_points"),
        (lambda: PatchOptions(patch_side=1), "patch_side"),
        (lambda: WeightProposalOptions(proposal_samples=0), "proposal_samples"),
        (lambda: WeightProposalOptions(proposal_first=0.0), "proposal_first"),
        (lambda: WeightProposalOptions(proposal_last=1.0), "proposal_last"),
        (lambda: WeightProposalOptions(proposal_every=0.0), "proposal_every"),
    ],
)
def test_wrong_options(make: Any, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()
