"""A scene from points of a lens: against the reference, a shifted principal point, and one rasterisation each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from random_gaussians import assert_close, cpu, scene, view
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.runtime.ops import load
from dofbench.runtime.raster import ViewStatistics

from_points = load("rasterize", "cpu", function="rasterize_from_points")
by_definition = load("rasterize", "reference", function="rasterize_from_points")
POINTS = np.array([[0.0, 0.0], [0.6, 0.1], [-0.3, 0.5], [-0.3, -0.7]])


def lens_scene(n: int, seed: int, widest: float = 6.0) -> dict[str, torch.Tensor]:
    """A random scene with a radius and a blur for each Gaussian, of which the first is seen for certain."""
    generator = torch.Generator().manual_seed(seed)
    radius = (torch.rand(n, generator=generator) * 2 - 1) * widest
    gaussians = {**scene(n, seed), "radius": radius, "blur": 0.1 * radius.square()}
    gaussians["means"][0], gaussians["opacity_logits"][0] = torch.tensor([0.0, 0.0, 4.0]), 2.0
    return gaussians


def rendered(kernel, gaussians, dtype, **options):
    """Images, and gradients of a random linear loss over them by all inputs."""
    inputs = {name: value.to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
    images = kernel(**inputs, **options)
    weights = torch.randn(images.shape, generator=torch.Generator().manual_seed(3)).to(dtype)
    (images * weights).sum().backward()
    return images, {name: value.grad for name, value in inputs.items()}


@given(seed=st.integers(0, 10_000), n=st.integers(10, 40), count=st.integers(1, 4))
def test_values_and_gradients_agree_with_the_reference(seed, n, count):
    gaussians = lens_scene(n, seed)
    options = {"camera": view(), "points": POINTS[:count], "sh_degree": 2}
    background = torch.tensor([0.2, 0.5, 0.1])
    images, gradients = rendered(from_points, gaussians, torch.float32, background=background, **options)
    expected, by = rendered(by_definition, gaussians, torch.float64, background=background.double(), **options)
    assert_close(images, expected, FLOAT32_VALUE, "images")
    for name, gradient in gradients.items():
        assert_close(gradient, by[name], FLOAT32_GRADIENT, f"gradient of {name}")


@pytest.mark.parametrize("radius", [3.7, -5.2])
def test_a_radius_that_all_share_is_a_shifted_principal_point(radius):
    """An independent account of where a lens point sees a Gaussian, of the statistics, and of the image's border."""
    gaussians, camera = lens_scene(300, 11), view(70, 60)
    # Far beside the image the footprint's shape is bounded by the principal point's distance from the border.
    (u, v), z = (array.T for array in camera.project(gaussians["means"].double().numpy()))
    near = torch.from_numpy((z > 0.3) & (u > -4) & (u < camera.width + 4) & (v > -4) & (v < camera.height + 4))
    gaussians = {name: value[near] for name, value in gaussians.items()}
    gaussians["radius"] = torch.full((int(near.sum()),), radius)
    together = ViewStatistics(want_abs=True)
    shared = {name: value.clone().requires_grad_() for name, value in gaussians.items()}
    images = from_points(**shared, camera=camera, points=POINTS, statistics=together)
    images.square().sum().backward()
    alone = {name: value.clone().requires_grad_() for name, value in gaussians.items() if name != "radius"}
    singles = []
    for image, (x, y) in zip(images, POINTS, strict=True):
        moved = replace(camera, cx=camera.cx + radius * x, cy=camera.cy + radius * y)
        singles.append(ViewStatistics(want_abs=True))
        seen = cpu(**alone, camera=moved, geometry="none", statistics=singles[-1]).color
        assert_close(image, seen, FLOAT32_VALUE, "image")
        seen.square().sum().backward()
    for name, value in alone.items():
        assert_close(shared[name].grad, value.grad, FLOAT32_GRADIENT, f"gradient of {name}")
    along = sum((one.grad_2d * torch.from_numpy(p).float()).sum(1) for one, p in zip(singles, POINTS, strict=True))
    assert_close(shared["radius"].grad, along, FLOAT32_GRADIENT, "gradient of radius")
    assert_close(together.grad_2d, sum(one.grad_2d for one in singles), FLOAT32_GRADIENT, "grad_2d")
    assert_close(together.abs_grad_2d, sum(one.abs_grad_2d for one in singles), FLOAT32_GRADIENT, "abs_grad_2d")
    seen_by_any = torch.stack([one.visible for one in singles]).any(0)
    assert not bool((together.visible & ~seen_by_any).any())
    assert bool(together.visible[together.grad_2d.abs().sum(1) > 0].all())


def test_the_centre_alone_is_an_ordinary_rasterisation():
    gaussians = lens_scene(200, 5)
    plain = {name: value for name, value in gaussians.items() if name != "radius"}
    seen = from_points(**gaussians, camera=view(), points=POINTS[:1])
    assert torch.equal(seen[0], cpu(**plain, camera=view(), geometry="none").color)


def test_what_lies_beside_the_image_is_seen_from_the_rim():
    gaussians = scene(1, 0)
    camera = replace(view(), world_to_camera=np.eye(4))
    depth = 4.0
    beside = (camera.width + 5.0 - camera.cx) / camera.fx * depth
    gaussians |= {
        "means": torch.tensor([[beside, 0.0, depth]]),
        "log_scales": torch.full((1, 3), -2.5),
        "opacity_logits": torch.full((1,), 5.0),
        "sh_dc": torch.ones(1, 3),
        "sh_rest": torch.zeros(1, 0, 3),
    }
    images = from_points(
        **gaussians, camera=camera, points=np.array([[-1.0, 0.0], [1.0, 0.0]]), radius=torch.full((1,), 10.0)
    )
    assert float(images[0].max()) > 0.1 and float(images[1].max()) == 0


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
def test_a_wrong_argument_is_named(changes, words):
    with pytest.raises(ValueError, match=words):
        from_points(**{**lens_scene(10, 2), "camera": view(), "points": POINTS, **changes})


def test_a_radius_that_is_not_finite_is_named():
    gaussians = lens_scene(10, 2)
    gaussians["means"][4] = torch.tensor([0.0, 0.0, 4.0])
    gaussians["radius"][4] = torch.nan
    gaussians["blur"][4] = 0.0
    with pytest.raises(FloatingPointError, match=r"radius\[4\]"):
        from_points(**gaussians, camera=view(), points=POINTS)
