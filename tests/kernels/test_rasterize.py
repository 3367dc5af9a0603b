"""The compiled rasteriser against its float64 definition, and both against known geometry."""

import math

import numba
import numpy as np
import pytest
import torch
from dofbench.runtime.ops.rasterize.reference import rotation_matrices
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up import frontal
from random_gaussians import NAMES, assert_agree, assert_close, cpu, reference, render, scene, turned, view
from tolerances import FINITE_DIFFERENCE, FLOAT32_GRADIENT, PLANE_DEPTH, TILING

from dofbench.core.cameras import Camera


@pytest.mark.parametrize("geometry", ["none", "depth", "full", "distortion"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_values_and_gradients_agree_with_the_reference(geometry, seed):
    n = 60 + seed
    assert_agree(
        scene(n, seed),
        camera=view(),
        geometry=geometry,
        filter_3d=torch.full((n,), 0.03),
        background=torch.tensor([0.2, 0.5, 0.1]),
    )


@pytest.mark.parametrize("width,height", [(1, 1), (1, 37), (33, 1), (8, 32), (9, 33)])
def test_any_image_size(width, height):
    camera = Camera(width, height, 20.0, 22.0, width / 2 + 0.3, height / 2 - 0.2, turned())
    assert_agree(scene(41, 3), camera=camera, geometry="distortion")


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonic_degrees(rest, degree):
    _, gradients, _ = assert_agree(scene(20, 4, rest=rest), camera=view(), geometry="none", sh_degree=degree)
    used = (min(degree, math.isqrt(rest + 1) - 1) + 1) ** 2 - 1
    assert not gradients["sh_rest"][:, used:].any()


def test_without_the_2d_filter():
    assert_agree(scene(50, 5), camera=view(), geometry="distortion", filter_2d=0.0)


def test_opaque_tiles_stop_early():
    gaussians = scene(400, 6, size=-0.5)
    gaussians["opacity_logits"] += 4
    outputs, _, _ = assert_agree(gaussians, camera=view(), geometry="distortion")
    assert (outputs.alpha > 0.999).all()


def test_needles():
    gaussians = scene(40, 8)
    gaussians["log_scales"] = torch.tensor([[1.0, -6.0, -7.0]]).repeat(40, 1)
    gaussians["opacity_logits"] += 5
    assert_agree(gaussians, camera=view(48, 40), geometry="distortion")


def test_around_the_near_plane():
    gaussians = scene(30, 9)
    gaussians["means"] = gaussians["means"] * 0.2
    gaussians["means"][:, 2] = torch.linspace(-0.3, 0.7, 30)
    gaussians["log_scales"] -= 1.5
    _, gradients, statistics = assert_agree(gaussians, camera=view(pose=np.eye(4)), geometry="distortion")
    behind = gaussians["means"][:, 2] <= 0.2
    assert not statistics.visible[behind].any()
    assert not any(gradient[behind].any() for gradient in gradients.values())


def test_zero_quaternion_is_no_rotation():
    gaussians = scene(12, 10)
    turned_none = dict(gaussians, quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(12, 1))
    zero = dict(gaussians, quaternions=torch.zeros(12, 4))
    a, gradients, _ = render(cpu, zero, torch.float32, camera=view())
    b, _, _ = render(cpu, turned_none, torch.float32, camera=view())
    assert torch.equal(a.color, b.color)
    assert not gradients["quaternions"].any()


def test_no_gaussians():
    outputs, gradients, _ = render(
        cpu, scene(0, 0), torch.float32, camera=view(), geometry="distortion", background=torch.tensor([0.1, 0.2, 0.3])
    )
    assert torch.equal(outputs.color, torch.tensor([0.1, 0.2, 0.3]).expand(20, 24, 3))
    for output in outputs[1:]:
        assert not output.any()
    assert gradients["means"].shape == (0, 3)


def test_empty_pixels_are_zero():
    gaussians = {name: value[:1] for name, value in scene(1, 11).items()}
    gaussians["means"] = torch.tensor([[0.0, 0.0, 4.0]])
    gaussians["log_scales"] = torch.tensor([[-3.0, -2.5, -3.5]])
    gaussians["opacity_logits"] = torch.tensor([3.0])
    outputs, _, _ = assert_agree(gaussians, camera=view(pose=np.eye(4)), geometry="distortion")
    empty = outputs.alpha == 0
    assert empty.any() and not empty.all()
    assert not any(output[empty].any() for output in outputs)


def test_gradients_of_some_outputs_only():
    gaussians = scene(40, 12)
    for chosen in range(6):
        pairs = []
        for kernel, dtype in ((cpu, torch.float32), (reference, torch.float64)):
            inputs = {name: value.detach().to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
            kernel(**inputs, camera=view(), geometry="distortion")[chosen].square().sum().backward()
            pairs.append([value.grad for value in inputs.values()])
        for name, a, b in zip(NAMES, *pairs, strict=True):
            assert_close(a, torch.zeros_like(a) if b is None else b, FLOAT32_GRADIENT, f"output {chosen}, {name}")


def test_reference_against_finite_differences():
    gaussians = {name: value.double() for name, value in scene(8, 13, size=-1.0).items()}
    gaussians["opacity_logits"] = gaussians["opacity_logits"].clamp(max=3)
    generator = torch.Generator().manual_seed(1)
    camera = view(9, 7)

    def loss(shift=0.0, direction=None):
        moved = {name: value + shift * direction[name] if direction else value for name, value in gaussians.items()}
        outputs = reference(**moved, camera=camera, geometry="distortion", filter_3d=torch.full((8,), 0.05).double())
        weights = torch.Generator().manual_seed(2)
        return sum((o * torch.randn(o.shape, generator=weights, dtype=torch.float64)).sum() for o in outputs)

    for name in NAMES:
        gaussians = {key: value.detach().requires_grad_() for key, value in gaussians.items()}
        (gradient,) = torch.autograd.grad(loss(), gaussians[name])
        gaussians = {key: value.detach() for key, value in gaussians.items()}
        direction = {key: torch.zeros_like(value) for key, value in gaussians.items()}
        direction[name] = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        step = 1e-6
        measured = (loss(step, direction) - loss(-step, direction)) / (2 * step)
        predicted = (gradient * direction[name]).sum()
        assert abs(measured - predicted) <= FINITE_DIFFERENCE * max(1.0, abs(predicted)), name


def test_order_of_gaussians_does_not_matter():
    gaussians = scene(200, 14)
    order = torch.randperm(200, generator=torch.Generator().manual_seed(0))
    shuffled = {name: value[order].contiguous() for name, value in gaussians.items()}
    a, da, _ = render(cpu, gaussians, torch.float32, camera=view(), geometry="distortion")
    b, db, _ = render(cpu, shuffled, torch.float32, camera=view(), geometry="distortion")
    assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))
    assert all(torch.equal(da[name][order], db[name]) for name in NAMES)


def test_same_bits_every_time_and_on_any_number_of_threads():
    gaussians, camera = scene(500, 15), view(70, 50)
    threads = numba.get_num_threads()
    try:
        runs = []
        for count in (threads, threads, 1):
            numba.set_num_threads(count)
            runs.append(render(cpu, gaussians, torch.float32, camera=camera, geometry="distortion"))
    finally:
        numba.set_num_threads(threads)
    for outputs, gradients, statistics in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0][0], outputs, strict=True))
        assert all(torch.equal(runs[0][1][name], gradients[name]) for name in NAMES)
        assert torch.equal(runs[0][2].abs_grad_2d, statistics.abs_grad_2d)


