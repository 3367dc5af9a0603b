"""The compiled rasterisers against their float64 definition, and what must hold for both."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
import torch
from backends import compiled
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up import frontal
from random_gaussians import (
    NAMES,
    assert_agree,
    assert_close,
    blurred,
    cpu,
    facing,
    reference,
    render,
    scene,
    turned,
    value_tolerance,
    view,
)
from tolerances import BLUR_OF_NEEDLES, FINITE_DIFFERENCE, FLOAT32_GRADIENT, FLOAT32_VALUE, TILING

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import load
from dofbench.runtime.ops.rasterize.reference import rotation_matrices
from dofbench.runtime.raster import ViewStatistics

FRONTAL = Camera(24, 20, 30.0, 30.0, 12.5, 10.5, np.eye(4))

# ---- against the definition ----


@compiled
@pytest.mark.parametrize("geometry", ["none", "depth", "full", "distortion"])
def test_values_and_gradients_agree_with_the_reference(backend: str, geometry: str) -> None:
    options = {"filter_3d": torch.full((40,), 0.03), "background": torch.tensor([0.2, 0.5, 0.1])}
    assert_agree(scene(40, 0), backend, camera=view(), geometry=geometry, **options)


@compiled
@pytest.mark.parametrize(
    ("geometry", "filter_2d", "largest"), [("none", 0.1, 30.0), ("depth", 0.0, 0.3), ("distortion", 0.1, 1000.0)]
)
def test_blurred_values_and_gradients_agree_with_the_reference(backend, geometry, filter_2d, largest) -> None:
    options = {"filter_2d": filter_2d, "filter_3d": torch.full((31,), 0.03)}
    assert_agree(blurred(31, 1, largest), backend, camera=view(40, 30), geometry=geometry, **options)


@compiled
@pytest.mark.parametrize("geometry", ["none", "distortion"])
@pytest.mark.parametrize(("filter_2d", "fades"), [(0.3, False), (0.0, True)])
def test_other_2d_filters(backend: str, geometry: str, filter_2d: float, fades: bool) -> None:
    options = {"filter_2d": filter_2d, "filter_2d_fades": fades}
    assert_agree(scene(30, 5), backend, camera=view(), geometry=geometry, **options)


@compiled
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (33, 1), (16, 16), (9, 33)])
def test_any_image_size(backend: str, width: int, height: int) -> None:
    camera = Camera(width, height, 20.0, 22.0, width / 2 + 0.3, height / 2 - 0.2, turned())
    assert_agree(scene(25, 3), backend, camera=camera, geometry="distortion")


@compiled
@pytest.mark.parametrize(("rest", "degree"), [(0, 3), (3, 3), (8, 2), (15, 0), (15, 1), (15, 2), (15, 3)])
def test_harmonic_degrees(backend: str, rest: int, degree: int) -> None:
    camera = Camera(12, 10, 15.0, 15.0, 6.0, 5.0, turned())
    _, gradients, _ = assert_agree(scene(12, 4, rest=rest), backend, camera=camera, geometry="none", sh_degree=degree)
    used = (min(degree, math.isqrt(rest + 1) - 1) + 1) ** 2 - 1
    assert not gradients["sh_rest"][:, used:].any()
    assert gradients["sh_rest"][:, :used].any() == (used > 0)


@compiled
def test_opaque_tiles_stop_early(backend: str) -> None:
    gaussians = facing(torch.linspace(2, 6, 40).flip(0).tolist(), opacity=0.95)
    outputs, gradients, _ = assert_agree(gaussians, backend, camera=FRONTAL, geometry="distortion")
    assert (outputs.alpha > 0.999).all() and not gradients["means"][:24].any()


@compiled
@pytest.mark.parametrize("blur", [False, True])
def test_needles(backend: str, blur: bool) -> None:
    gaussians = blurred(30, 8, 10.0) if blur else scene(30, 8)
    gaussians["log_scales"] = torch.tensor([[1.0, -6.0, -7.0]]).repeat(30, 1)
    gaussians["opacity_logits"] += 5
    options = {"camera": view(40, 30), "geometry": "distortion"}
    outputs, gradients, _ = render(load("rasterize", backend), gaussians, torch.float32, **options)
    expected_outputs, expected, _ = render(reference, gaussians, torch.float64, **options)
    for name, output in outputs._asdict().items():
        assert_close(output, getattr(expected_outputs, name), value_tolerance(name), name)
    for name, gradient in gradients.items():
        assert_close(gradient, expected[name], BLUR_OF_NEEDLES if name == "blur" else FLOAT32_GRADIENT, name)


@compiled
def test_around_the_near_plane(backend: str) -> None:
    gaussians = scene(30, 9)
    gaussians["means"] = gaussians["means"] * 0.2
    gaussians["means"][:, 2] = torch.linspace(-0.3, 0.7, 30)
    gaussians["log_scales"] -= 1.5
    _, gradients, statistics = assert_agree(gaussians, backend, camera=view(pose=np.eye(4)), geometry="distortion")
    behind = gaussians["means"][:, 2] <= 0.2
    assert not statistics.visible[behind].any()
    assert not any(gradient[behind].any() for gradient in gradients.values())


@compiled
@pytest.mark.parametrize("blur", [False, True])
def test_a_dilated_gaussian_without_width_is_drawn(backend: str, blur: bool) -> None:
    """Seen along its plane, a flat Gaussian's footprint is a line: its determinant is 0 before it is dilated."""
    gaussians = scene(25, 9)
    gaussians["log_scales"] = torch.tensor([[-1.0, -30.0, -200.0]]).repeat(25, 1)
    gaussians["opacity_logits"] += 5
    if blur:
        gaussians["blur"] = torch.linspace(0, 4, 25)
    options = {"camera": view(), "geometry": "none"}
    outputs, gradients, statistics = assert_agree(gaussians, backend, **options, filter_2d=0.3, filter_2d_fades=False)
    assert outputs.alpha.max() > 0.1 and gradients["means"].any() and statistics.visible.any()
    outputs, gradients, statistics = render(load("rasterize", backend), gaussians, torch.float32, **options)
    assert not (outputs.alpha.any() or gradients["means"].any() or statistics.visible.any())


