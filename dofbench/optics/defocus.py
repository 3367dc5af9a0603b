"""Defocus of an all-in-focus, encoded image by signed CoC radii, in linear light (DoF-Gaussian, Algorithm 1).

Synthesis, methods and evaluation share it, so a lens has one meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens
from dofbench.optics.layered import layered_blur
from dofbench.optics.tone import TOE, decode, fast_decode, fast_encode
from dofbench.runtime.ops import load


def defocus(
    image: Tensor, signed_radius: Tensor, blur: Blur = Blur(), *, backend: str = "auto", form: str = "auto"
) -> Tensor:
    """Blur an encoded image (H, W, 3) by `signed_radius`, (H, W) pixels; encoded, (H, W, 3), not clipped.

    Differentiable with respect to image and radius; InputError for another renderer than "scatter". If every radius is
    zero, the image is returned unchanged and no gradient reaches the radius; the kernel would leak 0.3 % of a pixel
    with R = 0 to its neighbours. backend, form, and other errors: as in `kernels/scatter/op.py`.
    """
    if blur.renderer != "scatter":
        raise InputError("renderer", blur.renderer, "scatter, the only one with a gradient")
    sharp = (signed_radius == 0).all()
    if not signed_radius.is_cpu:  # asking would have the host wait for the device
        return torch.where(sharp, image, _blurred(image, signed_radius, blur, backend, form)[0])
    return image.clone() if bool(sharp) else _blurred(image, signed_radius, blur, backend, form)[0]


def defocus_numpy(
    image: np.ndarray, depth: np.ndarray, lens: PhysicalLens, blur: Blur = Blur(), **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Defocus an all-in-focus image by `lens`: (encoded, linear), both (H, W, 3) float32.

    image: (H, W, 3) float32, encoded. depth: (H, W), scene units; zero, negative and non-finite values are infinitely
    far. options: of `defocus_by_radius`.
    """
    return defocus_by_radius(image, _signed_radius(depth, lens, image.shape[1]), blur, **options)


def defocus_light(
    light: np.ndarray,
    depth: np.ndarray,
    lens: PhysicalLens,
    blur: Blur = Blur(),
    *,
    backend: str = "auto",
    form: str = "auto",
) -> np.ndarray:
    """Defocus an all-in-focus image of linear light, (H, W, 3) float32, of any brightness; linear, not clipped.

    Other arguments and errors as in `defocus_numpy`.
    """
    radius = torch.from_numpy(_signed_radius(depth, lens, light.shape[1]).astype(np.float32))
    with torch.no_grad():
        sharp = torch.from_numpy(np.ascontiguousarray(light, dtype=np.float32))
        if bool((radius == 0).all()):
            return sharp.numpy().copy()
        _require_blur(blur)
        return _spread(sharp, radius, blur, backend, form).numpy()


def _signed_radius(depth: np.ndarray, lens: PhysicalLens, width: int) -> np.ndarray:
    known = np.isfinite(depth) & (depth > 0)
    disparity = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    return lens.signed_radius(disparity, width)


def defocus_by_radius(
    image: np.ndarray, signed_radius: np.ndarray, blur: Blur = Blur(), *, backend: str = "auto", form: str = "auto"
) -> tuple[np.ndarray, np.ndarray]:
    """Defocus by the signed CoC radius, (H, W) pixels, positive nearer than the focus: (encoded, linear), float32.

    image: (H, W, 3) float32, encoded, returned as `encoded` for zero radii. blur: renderer "scatter", the paper's, or
    "layered", which handles occlusion (`layered.py`); InputError for another one, unless the radius is zero. backend,
    form, and other errors: as in `kernels/scatter/op.py`.
    """
    radius = torch.from_numpy(signed_radius.astype(np.float32))
    with torch.no_grad():
        sharp = torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32))
        if bool((radius == 0).all()):
            return sharp.numpy().copy(), decode(sharp, blur.gamma, toe=TOE).numpy()
        _require_blur(blur)
        encoded, linear = _blurred(sharp, radius, blur, backend, form)
        return encoded.numpy(), linear.numpy()


def scatter_of(blur: Blur, backend: str = "auto", form: str = "auto") -> Callable[[Tensor, Tensor], Tensor]:
    """The scatter of this blur: a function of linear light (H, W, C) and signed radii (H, W), pixels.

    backend, form: as in `kernels/scatter/op.py`.
    """
    kernel = load("scatter", backend)
    return partial(kernel, alpha=blur.alpha, shape=blur.shape, energy=blur.energy, form=form)


def _require_blur(blur: Blur) -> None:
    if blur.renderer == "thinlens":
        raise InputError("renderer", blur.renderer, "scatter or layered, which blur an image by its depth")


def _blurred(image: Tensor, radius: Tensor, blur: Blur, backend: str, form: str) -> tuple[Tensor, Tensor]:
    """The blurred image: (encoded, linear)."""
    linear = _spread(fast_decode(image, blur.gamma, backend), radius, blur, backend, form)
    return fast_encode(linear, blur.gamma, backend), linear


def _spread(linear: Tensor, radius: Tensor, blur: Blur, backend: str, form: str) -> Tensor:
    """Linear light blurred by the scatter, in layers or at once."""
    scatter = scatter_of(blur, backend, form)
    if blur.renderer == "layered":
        return layered_blur(linear, radius, scatter, layers=blur.layers)
    return scatter(linear, radius)