def test_a_crop_is_the_crop_of_the_image():
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


@pytest.mark.parametrize("tilt,turn", [(0.0, 0.0), (0.7, 0.4), (-0.9, 2.0)])
def test_a_disc_has_its_planes_depth_and_normal(tilt, turn):
    """One flat, wide Gaussian: depth is where the ray meets its plane, the normal is the plane's."""
    normal = np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), -math.cos(tilt)])
    centre = np.array([0.2, -0.1, 5.0])
    half = tilt / 2
    quaternion = [math.cos(half), math.sin(half) * math.sin(turn), -math.sin(half) * math.cos(turn), 0.0]
    inputs = {
        "means": torch.tensor(centre[None], dtype=torch.float32),
        "log_scales": torch.tensor([[0.0, 0.0, -9.0]]),
        "quaternions": torch.tensor([quaternion], dtype=torch.float32),
        "opacity_logits": torch.tensor([5.0]),
        "sh_dc": torch.zeros(1, 3),
        "sh_rest": torch.zeros(1, 0, 3),
    }
    camera = Camera(64, 48, 400.0, 410.0, 15.0, 33.0, np.eye(4))
    raster = cpu(**inputs, camera=camera, geometry="distortion")
    ((x, y),), _ = camera.project(centre[None])
    for row in range(int(y) - 4, int(y) + 5):
        for column in range(int(x) - 4, int(x) + 5):
            ray = np.array([(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, 1.0])
            expected = normal @ centre / (normal @ ray)
            assert abs(float(raster.depth[row, column]) / expected - 1) < PLANE_DEPTH
            assert abs(float(raster.median_depth[row, column]) / expected - 1) < PLANE_DEPTH
            found = raster.normal[row, column].double().numpy() / float(raster.alpha[row, column])
            assert np.abs(found - normal).max() < FLOAT32_GRADIENT


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(-25, 3), st.floats(0, 6), st.floats(0.0, 3.0), st.sampled_from([0.0, 0.1]))
def test_extreme_gaussians_stay_finite(seed, size, spread, depth, filter_2d):
    gaussians = scene(30, seed)
    gaussians["log_scales"] = (gaussians["log_scales"] + 2) * spread + size
    gaussians["means"][:, 2] = gaussians["means"][:, 2] - 4 + depth
    gaussians["quaternions"] *= 1e-15 if seed % 2 else 1e15
    outputs, gradients, statistics = render(
        cpu, gaussians, torch.float32, camera=view(), geometry="distortion", filter_2d=filter_2d
    )
    for output in outputs:
        assert torch.isfinite(output).all()
    assert (outputs.alpha >= 0).all() and (outputs.alpha <= 1).all()
    assert (outputs.depth >= 0).all()
    for name, gradient in gradients.items():
        if name != "quaternions":
            assert torch.isfinite(gradient).all(), name
    assert torch.isfinite(statistics.abs_grad_2d).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_parameter_is_named(name, value):
    gaussians = scene(20, 17)
    gaussians["means"][:, 2] = 4
    gaussians["opacity_logits"][:] = 1
    gaussians[name].view(20, -1)[13, 0] = value
    if name == "opacity_logits" and value == math.inf:
        assert torch.isfinite(cpu(**gaussians, camera=view()).color).all()
        return
    with pytest.raises(FloatingPointError, match=rf"{name}\[13\]"):
        cpu(**gaussians, camera=view())