@compiled
@pytest.mark.parametrize("opacity", [0.9995, 0.5, 0.0038])
@pytest.mark.parametrize(("filter_2d", "fades"), [(0.0, True), (0.1, True), (0.1, False)])
def test_small_gaussians_and_opacities_around_their_ends(backend, opacity, filter_2d, fades) -> None:
    """Gaussians of 0.025, 0.04, 0.3 and 1 pixel, each in the middle of a pixel, before one that all see."""
    sizes = torch.tensor([0.025, 0.04, 0.3, 1.0, 20.0])
    gaussians = facing([3.0] * 5, opacity)
    gaussians["means"] = torch.tensor(
        [[-0.8, -0.6, 3.0], [0.0, 0.0, 3.0], [0.5, 0.3, 3.0], [-0.4, 0.4, 3.0], [0, 0, 4]]
    )
    gaussians["log_scales"] = torch.log(sizes * gaussians["means"][:, 2] / 30)[:, None] + torch.tensor([0.0, 0.2, -0.2])
    gaussians["quaternions"] = torch.tensor([[0.9, 0.1, -0.2, 0.3]]).repeat(5, 1)
    gaussians["opacity_logits"][-1] = 6.0  # held at the largest alpha around its middle
    options = {"geometry": "none", "filter_2d": filter_2d, "filter_2d_fades": fades}
    _, _, statistics = assert_agree(gaussians, backend, camera=FRONTAL, **options)
    drawn = opacity > 1 / 255
    # Without the filter or with one that fades, the determinant of the smallest is below the least.
    assert statistics.visible.tolist() == [drawn and not fades, drawn, drawn, drawn, True]


@compiled
@pytest.mark.parametrize("aside", [0.0, 4e-8, 1e-3])
def test_a_thin_gaussian_seen_along_its_plane(backend: str, aside: float) -> None:
    """On the axis, a hundred-millionth of its distance beside it, where it counts as seen edge-on, and further."""
    gaussians = facing([4.0, 5.0])
    gaussians["means"][0, 0] = aside
    gaussians["log_scales"][0] = torch.tensor([-30.0, -1.0, -1.0])
    options = {"camera": FRONTAL, "geometry": "full", "filter_2d": 0.3, "filter_2d_fades": False}
    assert_agree(gaussians, backend, **options)
    alone, _, _ = assert_agree({name: value[:1] for name, value in gaussians.items()}, backend, **options)
    assert alone.alpha.any() and alone.normal.any() == (aside != 4e-8)


