"""The rasteriser's Triton kernels, interpreted, against its float64 definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
import random_gaussians
import torch
from random_gaussians import NAMES, assert_agree, assert_close, reference, render, scene, turned, view
from tolerances import BLUR_OF_NEEDLES, DISTORTION, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import load
from dofbench.runtime.raster import ViewStatistics

gpu = load("rasterize", "gpu")
FRONTAL = Camera(24, 20, 30.0, 30.0, 12.5, 10.5, np.eye(4))


@pytest.fixture(autouse=True)
def _compared_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """`assert_agree` compares this backend in the place of the CPU's."""
    monkeypatch.setattr(random_gaussians, "cpu", gpu)


def blurred(n: int, seed: int, largest: float) -> dict[str, torch.Tensor]:
    """A scene with blur; a third of the Gaussians has none, a seventh next to none."""
    blur = torch.rand(n, generator=torch.Generator().manual_seed(seed)) * largest
    blur[1::7] *= 1e-5
    blur[::3] = 0
    return {**scene(n, seed), "blur": blur}


def facing(depths: list[float], opacity: float = 0.4) -> dict[str, torch.Tensor]:
    """Flat Gaussians across the axis of FRONTAL, much wider than the image."""
    n = len(depths)
    return {
        "means": torch.tensor([[0.0, 0.0, depth] for depth in depths]),
        "log_scales": torch.tensor([[2.5, 2.5, -8.0]]).repeat(n, 1),
        "quaternions": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        "opacity_logits": torch.full((n,), math.log(opacity / (1 - opacity))),
        "sh_dc": torch.arange(3.0 * n).reshape(n, 3) / n - 1,
        "sh_rest": torch.zeros(n, 0, 3),
    }


# ---- against the definition ----


@pytest.mark.parametrize("geometry", ["none", "depth", "full", "distortion"])
def test_values_and_gradients_agree_with_the_reference(geometry: str) -> None:
    background = torch.tensor([0.2, 0.5, 0.1])
    assert_agree(
        scene(40, 0), camera=view(), geometry=geometry, filter_3d=torch.full((40,), 0.03), background=background
    )


@pytest.mark.parametrize(
    ("geometry", "filter_2d", "largest"), [("none", 0.1, 30.0), ("depth", 0.0, 0.3), ("distortion", 0.1, 1000.0)]
)
def test_blurred_values_and_gradients_agree_with_the_reference(geometry, filter_2d, largest) -> None:
    assert_agree(
        blurred(31, 1, largest),
        camera=view(40, 30),
        geometry=geometry,
        filter_2d=filter_2d,
        filter_3d=torch.full((31,), 0.03),
    )


@pytest.mark.parametrize("geometry", ["none", "distortion"])
def test_dilated_values_and_gradients_agree_with_the_reference(geometry: str) -> None:
    assert_agree(scene(30, 5), camera=view(), geometry=geometry, filter_2d=0.3, filter_2d_fades=False)


def test_without_the_2d_filter() -> None:
    assert_agree(scene(30, 5), camera=view(), geometry="distortion", filter_2d=0.0)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (33, 1), (16, 16)])
def test_any_image_size(width: int, height: int) -> None:
    camera = Camera(width, height, 20.0, 22.0, width / 2 + 0.3, height / 2 - 0.2, turned())
    assert_agree(scene(25, 3), camera=camera, geometry="distortion")


@pytest.mark.parametrize(("rest", "degree"), [(0, 3), (3, 3), (8, 2), (15, 0), (15, 1), (15, 2), (15, 3)])
def test_harmonic_degrees(rest: int, degree: int) -> None:
    camera = Camera(12, 10, 15.0, 15.0, 6.0, 5.0, turned())
    _, gradients, _ = assert_agree(scene(12, 4, rest=rest), camera=camera, geometry="none", sh_degree=degree)
    used = (min(degree, math.isqrt(rest + 1) - 1) + 1) ** 2 - 1
    assert not gradients["sh_rest"][:, used:].any()
    assert gradients["sh_rest"][:, :used].any() == (used > 0)


def test_opaque_tiles_stop_early() -> None:
    gaussians = facing(torch.linspace(2, 6, 40).flip(0).tolist(), opacity=0.95)
    outputs, gradients, _ = assert_agree(gaussians, camera=FRONTAL, geometry="distortion")
    assert (outputs.alpha > 0.999).all() and not gradients["means"][:24].any()
    # Each of the four tiles has all 40 in its list, of which it should look at few.
    looked_at = outputs.color.grad_fn.blended[0]
    assert looked_at.shape == (4,) and int(looked_at.max()) < 24


