"""`dofbench.defocus`: one lens for arrays and for tensors that train, in other programs."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from tolerances import FINITE_DIFFERENCE, FLOAT32_VALUE

from dofbench import ApertureShape, Blur, DisparityRange, InputError, Lens, PhysicalLens, defocus, defocus_numpy

HEIGHT, WIDTH = 14, 20
LENS = PhysicalLens(8.0, 0.4, WIDTH)


def scene(seed: int = 0, batch: tuple[int, ...] = (), channels: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Encoded images and depths of 1 to 9 scene units; float32."""
    rng = np.random.default_rng(seed)
    image = rng.uniform(0.05, 0.95, (*batch, HEIGHT, WIDTH, channels)).astype(np.float32)
    return image, rng.uniform(1.0, 9.0, (*batch, HEIGHT, WIDTH)).astype(np.float32)


def close(found: Any, expected: Any) -> bool:
    return np.allclose(np.asarray(found), np.asarray(expected), rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)


def test_arrays_and_tensors_are_blurred_alike() -> None:
    image, depth = scene()
    depth[2, 3:7] = 0.0, np.inf, np.nan, -1.0  # unknown
    expected, _ = defocus_numpy(image, depth, LENS)
    assert np.array_equal(defocus(image, depth, LENS), expected) and not close(image, expected)
    found = defocus(torch.from_numpy(image), torch.from_numpy(depth), LENS)
    assert found.dtype == torch.float32 and close(found, expected)
    assert close(defocus(torch.from_numpy(image), depth[..., None], LENS), expected)  # as gsplat renders depth


@pytest.mark.parametrize("tensors", [False, True])
def test_a_batch_is_blurred_image_by_image_each_by_its_own_lens(tensors: bool) -> None:
    image, depth = scene(1, (2, 3), channels=5)
    aperture, focus = np.array([[0.0, 4.0, 8.0], [1.0, 2.0, 3.0]]), 0.4
    images, depths = (torch.from_numpy(image), torch.from_numpy(depth)) if tensors else (image, depth)
    own = torch.from_numpy(aperture) if tensors else aperture
    found = defocus(images, depths, PhysicalLens(own, focus, WIDTH))
    assert found.shape == image.shape
    for index in np.ndindex(2, 3):
        one = PhysicalLens(float(aperture[index]), focus, WIDTH)
        assert close(found[index], defocus(image[index], depth[index], one)), index


def test_a_lens_means_the_same_in_both_units_and_at_another_width() -> None:
    image, depth = scene(2)
    bounds = DisparityRange.of(depth)
    lens = Lens(1.5, 0.3)
    expected = defocus(image, depth, lens.physical(bounds, WIDTH))
    assert np.array_equal(defocus(image, depth, lens, disparity_range=bounds), expected)
    assert close(defocus(image, depth, lens.physical(bounds, 10 * WIDTH)), expected)
    for call in (lambda: defocus(image, depth, lens), lambda: defocus_numpy(image, depth, lens)):
        with pytest.raises(InputError, match="lens: found a Lens without a disparity range"):
            call()


@pytest.mark.slow
@pytest.mark.parametrize("shape", [ApertureShape(), ApertureShape(blades=5, rotation=0.3)])
def test_gradients_by_finite_differences(shape: ApertureShape) -> None:
    """With respect to image, depth, and the aperture and focus of both kinds of lens; two images with two lenses."""
    rng = np.random.default_rng(3)
    image = torch.from_numpy(rng.uniform(0.1, 0.9, (2, 3, 4, 2)))
    depth = torch.from_numpy(rng.uniform(1.0, 4.0, (2, 3, 4)))
    depth[0, 1, 2] = -1.0  # unknown
    blur, bounds = Blur(shape=shape), DisparityRange(0.25, 1.0)
    inputs = [t.requires_grad_() for t in (image, depth, torch.tensor([3.0, 5.0]).double(), torch.tensor(0.4).double())]

    def physical(image: Any, depth: Any, aperture: Any, focus: Any) -> Any:
        return defocus(image, depth, PhysicalLens(aperture, focus, 4), blur)

    def normalised(image: Any, depth: Any, aperture: Any, focus: Any) -> Any:
        return defocus(image, depth, Lens(20 * aperture, focus), blur, disparity_range=bounds)

    for function in (physical, normalised):
        assert torch.autograd.gradcheck(function, inputs, atol=FINITE_DIFFERENCE)