@compiled
def test_ray_lengths_are_held_at_the_near_plane(backend: str) -> None:
    """Two tilted planes that begin beyond the near plane and pass through it."""
    gaussians = facing([0.6, 0.8], opacity=0.6)
    gaussians["quaternions"] = torch.tensor([[math.cos(0.5), 0.0, math.sin(0.5), 0.0]]).repeat(2, 1)
    gaussians["log_scales"] = torch.tensor([[-1.0, -1.0, -8.0]]).repeat(2, 1)
    outputs, _, _ = assert_agree(gaussians, backend, camera=FRONTAL, geometry="distortion", near=0.55)
    lengths = outputs.depth.detach() * ((torch.arange(24) + 0.5 - 12.5) / 30).square().add(1).sqrt()
    assert (lengths[10] > 0.56).any()
    assert_close(lengths[10].min(), torch.tensor(0.55), FLOAT32_VALUE, "ray length")


@compiled
@pytest.mark.parametrize("chosen", range(6))
def test_gradients_of_one_output_only(backend: str, chosen: int) -> None:
    gaussians = scene(20, 12)
    pairs = []
    for kernel, dtype in ((load("rasterize", backend), torch.float32), (reference, torch.float64)):
        inputs = {name: value.to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
        kernel(**inputs, camera=view(16, 16), geometry="distortion")[chosen].square().sum().backward()
        pairs.append([value.grad for value in inputs.values()])
    for name, found, expected in zip(NAMES, *pairs, strict=True):
        expected = torch.zeros_like(found) if expected is None else expected
        assert_close(found, expected, FLOAT32_GRADIENT, name)


@pytest.mark.parametrize("filter_2d", [0.0, 0.1])
def test_reference_against_finite_differences(filter_2d: float) -> None:
    gaussians = {name: value.double() for name, value in blurred(8, 13, 9.0).items()}
    gaussians["blur"] += 0.01  # so that a step down is still a variance
    gaussians["log_scales"] += 1
    gaussians["opacity_logits"].clamp_(max=3)
    filter_3d, generator = torch.full((8,), 0.05).double(), torch.Generator().manual_seed(1)

    def loss(inputs):
        outputs = reference(
            **inputs, camera=view(9, 7), geometry="distortion", filter_2d=filter_2d, filter_3d=filter_3d
        )
        weights = torch.Generator().manual_seed(2)
        return sum((o * torch.randn(o.shape, generator=weights, dtype=torch.float64)).sum() for o in outputs)

    for name, value in gaussians.items():
        leaf = value.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(loss({**gaussians, name: leaf}), leaf)
        move = 1e-6 * torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        with torch.no_grad():
            ends = [loss({**gaussians, name: value + sign * move}) for sign in (1, -1)]
        predicted = (gradient * move).sum() / 1e-6
        assert abs((ends[0] - ends[1]) / 2e-6 - predicted) <= FINITE_DIFFERENCE * max(1.0, abs(predicted)), name


# ---- scenes that show little, and numbers at their ends ----


@compiled
def test_no_gaussians(backend: str) -> None:
    options = {"camera": view(), "geometry": "distortion", "background": torch.tensor([0.1, 0.2, 0.3])}
    outputs, gradients, statistics = render(load("rasterize", backend), scene(0, 0), torch.float32, **options)
    assert torch.equal(outputs.color, options["background"].expand(20, 24, 3))
    assert not any(output.any() for output in outputs[1:])
    assert gradients["means"].shape == (0, 3) and gradients["sh_rest"].shape == (0, 15, 3)
    assert statistics.visible.shape == (0,) and statistics.abs_grad_2d.shape == (0, 2)


@compiled
@pytest.mark.parametrize("place", ["behind", "beside"])
def test_gaussians_outside_the_view(backend: str, place: str) -> None:
    gaussians = scene(9, 2)
    gaussians["means"][:, 2 if place == "behind" else 0] -= 50
    options = {"camera": view(), "geometry": "distortion"}
    outputs, gradients, statistics = render(load("rasterize", backend), gaussians, torch.float32, **options)
    for nothing in (*outputs, *gradients.values(), statistics.visible, statistics.radii, statistics.grad_2d):
        assert not nothing.any()


@compiled
def test_empty_pixels_are_zero(backend: str) -> None:
    gaussians = {name: value[:1] for name, value in scene(1, 11).items()}
    gaussians["means"] = torch.tensor([[0.0, 0.0, 4.0]])
    gaussians["log_scales"] = torch.tensor([[-3.0, -2.5, -3.5]])
    gaussians["opacity_logits"] = torch.tensor([3.0])
    outputs, _, _ = assert_agree(gaussians, backend, camera=view(pose=np.eye(4)), geometry="distortion")
    empty = outputs.alpha == 0
    assert empty.any() and not empty.all()
    assert not any(output[empty].any() for output in outputs)


@compiled
def test_zero_quaternion_is_no_rotation(backend: str) -> None:
    gaussians, kernel = scene(12, 10), load("rasterize", backend)
    turned_none = dict(gaussians, quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(12, 1))
    a, gradients, _ = render(kernel, dict(gaussians, quaternions=torch.zeros(12, 4)), torch.float32, camera=view())
    b, _, _ = render(kernel, turned_none, torch.float32, camera=view())
    assert torch.equal(a.color, b.color) and a.color.any()
    assert not gradients["quaternions"].any()


def assert_extreme_stay_finite(backend: str, seed: int, size: float, spread: float, depth: float, **options) -> None:
    gaussians = scene(20, seed)
    gaussians["log_scales"] = (gaussians["log_scales"] + 2) * spread + size
    gaussians["means"][:, 2] = gaussians["means"][:, 2] - 4 + depth
    gaussians["quaternions"] *= 1e-15 if seed % 2 else 1e15
    options |= {"camera": view(), "geometry": "distortion"}
    outputs, gradients, statistics = render(load("rasterize", backend), gaussians, torch.float32, **options)
    assert all(torch.isfinite(output).all() for output in (*outputs, statistics.abs_grad_2d))
    assert (outputs.alpha >= 0).all() and (outputs.alpha <= 1).all() and (outputs.depth >= 0).all()
    for name, gradient in gradients.items():
        assert name == "quaternions" or torch.isfinite(gradient).all(), name


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(-25, 3), st.floats(0, 6), st.floats(0.0, 3.0), st.sampled_from([0.0, 0.1]))
def test_extreme_gaussians_stay_finite(seed, size, spread, depth, filter_2d) -> None:
    assert_extreme_stay_finite("cpu", seed, size, spread, depth, filter_2d=filter_2d)