@pytest.mark.parametrize(
    "geometry, count, opacity",
    [("none", 131, 0.02), ("depth", 128, 0.01), ("full", 131, 0.02), ("distortion", 192, 0.06)],
)
def test_the_gradient_goes_on_from_chunk_to_chunk(geometry: str, count: int, opacity: float) -> None:
    """Lists of several chunks of 64 Gaussians, that end with a chunk or within one; the last becomes opaque before."""
    of_scene = {name: scene(count, 5)[name] for name in ("quaternions", "sh_dc")}
    gaussians = facing(torch.linspace(4, 8, count).tolist(), opacity) | of_scene
    gaussians["log_scales"] = torch.tensor([0.5, 0.0, -1.0]).repeat(count, 1)
    outputs, _, _ = assert_agree(gaussians, camera=FRONTAL, geometry=geometry)
    assert int(outputs.color.grad_fn.blended[0].max()) > 64


def test_equal_depths_are_blended_in_the_order_of_their_numbers() -> None:
    outputs, _, _ = assert_agree(facing([3.0] * 9), camera=FRONTAL, geometry="full")
    assert outputs.alpha.min() > 0.9


@pytest.mark.parametrize("blur", [False, True])
def test_needles(blur: bool) -> None:
    gaussians = blurred(30, 8, 10.0) if blur else scene(30, 8)
    gaussians["log_scales"] = torch.tensor([[1.0, -6.0, -7.0]]).repeat(30, 1)
    gaussians["opacity_logits"] += 5
    options = {"camera": view(40, 30), "geometry": "distortion"}
    outputs, gradients, _ = render(gpu, gaussians, torch.float32, **options)
    expected_outputs, expected, _ = render(reference, gaussians, torch.float64, **options)
    for name, output in outputs._asdict().items():
        assert_close(output, getattr(expected_outputs, name), random_gaussians.value_tolerance(name), name)
    for name, gradient in gradients.items():
        assert_close(gradient, expected[name], BLUR_OF_NEEDLES if name == "blur" else FLOAT32_GRADIENT, name)


def test_around_the_near_plane() -> None:
    gaussians = scene(30, 9)
    gaussians["means"] = gaussians["means"] * 0.2
    gaussians["means"][:, 2] = torch.linspace(-0.3, 0.7, 30)
    gaussians["log_scales"] -= 1.5
    _, gradients, statistics = assert_agree(gaussians, camera=view(pose=np.eye(4)), geometry="distortion")
    behind = gaussians["means"][:, 2] <= 0.2
    assert not statistics.visible[behind].any()
    assert not any(gradient[behind].any() for gradient in gradients.values())


def test_gaussians_without_width() -> None:
    """Seen along its plane, a flat Gaussian's footprint is a line: its determinant is 0 before it is dilated."""
    gaussians = scene(25, 9)
    gaussians["log_scales"] = torch.tensor([[-1.0, -30.0, -200.0]]).repeat(25, 1)
    gaussians["opacity_logits"] += 5
    options = {"camera": view(), "geometry": "none"}
    outputs, gradients, statistics = assert_agree(gaussians, **options, filter_2d=0.3, filter_2d_fades=False)
    assert outputs.alpha.max() > 0.1 and gradients["means"].any() and statistics.visible.any()
    outputs, gradients, statistics = render(gpu, gaussians, torch.float32, **options)
    assert not (outputs.alpha.any() or gradients["means"].any() or statistics.visible.any())


@pytest.mark.parametrize("opacity", [0.9995, 0.5, 0.0038])
@pytest.mark.parametrize(("filter_2d", "fades"), [(0.0, True), (0.1, True), (0.1, False)])
def test_small_gaussians_and_opacities_around_their_ends(opacity: float, filter_2d: float, fades: bool) -> None:
    """Gaussians of 0.025, 0.04, 0.3 and 1 pixel, each in the middle of a pixel, before one that all see."""
    sizes = torch.tensor([0.025, 0.04, 0.3, 1.0, 20.0])
    gaussians = facing([3.0] * 5, opacity)
    gaussians["means"] = torch.tensor(
        [[-0.8, -0.6, 3.0], [0.0, 0.0, 3.0], [0.5, 0.3, 3.0], [-0.4, 0.4, 3.0], [0, 0, 4]]
    )
    gaussians["log_scales"] = torch.log(sizes * gaussians["means"][:, 2] / 30)[:, None] + torch.tensor([0.0, 0.2, -0.2])
    gaussians["quaternions"] = torch.tensor([[0.9, 0.1, -0.2, 0.3]]).repeat(5, 1)
    gaussians["opacity_logits"][-1] = 6.0  # held at the largest alpha around its middle
    _, _, statistics = assert_agree(
        gaussians, camera=FRONTAL, geometry="none", filter_2d=filter_2d, filter_2d_fades=fades
    )
    drawn = opacity > 1 / 255
    # Without the filter or with one that fades, the determinant of the smallest is below the least.
    assert statistics.visible.tolist() == [drawn and not fades, drawn, drawn, drawn, True]