def test_a_lens_is_found_from_a_blurred_image() -> None:
    """What the gradients are for: aperture and focus by descent, from a start away from both."""
    image, depth = (torch.from_numpy(one) for one in scene(4))
    image = torch.nn.functional.avg_pool2d(image.permute(2, 0, 1), 3, 1, 1).permute(1, 2, 0)
    target = defocus(image, depth, LENS)
    aperture, focus = torch.nn.Parameter(torch.tensor([5.0])), torch.nn.Parameter(torch.tensor(0.5))
    optimiser = torch.optim.Adam([{"params": [aperture], "lr": 0.1}, {"params": [focus], "lr": 0.005}])
    for _ in range(150):
        optimiser.zero_grad()
        (defocus(image, depth, PhysicalLens(aperture, focus, WIDTH)) - target).square().mean().backward()
        optimiser.step()
    assert abs(aperture.item() - LENS.aperture) < 0.3 and abs(focus.item() - LENS.focus_disparity) < 0.01


def test_unknown_depth_leaves_no_nan_in_the_gradients() -> None:
    image, depth = (torch.from_numpy(one).requires_grad_() for one in scene(5))
    spoiled = torch.where(torch.rand(depth.shape, generator=torch.Generator().manual_seed(1)) < 0.2, 0.0, depth)
    defocus(image, spoiled, LENS).sum().backward()
    assert torch.isfinite(image.grad).all() and torch.isfinite(depth.grad).all() and depth.grad.abs().max() > 0


def test_half_precision_and_linear_light() -> None:
    image, depth = scene(6)
    expected = defocus(image, depth, LENS)
    half = defocus(torch.from_numpy(image).half(), torch.from_numpy(depth).half(), LENS)
    assert half.dtype == torch.float16 and np.abs(half.float().numpy() - expected).max() < 2.0**-8
    light = defocus(image**2.2, depth, LENS, Blur(gamma=1.0))
    assert np.allclose(light, expected**2.2, atol=1e-4) and np.isclose(light.mean(), (image**2.2).mean(), rtol=0.02)


def test_layers_have_no_gradient_and_are_refused_where_one_is_wanted() -> None:
    image, depth = scene(7)
    blur = Blur(renderer="layered")
    expected = defocus(image, depth, LENS, blur)
    tensor = torch.from_numpy(image).requires_grad_()
    with torch.no_grad():
        assert close(defocus(tensor, torch.from_numpy(depth), LENS, blur), expected)
    with pytest.raises(InputError, match="renderer: found layered, expected scatter"):
        defocus(tensor, depth, LENS, blur)
    with pytest.raises(InputError, match="layered for 5 channels"):
        defocus(*scene(8, channels=5), LENS, blur)


@pytest.mark.parametrize("tensors", [False, True])
def test_what_does_not_fit_is_one_line(tensors: bool) -> None:
    image, depth = scene(9, (2,))
    images = torch.from_numpy(image) if tensors else image
    bytes_ = torch.from_numpy((image * 255).astype(np.uint8)) if tensors else (image * 255).astype(np.uint8)
    for match, call in {
        "image: found uint8": (bytes_, depth, LENS),
        "image: found shape": (images[0, 0], depth[0, 0], LENS),
        "depth: found shape": (images, depth[0], LENS),
        "lens aperture: found shape": (images, depth, dataclasses.replace(LENS, aperture=np.ones(3))),
    }.items():
        with pytest.raises(InputError, match=match) as caught:
            defocus(*call)
        assert "\n" not in str(caught.value)