@pytest.mark.parametrize(
    "name,value,found",
    [
        ("means", torch.zeros(4, 2), r"means: expected shape \(4, 3\), found \(4, 2\)"),
        ("quaternions", torch.zeros(4, 4).double(), "quaternions: expected contiguous torch.float32"),
        ("sh_dc", torch.zeros(3, 4).T, "sh_dc: .* found not contiguous"),
        ("sh_rest", torch.zeros(4, 5, 3), "sh_rest: expected shape"),
        ("filter_3d", torch.zeros(3), r"filter_3d: expected shape \(4,\)"),
        ("background", torch.zeros(3, requires_grad=True), "background: expected a tensor without gradient"),
        ("geometry", "depths", "geometry: expected one of none, depth, full, distortion, found 'depths'"),
        ("sh_degree", 4, "sh_degree: expected 0, 1, 2 or 3, found 4"),
        ("filter_2d", -0.1, "filter_2d: expected at least 0"),
        ("near", 0.0, "near: expected more than 0"),
    ],
)
def test_wrong_arguments_say_so(name, value, found):
    arguments = {**scene(4, 18), "camera": view(), name: value}
    with pytest.raises(ValueError, match=found):
        cpu(**arguments)


def test_rotations_of_special_quaternions() -> None:
    """Half a turn about z, of any length; a third of a turn takes x to y, y to z; none for a quaternion of zeros."""
    quaternions = torch.tensor([[0, 0, 0, 2], [0.5, 0.5, 0.5, 0.5], [0, 0, 0, 0], [-3, 0, 0, 0]], dtype=torch.float64)
    found = rotation_matrices(quaternions)
    assert torch.equal(found[0], torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)))
    assert torch.equal(found[1], torch.eye(3, dtype=torch.float64)[[2, 0, 1]])
    assert torch.equal(found[2], torch.eye(3, dtype=torch.float64)) and torch.equal(found[3], found[2])