@pytest.mark.parametrize("aside", [0.0, 4e-8, 1e-3])
def test_a_thin_gaussian_seen_along_its_plane(aside: float) -> None:
    """On the axis, a hundred-millionth of its distance beside it, where it counts as seen edge-on, and further."""
    gaussians = facing([4.0, 5.0])
    gaussians["means"][0, 0] = aside
    gaussians["log_scales"][0] = torch.tensor([-30.0, -1.0, -1.0])
    options = {"camera": FRONTAL, "geometry": "full", "filter_2d": 0.3, "filter_2d_fades": False}
    outputs, _, _ = assert_agree(gaussians, **options)
    alone, _, _ = assert_agree({name: value[:1] for name, value in gaussians.items()}, **options)
    assert outputs.alpha.any() and alone.alpha.any()
    assert alone.normal.any() == (aside != 4e-8)


def test_ray_lengths_are_held_at_the_near_plane() -> None:
    """Two tilted planes that begin beyond the near plane and pass through it."""
    gaussians = facing([0.6, 0.8], opacity=0.6)
    gaussians["quaternions"] = torch.tensor([[math.cos(0.5), 0.0, math.sin(0.5), 0.0]]).repeat(2, 1)
    gaussians["log_scales"] = torch.tensor([[-1.0, -1.0, -8.0]]).repeat(2, 1)
    outputs, _, _ = assert_agree(gaussians, camera=FRONTAL, geometry="distortion", near=0.55)
    lengths = outputs.depth.detach() * ((torch.arange(24) + 0.5 - 12.5) / 30).square().add(1).sqrt()
    assert (lengths[10] > 0.56).any()
    assert_close(lengths[10].min(), torch.tensor(0.55), FLOAT32_VALUE, "ray length")


def test_zero_quaternion_is_no_rotation() -> None:
    gaussians = scene(12, 10)
    turned_none = dict(gaussians, quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(12, 1))
    a, gradients, _ = render(gpu, dict(gaussians, quaternions=torch.zeros(12, 4)), torch.float32, camera=view())
    b, _, _ = render(gpu, turned_none, torch.float32, camera=view())
    assert torch.equal(a.color, b.color) and a.color.any()
    assert not gradients["quaternions"].any()


