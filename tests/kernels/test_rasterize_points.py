"""A scene from points of a lens: against the reference, a shifted principal point, and single rasterisations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from backends import compiled
from random_gaussians import assert_close, scene, view
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.runtime.ops import load
from dofbench.runtime.raster import ViewStatistics

by_definition = load("rasterize", "reference", function="rasterize_from_points")
POINTS = np.array([[0.0, 0.0], [0.6, 0.1], [-0.3, -0.7]])


def kernel(backend: str):
    return load("rasterize", backend, function="rasterize_from_points")


def lens_scene(n: int, seed: int, widest: float = 6.0) -> dict[str, torch.Tensor]:
    """A random scene with a radius and a blur for each Gaussian, of which the first is seen for certain."""
    generator = torch.Generator().manual_seed(seed)
    radius = (torch.rand(n, generator=generator) * 2 - 1) * widest
    gaussians = {**scene(n, seed), "radius": radius, "blur": 0.1 * radius.square()}
    gaussians["means"][0], gaussians["opacity_logits"][0] = torch.tensor([0.0, 0.0, 4.0]), 2.0
    return gaussians


def rendered(from_points, gaussians, dtype, **options):
    """Images, and gradients of a random linear loss over them by all inputs."""
    inputs = {name: value.to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
    options = {name: one.to(dtype) if isinstance(one, torch.Tensor) else one for name, one in options.items()}
    images = from_points(**inputs, **options)
    weights = torch.randn(images.shape, generator=torch.Generator().manual_seed(3)).to(dtype)
    (images * weights).sum().backward()
    return images.detach(), {name: value.grad for name, value in inputs.items()}


@compiled
@pytest.mark.parametrize(("seed", "count", "fades"), [(0, 3, True), (1, 1, True), (2, 2, False)])
def test_values_and_gradients_agree_with_the_reference(backend: str, seed: int, count: int, fades: bool) -> None:
    gaussians = lens_scene(25, seed)
    options = {
        "camera": view(), "points": POINTS[3 - count :], "sh_degree": 2, "filter_2d_fades": fades,
        "background": torch.tensor([0.2, 0.5, 0.1]), "filter_3d": torch.full((25,), 0.03),
    }  # fmt: skip
    images, gradients = rendered(kernel(backend), gaussians, torch.float32, **options)
    expected, by = rendered(by_definition, gaussians, torch.float64, **options)
    assert_close(images, expected, FLOAT32_VALUE, "images")
    for name, gradient in gradients.items():
        assert_close(gradient, by[name], FLOAT32_GRADIENT, f"gradient of {name}")


@compiled
@pytest.mark.parametrize("radius", [3.7, -5.2])
def test_a_radius_that_all_share_is_a_shifted_principal_point(backend: str, radius: float) -> None:
    """An independent account of where a lens point sees a Gaussian, and of the statistics."""
    gaussians, camera = lens_scene(30, 11), view(16, 16)
    # Far beside the image the footprint's shape is bounded by the principal point's distance from the border.
    (u, v), z = (array.T for array in camera.project(gaussians["means"].double().numpy()))
    near = torch.from_numpy((z > 0.3) & (u > -2) & (u < camera.width + 2) & (v > -2) & (v < camera.height + 2))
    gaussians = {name: value[near] for name, value in gaussians.items()}
    gaussians["radius"] = torch.full((int(near.sum()),), radius)
    together = ViewStatistics(want_abs=True)
    shared = {name: value.clone().requires_grad_() for name, value in gaussians.items()}
    images = kernel(backend)(**shared, camera=camera, points=POINTS, statistics=together)
    images.square().sum().backward()
    alone = {name: value.clone().requires_grad_() for name, value in gaussians.items() if name != "radius"}
    singles = []
    for image, (x, y) in zip(images, POINTS, strict=True):
        moved = replace(camera, cx=camera.cx + radius * x, cy=camera.cy + radius * y)
        singles.append(ViewStatistics(want_abs=True))
        seen = load("rasterize", backend)(**alone, camera=moved, geometry="none", statistics=singles[-1]).color
        assert_close(image, seen, FLOAT32_VALUE, "image")
        seen.square().sum().backward()
    for name, value in alone.items():
        assert_close(shared[name].grad, value.grad, FLOAT32_GRADIENT, f"gradient of {name}")
    along = sum((one.grad_2d * torch.from_numpy(p).float()).sum(1) for one, p in zip(singles, POINTS, strict=True))
    assert_close(shared["radius"].grad, along, FLOAT32_GRADIENT, "gradient of radius")
    assert_close(together.grad_2d, sum(one.grad_2d for one in singles), FLOAT32_GRADIENT, "grad_2d")
    assert_close(together.abs_grad_2d, sum(one.abs_grad_2d for one in singles), FLOAT32_GRADIENT, "abs_grad_2d")
    assert not bool((together.visible & ~torch.stack([one.visible for one in singles]).any(0)).any())
    assert bool(together.visible[together.grad_2d.abs().sum(1) > 0].all())


@compiled
def test_the_centre_alone_is_an_ordinary_rasterisation(backend: str) -> None:
    gaussians = lens_scene(30, 5)
    (seen,) = kernel(backend)(**gaussians, camera=view(), points=POINTS[:1])
    del gaussians["radius"]
    expected = load("rasterize", backend)(**gaussians, camera=view(), geometry="none").color
    assert seen.any() and torch.equal(seen, expected)


@compiled
def test_the_same_bits_twice(backend: str) -> None:
    options = {"camera": view(), "points": POINTS}
    one, other = (rendered(kernel(backend), lens_scene(12, 6), torch.float32, **options) for _ in range(2))
    assert torch.equal(one[0], other[0]) and all(torch.equal(value, other[1][name]) for name, value in one[1].items())


@compiled
def test_a_gaussian_beside_the_image_is_seen_from_the_rim(backend: str) -> None:
    camera = replace(view(), world_to_camera=np.eye(4))
    beside = (camera.width + 5.0 - camera.cx) / camera.fx * 4.0
    gaussians = scene(1, 0, rest=0) | {
        "means": torch.tensor([[beside, 0.0, 4.0]]),
        "log_scales": torch.full((1, 3), -2.5),
        "opacity_logits": torch.full((1,), 5.0),
        "sh_dc": torch.ones(1, 3),
    }
    statistics, points = ViewStatistics(), np.array([[-1.0, 0.0], [1.0, 0.0]])
    options = {"points": points, "radius": torch.full((1,), 10.0), "statistics": statistics}
    images = kernel(backend)(**gaussians, camera=camera, **options)
    assert float(images[0].max()) > 0.1 and float(images[1].max()) == 0
    assert statistics.visible.all() and statistics.radii.all()


@compiled
def test_no_gaussians_leave_the_background(backend: str) -> None:
    options = {"camera": view(), "points": POINTS, "background": torch.tensor([0.1, 0.2, 0.3])}
    none = {name: value[:0] for name, value in lens_scene(1, 0).items()}
    images, gradients = rendered(kernel(backend), none, torch.float32, **options)
    assert torch.equal(images, options["background"].expand(3, 20, 24, 3)) and gradients["radius"].shape == (0,)


@compiled
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"points": np.zeros((0, 2))}, "points: expected shape"),
        ({"points": np.zeros((2, 3))}, "points: expected shape"),
        ({"radius": torch.zeros(9)}, "radius: expected"),
        ({"radius": torch.zeros(10, dtype=torch.float64)}, "radius: expected"),
        ({"blur": torch.full((10,), -1.0)}, "blur: expected at least 0"),
    ],
)
def test_a_wrong_argument_is_named(backend: str, changes: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        kernel(backend)(**{**lens_scene(10, 2), "camera": view(), "points": POINTS, **changes})


@compiled
def test_a_radius_that_is_not_finite_is_named(backend: str) -> None:
    gaussians = lens_scene(10, 2)
    gaussians["means"][4] = torch.tensor([0.0, 0.0, 4.0])
    gaussians["radius"][4] = torch.nan
    gaussians["blur"][4] = 0.0
    with pytest.raises(FloatingPointError, match=r"radius\[4\]"):
        kernel(backend)(**gaussians, camera=view(), points=POINTS)
