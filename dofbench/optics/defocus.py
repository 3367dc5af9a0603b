"""Defocus of an all-in-focus, encoded image by signed CoC radii, in linear light (DoF-Gaussian, Algorithm 1).

Synthesis, methods and evaluation share it, so a lens has one meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np
import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.images import check_floats
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens, in_scene_units
from dofbench.optics.layered import layered_blur
from dofbench.optics.tone import TOE, decode, fast_decode, fast_encode
from dofbench.runtime.ops import load


@overload
def defocus(
    image: np.ndarray,
    depth: np.ndarray,
    lens: PhysicalLens | Lens,
    blur: Blur = ...,
    *,
    disparity_range: DisparityRange | None = ...,
    backend: str = ...,
) -> np.ndarray: ...


@overload
def defocus(
    image: Tensor,
    depth: Tensor | np.ndarray,
    lens: PhysicalLens | Lens,
    blur: Blur = ...,
    *,
    disparity_range: DisparityRange | None = ...,
    backend: str = ...,
) -> Tensor: ...


def defocus(
    image: np.ndarray | Tensor,
    depth: np.ndarray | Tensor,
    lens: PhysicalLens | Lens,
    blur: Blur = Blur(),
    *,
    disparity_range: DisparityRange | None = None,
    backend: str = "auto",
) -> np.ndarray | Tensor:
    """Blur an all-in-focus image by a lens, given its depth (DoF-Gaussian, Algorithm 1 and Eq. 6).

    For arrays, and for tensors with gradients with respect to image, depth, aperture and focus, on the image's device:

        lens = dofbench.PhysicalLens(aperture, focus_disparity, width)  # numbers, or parameters to train
        blurred = dofbench.defocus(rgb, depth, lens)  # what gsplat or nerfstudio rendered

    image: (..., H, W, C) floats, encoded, usually in [0, 1]; with `Blur(gamma=1)` linear light. depth: (..., H, W) or
    (..., H, W, 1) z-depth, scene units; zero, negative and non-finite values are infinitely far. lens: a `PhysicalLens`
    in pixels and scene units, or a `Lens` in units of `disparity_range`; its aperture and focus may be tensors, one
    for all images or one for each, of shape (...). blur: gamma, aperture shape and renderer; the renderer "layered",
    which handles occlusion, takes 3 channels and has no gradient. backend: as in `kernels/scatter/op.py`.

    Returns (..., H, W, C), encoded, not clipped: float32 for an array, the image's type for a tensor. If no pixel of an
    image is blurred, it is returned unchanged, and no gradient reaches depth and lens. Raises InputError for images
    that aren't floats, shapes that don't fit, a `Lens` without a disparity range, and a renderer that can't be used.
    """
    check_floats("image", image)
    if image.ndim < 3 or 0 in image.shape:
        raise InputError("image", f"shape {tuple(image.shape)}", "(..., height, width, channels) without a zero")
    if depth.ndim == image.ndim and depth.shape[-1] == 1:
        depth = depth[..., 0]
    if tuple(depth.shape) != tuple(image.shape[:-1]):
        raise InputError("depth", f"shape {tuple(depth.shape)}", f"{tuple(image.shape[:-1])}, one value a pixel")
    if blur.renderer == "layered" and image.shape[-1] != 3:
        raise InputError("renderer", f"layered for {image.shape[-1]} channels", "3 channels, or scatter")
    physical = in_scene_units(lens, disparity_range, image.shape[-2])
    if isinstance(image, Tensor):
        return _defocus_tensor(image, torch.as_tensor(depth), physical, blur, backend)
    values = depth.detach().cpu().numpy() if isinstance(depth, Tensor) else depth
    return _defocus_array(image, values, physical, blur, backend)


def _defocus_array(image: np.ndarray, depth: np.ndarray, lens: PhysicalLens, blur: Blur, backend: str) -> np.ndarray:
    """`defocus` of arrays, image by image."""
    batch = image.shape[:-3]
    numbers = {name: _for_each(name, value.detach(), batch).cpu().numpy() for name, value in _numbers(lens)}
    found = np.empty(image.shape, np.float32)
    for index in np.ndindex(batch):
        own: dict[str, Any] = {name: float(values[index]) for name, values in numbers.items()}
        found[index] = defocus_numpy(image[index], depth[index], replace(lens, **own), blur, backend=backend)[0]
    return found


def _defocus_tensor(image: Tensor, depth: Tensor, lens: PhysicalLens, blur: Blur, backend: str) -> Tensor:
    """`defocus` of tensors, image by image. Kernels take float32 and float64; other types are computed in float32."""
    kind = image.dtype if image.dtype in (torch.float32, torch.float64) else torch.float32
    batch, size = image.shape[:-3], image.shape[-3:]
    depth = depth.to(image.device, kind)
    known = torch.isfinite(depth) & (depth > 0)
    # Replaced twice: a gradient through 1 / 0 would be NaN though its value isn't used.
    disparity = torch.where(known, 1.0 / torch.where(known, depth, 1.0), 0.0)
    numbers: dict[str, Any] = {
        name: _for_each(name, value.to(image.device, kind), batch)[..., None, None] for name, value in _numbers(lens)
    }
    radius = replace(lens, **numbers).signed_radius(disparity, size[1])
    images, radii = image.to(kind).reshape(-1, *size), radius.reshape(-1, *size[:2])
    found = [_defocus_one(one, radius, blur, backend) for one, radius in zip(images, radii, strict=True)]
    return torch.stack(found).reshape(image.shape).to(image.dtype)


def _defocus_one(image: Tensor, radius: Tensor, blur: Blur, backend: str) -> Tensor:
    trains = torch.is_grad_enabled() and (image.requires_grad or radius.requires_grad)
    if blur.renderer != "layered" or trains:
        return scatter_defocus(image, radius, blur, backend=backend)
    encoded, _ = defocus_by_radius(image.detach().cpu().numpy(), radius.detach().cpu().numpy(), blur, backend=backend)
    return torch.from_numpy(encoded).to(image)


def _numbers(lens: PhysicalLens) -> list[tuple[str, Tensor]]:
    """Aperture and focus, by the names of their fields, in float64 where they are numbers."""
    return [
        (name, value if isinstance(value, Tensor) else torch.as_tensor(value, dtype=torch.float64))
        for name, value in (("aperture", lens.aperture), ("focus_disparity", lens.focus_disparity))
    ]


def _for_each(name: str, value: Tensor, batch: Sequence[int]) -> Tensor:
    """A number of the lens for each image of the batch. Raises InputError unless there is one, or one for each."""
    if value.numel() == 1:
        return value.reshape(()).expand(tuple(batch))
    if tuple(value.shape) != tuple(batch):
        raise InputError(f"lens {name}", f"shape {tuple(value.shape)}", f"one number, or shape {tuple(batch)}")
    return value


def scatter_defocus(
    image: Tensor, signed_radius: Tensor, blur: Blur = Blur(), *, backend: str = "auto", form: str = "auto"
) -> Tensor:
    """Blur an encoded image (H, W, C) by `signed_radius`, (H, W) pixels; encoded, (H, W, C), not clipped.

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
    """Defocus an all-in-focus image by `lens`: (encoded, linear), both (H, W, 3) float32. `defocus` gives the first.

    image: (H, W, 3) floats, encoded. depth: (H, W), scene units; zero, negative and non-finite values are infinitely
    far. options: of `defocus_by_radius`. Raises InputError for an image that isn't floats.
    """
    check_floats("image", image)
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
    lens = in_scene_units(lens, None, width)  # names what is missing where a Lens was given
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
    if blur.renderer not in ("scatter", "layered"):
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
