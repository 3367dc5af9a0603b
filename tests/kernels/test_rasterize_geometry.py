"""Distortion, depth and normals of surfaces whose geometry is known exactly."""

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import frontal
from random_gaussians import assert_agree, assert_close, cpu, facing, reference, render, scene, view
from tolerances import DISTORTION, FLOAT32_GRADIENT, FLOAT32_VALUE, PLANE_DEPTH, PUBLISHED_NORMAL, SURFACE_OF_DISCS

from dofbench.core.cameras import Camera
from dofbench.training.gaussians.surface_losses import normal_consistency

FRONTAL = Camera(24, 20, 30.0, 30.0, 12.5, 10.5, np.eye(4))


def test_distortion_is_the_sum_over_pairs():
    depths = [2.0, 2.5, 4.0, 9.0]
    raster = cpu(**facing(depths), camera=FRONTAL, geometry="distortion")
    # The weights from renderings of fewer of them: what each adds to alpha.
    covered = [cpu(**facing(depths[:k]), camera=FRONTAL).alpha[10, 12] if k else torch.zeros(()) for k in range(5)]
    weights = [float(b - a) for a, b in itertools.pairwise(covered)]
    expected = sum(weights[i] * weights[j] * (1 / depths[i] - 1 / depths[j]) ** 2 for i in range(4) for j in range(i))
    assert abs(float(raster.distortion[10, 12]) / expected - 1) < FLOAT32_GRADIENT


def test_one_surface_alone_has_no_distortion():
    raster = cpu(**facing([3.0]), camera=FRONTAL, geometry="distortion")
    assert (raster.alpha > 0).all() and not raster.distortion.any()


@given(st.integers(0, 2**31), st.floats(1e-3, 0.1), st.booleans())
def test_a_thin_layer_keeps_the_digits_of_its_distortion(seed, thickness, floater):
    """Against float64, pixel by pixel. Moments about zero would be off by more than the value itself."""
    generator = torch.Generator().manual_seed(seed)
    depths = 5 + thickness * torch.randn(12, generator=generator)
    gaussians = facing(depths.tolist())
    if floater:
        front = facing([0.5], opacity=0.006)
        gaussians = {name: torch.cat([value, front[name]]) for name, value in gaussians.items()}
    found = cpu(**gaussians, camera=FRONTAL, geometry="distortion").distortion.double()
    exact = {name: value.double() for name, value in gaussians.items()}
    expected = reference(**exact, camera=FRONTAL, geometry="distortion").distortion
    assert ((found / expected - 1).abs() < DISTORTION).all()


