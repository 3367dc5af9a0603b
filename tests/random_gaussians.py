"""Random Gaussians, rendered by both backends of `rasterize` with gradients by all that has one."""

import math

import numpy as np
import torch
from tolerances import FLOAT32_DISTORTION, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import load
from dofbench.runtime.raster import ViewStatistics

cpu, reference = load("rasterize", "cpu"), load("rasterize", "reference")
NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")


def turned(angle: float = 0.1) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    matrix[:3, 3] = 0.1, 0.05, 0.2
    return matrix


def view(width: int = 24, height: int = 20, pose: np.ndarray | None = None) -> Camera:
    """Off-centre principal point, unequal focal lengths, turned."""
    return Camera(
        width, height, 1.1 * width, 1.2 * width, 0.45 * width, 0.6 * height, turned() if pose is None else pose
    )


def scene(n: int, seed: int, rest: int = 15, size: float = -2.0) -> dict[str, torch.Tensor]:
    """Random Gaussians around z = 4, some behind the camera, beside the image, or under the colour clamp."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    return {
        "means": normal(n, 3) * torch.tensor([1.0, 0.8, 1.5]) + torch.tensor([0.0, 0.0, 4.0]),
        "log_scales": normal(n, 3) * 0.7 + size,
        "quaternions": normal(n, 4),
        "opacity_logits": normal(n) * 2,
        "sh_dc": normal(n, 3),
        "sh_rest": normal(n, rest, 3) * 0.3,
    }


def render(kernel, gaussians, dtype, seed=7, **options):
    """Outputs, gradients of a random linear loss over all of them by all of `gaussians`, and statistics."""
    inputs = {name: value.detach().to(dtype, copy=True).requires_grad_() for name, value in gaussians.items()}
    options = {name: value.to(dtype) if isinstance(value, torch.Tensor) else value for name, value in options.items()}
    statistics = ViewStatistics(want_abs=True)
    outputs = kernel(**inputs, statistics=statistics, **options)
    generator = torch.Generator().manual_seed(seed)
    loss = 0
    for output in outputs:
        if output is not None:
            loss = loss + (output * torch.randn(output.shape, generator=generator).to(dtype)).sum()
    loss.backward()
    return outputs, {name: value.grad for name, value in inputs.items()}, statistics


def assert_close(found, expected, tolerance, what):
    expected = expected.detach().double()
    scale = max(float(expected.abs().max()) if expected.numel() else 0.0, 1e-12)
    error = float((found.detach().double() - expected).abs().max()) if expected.numel() else 0.0
    assert error <= tolerance * scale, f"{what}: off by {error / scale:.2e} of the largest magnitude"


def value_tolerance(output: str) -> float:
    return FLOAT32_DISTORTION if output == "distortion" else FLOAT32_VALUE


def blurred(n: int, seed: int, largest: float) -> dict[str, torch.Tensor]:
    """A scene with blur; a third of the Gaussians has none, a seventh next to none."""
    blur = torch.rand(n, generator=torch.Generator().manual_seed(seed)) * largest
    blur[1::7] *= 1e-5
    blur[::3] = 0
    return {**scene(n, seed), "blur": blur}


def facing(depths: list[float], opacity: float = 0.4) -> dict[str, torch.Tensor]:
    """Flat Gaussians across the axis of a camera at the origin, much wider than the image."""
    n = len(depths)
    return {
        "means": torch.tensor([[0.0, 0.0, float(depth)] for depth in depths]),
        "log_scales": torch.tensor([[2.5, 2.5, -8.0]]).repeat(n, 1),
        "quaternions": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        "opacity_logits": torch.full((n,), math.log(opacity / (1 - opacity))),
        "sh_dc": torch.arange(3.0 * n).reshape(n, 3) / n - 1,
        "sh_rest": torch.zeros(n, 0, 3),
    }


def assert_agree(gaussians, backend="cpu", **options):
    """The compiled kernel's outputs, gradients and statistics are the float64 reference's; returns the former."""
    found = render(load("rasterize", backend), gaussians, torch.float32, **options)
    expected = render(reference, gaussians, torch.float64, **options)
    for name, a, b in zip(found[0]._fields, found[0], expected[0], strict=True):
        assert (a is None) == (b is None), name
        if a is not None:
            assert_close(a, b, value_tolerance(name), name)
    for name in gaussians:
        assert_close(found[1][name], expected[1][name], FLOAT32_GRADIENT, f"gradient of {name}")
    assert torch.equal(found[2].visible, expected[2].visible)
    assert_close(found[2].radii, expected[2].radii, FLOAT32_VALUE, "radii")
    assert_close(found[2].grad_2d, expected[2].grad_2d, FLOAT32_GRADIENT, "grad_2d")
    assert_close(found[2].abs_grad_2d, expected[2].abs_grad_2d, FLOAT32_GRADIENT, "abs_grad_2d")
    return found