@pytest.mark.parametrize("chosen", range(6))
def test_gradients_of_one_output_only(chosen: int) -> None:
    gaussians = scene(20, 12)
    pairs = []
    for kernel, dtype in ((gpu, torch.float32), (reference, torch.float64)):
        inputs = {name: value.to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
        kernel(**inputs, camera=view(16, 16), geometry="distortion")[chosen].square().sum().backward()
        pairs.append([value.grad for value in inputs.values()])
    for name, found, expected in zip(NAMES, *pairs, strict=True):
        expected = torch.zeros_like(found) if expected is None else expected
        assert_close(found, expected, FLOAT32_GRADIENT, name)


def test_the_depth_of_what_is_faint_has_exact_gradients() -> None:
    """Blur spreads two Gaussians so far that nothing of alpha would be left of 1 - transmittance."""
    gaussians = {**facing([3.0, 5.0]), "blur": torch.tensor([1e6, 2e6])}
    gaussians["log_scales"] = torch.full((2, 3), -3.0)
    pairs = []
    for kernel, dtype in ((gpu, torch.float32), (reference, torch.float64)):
        inputs = {name: value.to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
        raster = kernel(**inputs, camera=FRONTAL)
        assert 0 < 10_000 * float(raster.alpha.detach().max()) < 1
        raster.depth.sum().backward()
        pairs.append(inputs["opacity_logits"].grad)
    assert_close(*pairs, FLOAT32_GRADIENT, "gradient of opacity_logits")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_thin_layer_keeps_the_digits_of_its_distortion(seed: int) -> None:
    """Against float64, pixel by pixel. Moments about zero would be off by more than the value itself."""
    generator = torch.Generator().manual_seed(seed)
    gaussians = facing((5 + 1e-3 * torch.randn(12, generator=generator)).tolist())
    found = gpu(**gaussians, camera=FRONTAL, geometry="distortion").distortion.double()
    exact = {name: value.double() for name, value in gaussians.items()}
    expected = reference(**exact, camera=FRONTAL, geometry="distortion").distortion
    assert ((found / expected - 1).abs() < DISTORTION).all()


def test_alpha_is_at_most_one_where_rounding_adds_up() -> None:
    """Nine hundred faint Gaussians leave just over the least transmittance to an opaque one; their weights, rounded one
    by one, sum to more than 1 at some pixels."""
    faint = torch.rand(916, generator=torch.Generator().manual_seed(2)).mul(-2e-4).add(0.01)
    gaussians = facing(torch.linspace(2, 4, 917).tolist())
    gaussians["opacity_logits"][:916] = torch.logit(faint)
    gaussians["opacity_logits"][916] = 9.0
    alpha = gpu(**gaussians, camera=Camera(16, 16, 30.0, 30.0, 8.5, 8.5, np.eye(4))).alpha
    assert (alpha <= 1).all() and (alpha == 1).any()


# ---- scenes that show little, and numbers at their ends ----


def test_no_gaussians() -> None:
    background = torch.tensor([0.1, 0.2, 0.3])
    outputs, gradients, statistics = render(
        gpu, scene(0, 0), torch.float32, camera=view(), geometry="distortion", background=background
    )
    assert torch.equal(outputs.color, background.expand(20, 24, 3))
    for output in outputs[1:]:
        assert not output.any()
    assert gradients["means"].shape == (0, 3) and gradients["sh_rest"].shape == (0, 15, 3)
    assert statistics.visible.shape == (0,) and statistics.abs_grad_2d.shape == (0, 2)


@pytest.mark.parametrize("place", ["behind", "beside"])
def test_gaussians_that_nobody_sees(place: str) -> None:
    gaussians = scene(9, 2)
    gaussians["means"][:, 2 if place == "behind" else 0] -= 50
    outputs, gradients, statistics = render(gpu, gaussians, torch.float32, camera=view(), geometry="distortion")
    for nothing in (*outputs, *gradients.values(), statistics.visible, statistics.radii, statistics.grad_2d):
        assert not nothing.any()


def test_empty_pixels_are_zero() -> None:
    gaussians = {name: value[:1] for name, value in scene(1, 11).items()}
    gaussians["means"] = torch.tensor([[0.0, 0.0, 4.0]])
    gaussians["log_scales"] = torch.tensor([[-3.0, -2.5, -3.5]])
    gaussians["opacity_logits"] = torch.tensor([3.0])
    outputs, _, _ = assert_agree(gaussians, camera=view(pose=np.eye(4)), geometry="distortion")
    empty = outputs.alpha == 0
    assert empty.any() and not empty.all()
    assert not any(output[empty].any() for output in outputs)


@pytest.mark.parametrize(("seed", "size", "spread", "depth"), [(1, -25.0, 0.0, 0.5), (2, 3.0, 1.0, 3.0), (3, -3, 6, 0)])
def test_extreme_gaussians_stay_finite(seed: int, size: float, spread: float, depth: float) -> None:
    gaussians = scene(20, seed)
    gaussians["log_scales"] = (gaussians["log_scales"] + 2) * spread + size
    gaussians["means"][:, 2] = gaussians["means"][:, 2] - 4 + depth
    gaussians["quaternions"] *= 1e-15 if seed % 2 else 1e15
    outputs, gradients, statistics = render(
        gpu, gaussians, torch.float32, camera=view(), geometry="distortion", filter_2d=0.0 if seed == 3 else 0.1
    )
    for output in (*outputs, statistics.abs_grad_2d):
        assert torch.isfinite(output).all()
    assert (outputs.alpha >= 0).all() and (outputs.alpha <= 1).all()
    for name, gradient in gradients.items():
        if name != "quaternions":
            assert torch.isfinite(gradient).all(), name


# ---- what doesn't change anything ----


def test_the_same_bits_twice_and_in_any_order() -> None:
    gaussians, camera = blurred(20, 14, 5.0), view(20, 16)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    shuffled = {name: value[order].contiguous() for name, value in gaussians.items()}
    a, b = (render(gpu, gaussians, torch.float32, camera=camera, geometry="distortion") for _ in range(2))
    c = render(gpu, shuffled, torch.float32, camera=camera, geometry="distortion")
    for other, at in ((b, slice(None)), (c, order)):
        assert all(torch.equal(x, y) for x, y in zip(a[0], other[0], strict=True))
        assert all(torch.equal(a[1][name][at], other[1][name]) for name in gaussians)
        assert torch.equal(a[2].abs_grad_2d[at], other[2].abs_grad_2d)


def test_gradients_and_statistics_are_only_taken_where_asked_for() -> None:
    inputs = {name: value.requires_grad_() for name, value in scene(12, 3).items()}
    blur, statistics = torch.full((12,), 2.0), ViewStatistics()
    gpu(**inputs, camera=view(), blur=blur, statistics=statistics).color.sum().backward()
    assert blur.grad is None and inputs["means"].grad.any()
    assert statistics.grad_2d.any() and statistics.abs_grad_2d is None
    with torch.no_grad():
        assert not gpu(**inputs, camera=view()).color.requires_grad