def test_the_gradient_of_distortion_alone():
    # On its own, since it is small beside the other outputs.
    gaussians = scene(60, 21)
    pairs = []
    for kernel, dtype in ((cpu, torch.float32), (reference, torch.float64)):
        inputs = {name: value.detach().to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
        weight = torch.rand(50, 60, generator=torch.Generator().manual_seed(0)).to(dtype)
        (kernel(**inputs, camera=view(60, 50), geometry="distortion").distortion * weight).sum().backward()
        pairs.append([value.grad for value in inputs.values()])
    for name, found, expected in zip(gaussians, *pairs, strict=True):
        expected = torch.zeros_like(found) if expected is None else expected
        assert_close(found, expected, FLOAT32_GRADIENT, f"gradient of {name}")


def test_without_distortion_the_other_outputs_are_the_same_bits():
    gaussians = scene(80, 5)
    a, _da, _ = render(cpu, gaussians, torch.float32, camera=view(), geometry="distortion")
    b, _, _ = render(cpu, gaussians, torch.float32, camera=view(), geometry="full")
    assert all(torch.equal(x, y) for x, y in zip(a[:5], b[:5], strict=True)) and b.distortion is None
    assert_agree(gaussians, camera=view(), geometry="full")


def published_normal(mean, covariance) -> np.ndarray:
    """The released code's normal of a Gaussian in camera space, from its plane's slopes in ray space."""
    x, y, z = mean
    u, v, length = x / z, y / z, np.linalg.norm(mean)
    g = u * u + v * v + 1
    h = np.linalg.solve(covariance, [u, v, 1.0])
    m = h / (h @ [u, v, 1.0])
    p = (v * v + 1) * m[0] - u * v * m[1] - u * m[2]
    q = -u * v * m[0] + (u * u + 1) * m[1] - v * m[2]
    a, b = -p * length / g, -q * length / g
    n = np.array([a / z - x / length, b / z - y / length, -(a * x + b * y) / z**2 - z / length])
    return n / np.linalg.norm(n)


def test_normals_are_the_published_ones():
    generator = np.random.default_rng(3)
    camera = frontal(41, 41, 40.0)
    for _ in range(20):
        direction = generator.uniform(-0.3, 0.3, 2)
        mean = np.array([*direction, 1.0]) * generator.uniform(2, 6)
        axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
        axes *= np.linalg.det(axes)
        scales = np.exp(generator.uniform(-1.5, 0.0, 3))
        w = math.sqrt(max(1 + np.trace(axes), 1e-12)) / 2
        turned = axes - axes.T
        quaternion = [w, turned[2, 1] / (4 * w), turned[0, 2] / (4 * w), turned[1, 0] / (4 * w)]
        raster = reference(
            torch.tensor(mean[None]),
            torch.tensor(np.log(scales)[None]),
            torch.tensor([quaternion]),
            torch.tensor([3.0]).double(),
            torch.zeros(1, 3).double(),
            torch.zeros(1, 0, 3).double(),
            camera=camera,
            geometry="full",
        )
        row, column = (int(40 * direction[1] + 20.5), int(40 * direction[0] + 20.5))
        found = raster.normal[row, column].numpy() / float(raster.alpha[row, column])
        expected = published_normal(mean, axes @ np.diag(scales**2) @ axes.T)
        assert np.abs(found - expected).max() < PUBLISHED_NORMAL


def tilted_plane() -> tuple[dict[str, torch.Tensor], np.ndarray, np.ndarray, Camera]:
    """Flat overlapping Gaussians all over a tilted plane; its unit normal, a point on it, and a camera before it."""
    tilt, turn = 0.5, 0.7
    normal = np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), -math.cos(tilt)])
    point = np.array([0.0, 0.0, 5.0])
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    steps = np.arange(-4, 4.01, 0.1)
    places = [point + a * across + b * up for a in steps for b in steps]
    n = len(places)
    half = tilt / 2
    gaussians = {
        "means": torch.tensor(np.array(places), dtype=torch.float32),
        "log_scales": torch.tensor([[math.log(0.1), math.log(0.1), -9.0]]).repeat(n, 1),
        "quaternions": torch.tensor(
            [[math.cos(half), math.sin(half) * math.sin(turn), -math.sin(half) * math.cos(turn), 0.0]]
        ).repeat(n, 1),
        "opacity_logits": torch.full((n,), 1.0),
        "sh_dc": torch.zeros(n, 3),
        "sh_rest": torch.zeros(n, 0, 3),
    }
    return gaussians, normal, point, Camera(64, 48, 80.0, 82.0, 30.0, 26.0, np.eye(4))


def test_a_tilted_plane_of_gaussians_has_its_depth_and_normals_and_agrees_with_itself():
    gaussians, normal, point, camera = tilted_plane()
    raster = cpu(**gaussians, camera=camera, geometry="distortion")
    assert (raster.alpha > 0.99).all()
    x, y = np.meshgrid((np.arange(64) + 0.5 - 30) / 80, (np.arange(48) + 0.5 - 26) / 82)
    expected = torch.from_numpy(normal @ point / (normal[0] * x + normal[1] * y + normal[2]))
    assert ((raster.depth / expected - 1).abs() < SURFACE_OF_DISCS).all()
    assert ((raster.median_depth / expected - 1).abs() < SURFACE_OF_DISCS).all()
    found = raster.normal / raster.alpha[..., None]
    assert_close(found, torch.from_numpy(normal).expand(48, 64, 3), FLOAT32_VALUE, "normal")
    # Normals from depth are the same, so the loss of Eq. 12 is zero; for normals turned by a degree it isn't.
    consistent = float(normal_consistency(raster.normal, raster.alpha, raster.depth, raster.median_depth, camera, 0.6))
    assert consistent < SURFACE_OF_DISCS
    c, s = math.cos(0.1), math.sin(0.1)
    turned = raster.normal @ torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    inconsistent = normal_consistency(turned, raster.alpha, raster.depth, raster.median_depth, camera, 0.6)
    assert float(inconsistent) - consistent > (1 - c) / 3
    # A single surface has almost no distortion, compared with the same plane seen through a second one.
    spread = float((raster.distortion / raster.alpha**2).sqrt().max() * expected.max())
    assert spread < SURFACE_OF_DISCS


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