@compiled
@pytest.mark.parametrize(("seed", "size", "spread", "depth"), [(1, -25.0, 0.0, 0.5), (2, 3.0, 1.0, 3.0), (3, -3, 6, 0)])
def test_some_extreme_gaussians_stay_finite(backend, seed, size, spread, depth) -> None:
    assert_extreme_stay_finite(backend, seed, size, spread, depth, filter_2d=0.0 if seed == 3 else 0.1)


def test_rotations_of_special_quaternions() -> None:
    """Half a turn about z, of any length; a third of a turn takes x to y, y to z; none for a quaternion of zeros."""
    quaternions = torch.tensor([[0, 0, 0, 2], [0.5, 0.5, 0.5, 0.5], [0, 0, 0, 0], [-3, 0, 0, 0]], dtype=torch.float64)
    found = rotation_matrices(quaternions)
    assert torch.equal(found[0], torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)))
    assert torch.equal(found[1], torch.eye(3, dtype=torch.float64)[[2, 0, 1]])
    assert torch.equal(found[2], torch.eye(3, dtype=torch.float64)) and torch.equal(found[3], found[2])


# ---- what doesn't change anything ----


def assert_same_bits(one, other, order=slice(None)) -> None:
    """Of two results of `render`, the other with Gaussians in another order."""
    assert all(torch.equal(a, b) for a, b in zip(one[0], other[0], strict=True) if a is not None)
    assert all(torch.equal(one[1][name][order], other[1][name]) for name in other[1])
    assert torch.equal(one[2].abs_grad_2d[order], other[2].abs_grad_2d)


@compiled
def test_the_same_bits_twice_and_in_any_order(backend: str) -> None:
    gaussians, kernel = blurred(20, 14, 5.0), load("rasterize", backend)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    shuffled = {name: value[order].contiguous() for name, value in gaussians.items()}
    options = {"camera": view(20, 16), "geometry": "distortion"}
    one, again, other = (render(kernel, each, torch.float32, **options) for each in (gaussians, gaussians, shuffled))
    assert_same_bits(one, again)
    assert_same_bits(one, other, order)


def test_the_same_bits_on_any_number_of_threads() -> None:
    gaussians, threads = blurred(500, 15, 40.0), numba.get_num_threads()
    try:
        runs = []
        for count in (threads, 1):
            numba.set_num_threads(count)
            runs.append(render(cpu, gaussians, torch.float32, camera=view(70, 50), geometry="distortion"))
    finally:
        numba.set_num_threads(threads)
    assert_same_bits(*runs)


