"""From a sharp encoded image and a signed radius to a photograph with shallow depth of field.

Blur happens in linear light (DoF-Gaussian, Algorithm 1): decode, scatter, encode. One function for
synthesis, methods and evaluation, so that all of them mean the same lens.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import ALPHA, GAMMA, LAYERS, ApertureShape, Energy, PhysicalLens, Renderer
from dofbench.kernels import load
from dofbench.optics.layered import layered_blur

# Encoded values below this are decoded and encoded along straight lines through zero. The slope of
# x ** (1 / gamma) is infinite at 0: one black pixel would turn the gradient into infinity or NaN, and a tiny
# one would dominate it. The released code replaces exact zeros by 1e-5 instead, which leaves the
# slope at 1e5 ** (1 - 1 / gamma). Half a step of an 8-bit image is the least that such an image can mean.
TOE = 0.5 / 255.0


def decode(encoded: Tensor, gamma: float = GAMMA) -> Tensor:
    """Encoded to linear light: `encoded ** gamma`, straight through zero below `TOE`; negative values pass."""
    safe = encoded.clamp_min(TOE)
    return torch.where(encoded >= TOE, safe**gamma, encoded * TOE ** (gamma - 1.0))


def encode(linear: Tensor, gamma: float = GAMMA) -> Tensor:
    """The inverse of `decode`: `linear ** (1 / gamma)` above its toe. Nothing is clipped at 1."""
    end = TOE**gamma
    safe = linear.clamp_min(end)
    return torch.where(linear >= end, safe ** (1.0 / gamma), linear * TOE ** (1.0 - gamma))


def signed_radius(disparity: Tensor, aperture_px: Tensor | float, focus_disparity: Tensor | float) -> Tensor:
    """Signed CoC radius `aperture_px * (disparity - focus_disparity)`, (H, W) pixels; positive is nearer than focus.

    disparity and focus_disparity in one unit, normalised or 1 / scene unit, and aperture_px in pixels per
    such unit (docs/conventions.md, "Lens"). Gradient reaches every tensor among them.
    """
    return aperture_px * (disparity - focus_disparity)


def defocus(
    image: Tensor,
    signed_radius: Tensor,
    *,
    gamma: float = GAMMA,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    energy: Energy = "area",
    backend: str = "auto",
    form: str = "auto",
) -> Tensor:
    """Blur an encoded image (H, W, 3) by `signed_radius`, (H, W) pixels; encoded, (H, W, 3), not clipped.

    Differentiable by both. Where every radius is zero the image comes back bit for bit and no
    gradient reaches the radius: R = 0 through the kernel would leak 0.3 % to the neighbours.
    Options as in `kernels/scatter/reference.py`, whose errors are raised here too.
    """
    if bool((signed_radius == 0).all()):
        return image.clone()
    return _blur(image, signed_radius, gamma, alpha, shape, energy, backend, form)[0]


def defocus_numpy(
    image: np.ndarray, depth: np.ndarray, lens: PhysicalLens, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph of a sharp image through `lens`: (encoded, linear), both (H, W, 3) float32.

    image: (H, W, 3) float32, encoded. depth: (H, W), scene units; what is zero, negative or not
    finite is unknown and counts as infinitely far. options: those of `defocus_by_radius`.
    """
    known = np.isfinite(depth) & (depth > 0)
    disparity = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    return defocus_by_radius(image, lens.signed_radius(disparity, image.shape[1]), **options)


def defocus_by_radius(
    image: np.ndarray,
    signed_radius: np.ndarray,
    *,
    gamma: float = GAMMA,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    energy: Energy = "area",
    renderer: Renderer = "scatter",
    layers: int = LAYERS,
    backend: str = "auto",
    form: str = "auto",
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph by the signed CoC radius, (H, W) pixels, positive nearer than the focus: (encoded, linear).

    image: (H, W, 3) float32, encoded; so are both results. With zero radius everywhere `encoded` is the image itself.
    renderer: "scatter", the paper's, or "layered", which knows occlusion (`layered.py`), with so many layers.
    The other options as in `kernels/scatter/reference.py`, whose errors are raised here too.
    """
    radius = torch.from_numpy(signed_radius.astype(np.float32))
    with torch.no_grad():
        sharp = torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32))
        if bool((radius == 0).all()):
            return sharp.numpy().copy(), decode(sharp, gamma).numpy()
        encoded, linear = _blur(
            sharp, radius, gamma, alpha, shape, energy, backend, form, layers if renderer == "layered" else None
        )
        return encoded.numpy(), linear.numpy()


def fast_decode(encoded: Tensor, gamma: float, backend: str = "auto") -> Tensor:
    """`decode` by compiled powers where there are any: float32 on the CPU, where torch's cost more than the scatter."""
    return _power(encoded, gamma, TOE) if _compiled(encoded, backend) else decode(encoded, gamma)


def fast_encode(linear: Tensor, gamma: float, backend: str = "auto") -> Tensor:
    """`encode`, as `fast_decode`."""
    return _power(linear, 1.0 / gamma, TOE**gamma) if _compiled(linear, backend) else encode(linear, gamma)


def _compiled(image: Tensor, backend: str) -> bool:
    return backend != "reference" and image.device.type == "cpu" and image.dtype == torch.float32


def _power(image: Tensor, exponent: float, toe: float) -> Tensor:
    return import_module("dofbench.kernels.scatter.cpu_tone").power_with_toe(image, exponent, toe)


def _blur(image, radius, gamma, alpha, shape, energy, backend, form, layers=None):
    """(encoded, linear) blurred image."""
    scatter = partial(load("scatter", backend, image.device.type), alpha=alpha, shape=shape, energy=energy, form=form)
    linear = fast_decode(image, gamma, backend)
    linear = scatter(linear, radius) if layers is None else layered_blur(linear, radius, scatter, layers=layers)
    return fast_encode(linear, gamma, backend), linear
