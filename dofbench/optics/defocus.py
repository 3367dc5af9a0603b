"""From a sharp encoded image and a signed radius to a photograph with shallow depth of field.

Blur happens in linear light (DoF-Gaussian, Algorithm 1): decode, scatter, encode. Synthesis, methods and evaluation all
use this module, so that a lens means the same in all of them.
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

    Differentiable with respect to image and radius, so `blur` must name the renderer "scatter": InputError for another
    one. If every radius is zero, the image is returned unchanged bit for bit and no gradient reaches the radius; the
    kernel would leak 0.3 % of a pixel with R = 0 to its neighbours. backend, form: of `kernels/scatter/reference.py`,
    whose errors are raised here too.
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
    """A photograph of a sharp image through `lens`: (encoded, linear), both (H, W, 3) float32.

    image: (H, W, 3) float32, encoded. depth: (H, W), scene units; values that are zero, negative or not finite are
    unknown and count as infinitely far. options: those of `defocus_by_radius`.
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
    """A photograph of a sharp image of linear light through `lens`: (H, W, 3) float32, linear, not clipped.

    light: (H, W, 3) float32, linear, of any brightness. The rest is as in `defocus_numpy`, and so are the errors.
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
    """A photograph by the signed CoC radius, (H, W) pixels, positive nearer than the focus: (encoded, linear).

    image: (H, W, 3) float32, encoded; so are both results. With zero radius everywhere `encoded` is the image itself.
    blur: with the renderer "scatter", the paper's, or "layered", which handles occlusion (`layered.py`); InputError for
    another renderer, unless the radius is zero. backend, form: of `kernels/scatter/op.py`, whose errors are
    raised here too.
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
    """The scatter of this blur: from linear light (H, W, C) and signed radii (H, W), pixels, to (H, W, C) blurred.

    backend, form: of `kernels/scatter/op.py`, whose errors are raised by what comes back.
    """
    kernel = load("scatter", backend)
    return partial(kernel, alpha=blur.alpha, shape=blur.shape, energy=blur.energy, form=form)


def _require_blur(blur: Blur) -> None:
    if blur.renderer == "thinlens":
        raise InputError("renderer", blur.renderer, "scatter or layered, which blur an image by its depth")


def _blurred(image: Tensor, radius: Tensor, blur: Blur, backend: str, form: str) -> tuple[Tensor, Tensor]:
    """(encoded, linear) blurred image."""
    linear = _spread(fast_decode(image, blur.gamma, backend), radius, blur, backend, form)
    return fast_encode(linear, blur.gamma, backend), linear


def _spread(linear: Tensor, radius: Tensor, blur: Blur, backend: str, form: str) -> Tensor:
    """Linear light blurred by the scatter, in layers or at once."""
    scatter = scatter_of(blur, backend, form)
    if blur.renderer == "layered":
        return layered_blur(linear, radius, scatter, layers=blur.layers)
    return scatter(linear, radius)