def test_a_crop_is_the_crop_of_the_image() -> None:
    camera = frontal(60, 50, 55.0)
    crop = Camera(27, 29, 55.0, 55.0, 30.0 - 13, 25.0 - 9, np.eye(4))
    gaussians = scene(150, 16)
    # Inside the crop, so that neither image's bound on the Jacobian is met.
    z = gaussians["means"][:, 2].abs() + 2
    pixel = torch.rand(150, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([26.0, 28.0])
    xy = (pixel + torch.tensor([13.0 - 30.0, 9.0 - 25.0])) / 55.0 * z[:, None]
    gaussians["means"] = torch.cat([xy, z[:, None]], 1)
    whole = cpu(**gaussians, camera=camera, geometry="distortion")
    part = cpu(**gaussians, camera=crop, geometry="distortion")
    for name, a, b in zip(whole._fields, whole, part, strict=True):
        assert_close(b, a[9:38, 13:40], TILING, name)


@compiled
def test_gradients_and_statistics_are_only_taken_where_asked_for(backend: str) -> None:
    kernel, inputs = load("rasterize", backend), {name: value.requires_grad_() for name, value in scene(12, 3).items()}
    blur, statistics = torch.full((12,), 2.0), ViewStatistics()
    kernel(**inputs, camera=view(), blur=blur, statistics=statistics).color.sum().backward()
    assert blur.grad is None and inputs["means"].grad.any()
    assert statistics.grad_2d.any() and statistics.abs_grad_2d is None
    with torch.no_grad():
        assert not kernel(**inputs, camera=view()).color.requires_grad


# ---- wrong arguments ----


@compiled
@pytest.mark.parametrize("name", [*NAMES, "filter_3d", "blur"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_parameter_is_named(backend: str, name: str, value: float) -> None:
    gaussians = {**scene(20, 17), "filter_3d": torch.full((20,), 0.1), "blur": torch.full((20,), 0.1)}
    gaussians["means"][:, 2] = 4
    gaussians["opacity_logits"][:] = 1
    gaussians[name].view(20, -1)[13, 0] = value
    kernel = load("rasterize", backend)
    if name == "opacity_logits" and value == math.inf:
        assert torch.isfinite(kernel(**gaussians, camera=view()).color).all()
        return
    with pytest.raises(FloatingPointError, match=rf"{name}\[13\]"):
        kernel(**gaussians, camera=view())


@compiled
def test_a_projection_that_overflows_is_told(backend: str) -> None:
    gaussians = scene(5, 17)
    gaussians["means"][3] = torch.tensor([0.0, 0.0, 4.0])
    gaussians["log_scales"][3] = 60.0
    with pytest.raises(FloatingPointError, match="Gaussian 3: its projection overflows float32"):
        load("rasterize", backend)(**gaussians, camera=view())


@compiled
@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("means", torch.zeros(4, 2), r"means: expected shape \(4, 3\), found \(4, 2\)"),
        ("quaternions", torch.zeros(4, 4).double(), "quaternions: expected torch.float32 on cpu"),
        ("sh_dc", torch.zeros(3, 4).T, "sh_dc: expected a contiguous tensor"),
        ("sh_rest", torch.zeros(4, 5, 3), "sh_rest: expected shape"),
        ("filter_3d", torch.zeros(3), r"filter_3d: expected shape \(4,\)"),
        ("background", torch.zeros(3, requires_grad=True), "background: expected a tensor without gradient"),
        ("blur", torch.zeros(3), r"blur: expected shape \(4,\), found \(3,\)"),
        ("blur", torch.tensor([0.0, 1.0, -0.5, 2.0]), "blur: expected at least 0, found -0.5"),
        ("geometry", "depths", "geometry: expected one of none, depth, full, distortion, found 'depths'"),
        ("sh_degree", 4, "sh_degree: expected 0, 1, 2 or 3, found 4"),
        ("filter_2d", -0.1, "filter_2d: expected at least 0"),
        ("near", 0.0, "near: expected more than 0"),
    ],
)
def test_wrong_arguments_are_named(backend: str, name: str, value: object, found: str) -> None:
    with pytest.raises(ValueError, match=found):
        load("rasterize", backend)(**{**scene(4, 18), "camera": view(), name: value})
