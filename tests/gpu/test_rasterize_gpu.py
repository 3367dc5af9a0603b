"""What the rasteriser's Triton kernels do otherwise than the CPU's: chunks of lists, and sums of faint Gaussians."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_gaussians import assert_agree, assert_close, facing, reference, scene
from tolerances import DISTORTION, FLOAT32_GRADIENT

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import load

gpu = load("rasterize", "gpu")
FRONTAL = Camera(24, 20, 30.0, 30.0, 12.5, 10.5, np.eye(4))


def test_opaque_tiles_stop_early() -> None:
    gaussians = facing(torch.linspace(2, 6, 40).flip(0).tolist(), opacity=0.95)
    inputs = {name: value.requires_grad_() for name, value in gaussians.items()}
    # Each of the four tiles has all 40 in its list, of which it should look at few.
    looked_at = gpu(**inputs, camera=FRONTAL, geometry="distortion").color.grad_fn.blended[0]
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
    outputs, _, _ = assert_agree(gaussians, "gpu", camera=FRONTAL, geometry=geometry)
    assert int(outputs.color.grad_fn.blended[0].max()) > 64


def test_equal_depths_are_blended_in_the_order_of_their_numbers() -> None:
    outputs, _, _ = assert_agree(facing([3.0] * 9), "gpu", camera=FRONTAL, geometry="full")
    assert outputs.alpha.min() > 0.9


def test_the_depth_of_faint_gaussians_has_exact_gradients() -> None:
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
