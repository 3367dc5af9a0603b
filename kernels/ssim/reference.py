"""Structural similarity, the definition: plain torch, any floating type.

Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
structural similarity", IEEE TIP 2004, equation 13 with K1 = 0.01, K2 = 0.03 and a Gaussian window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from dofbench.runtime.backend import Backend
from dofbench.runtime.device_numbers import beside

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
K1, K2 = 0.01, 0.03
Border = Literal["same", "valid"]


@dataclass(frozen=True)
class Settings:
    """The options of a call, as compiled backends take them.

    with_l1: whether the L1 mean is computed too. weigh_all: whether the weight acts on 1 - S and on the edges too.
    with_edges: whether the error of the edges is computed.
    """

    border: Border
    window: int
    sigma: float
    data_range: float
    with_l1: bool
    weigh_all: bool
    with_edges: bool


@cache
def gaussian_window(window: int, sigma: float) -> tuple[float, ...]:
    """The `window` weights of a sampled Gaussian, scaled to sum to one. Kept, since every training step asks for them
    again."""
    radius = window // 2
    samples = torch.exp(-0.5 * (torch.arange(-radius, radius + 1, dtype=torch.float64) / sigma) ** 2)
    return tuple((samples / samples.sum()).tolist())


def check_images(prediction: Tensor, target: Tensor, border: str, window: int, sigma: float, data_range: float) -> None:
    """Raise ValueError, naming what was found and expected, for arguments `ssim` can't take."""
    if prediction.ndim != 3 or prediction.shape != target.shape:
        raise ValueError(
            f"ssim: expected two images of one shape (H, W, C), found {tuple(prediction.shape)}, {tuple(target.shape)}"
        )
    if prediction.dtype != target.dtype or not prediction.dtype.is_floating_point:
        raise ValueError(f"ssim: expected one floating type, found {prediction.dtype}, {target.dtype}")
    if target.requires_grad:
        raise ValueError("ssim: expected a target without gradient, found one that requires it")
    if border not in ("same", "valid"):
        raise ValueError(f"ssim border: expected 'same' or 'valid', found {border!r}")
    if window < 1 or window % 2 == 0:
        raise ValueError(f"ssim window: expected an odd positive number, found {window}")
    for name, number in (("sigma", sigma), ("data range", data_range)):
        if not number > 0:
            raise ValueError(f"ssim {name}: expected a positive number, found {number}")
    height, width, channels = prediction.shape
    smallest = window if border == "valid" else 1
    if min(height, width) < smallest or channels < 1:
        raise ValueError(f"ssim: expected at least {smallest} x {smallest} pixels, found {tuple(prediction.shape)}")


def check_weight(prediction: Tensor, weight: Tensor | None) -> None:
    """Raise ValueError unless `weight` is None or (H, W) like the prediction, of its type, without gradient."""
    if weight is None:
        return
    if weight.shape != prediction.shape[:2] or weight.dtype != prediction.dtype:
        raise ValueError(
            f"l1_ssim weight: expected {tuple(prediction.shape[:2])} of {prediction.dtype}, "
            f"found {tuple(weight.shape)} of {weight.dtype}"
        )
    if weight.requires_grad:
        raise ValueError("l1_ssim: expected a weight without gradient, found one that requires it")


def ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
) -> Tensor:
    """Mean structural similarity over pixels and channels; a scalar, differentiable with respect to `prediction`.

    prediction, target: (H, W, C), one floating type. window: side of the Gaussian window, pixels,
    odd. sigma: its standard deviation, pixels. data_range: difference between white and black.
    border: "same" pads with zeros and averages over all pixels, as the 3DGS loss does; "valid"
    averages over the pixels whose window lies inside, which equals scikit-image with
    `gaussian_weights=True, use_sample_covariance=False`. Covariances are those of the population
    (no n / (n - 1)). Raises ValueError for invalid arguments; a NaN in an image makes the result NaN.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    return _similarity(prediction, target, border, window, sigma, data_range).mean()


def _similarity(
    prediction: Tensor, target: Tensor, border: Border, window: int, sigma: float, data_range: float
) -> Tensor:
    """(C, 1, H, W) similarity by pixel; with the border "valid" only of the pixels whose window lies inside."""
    weights = beside(prediction, gaussian_window(window, sigma))
    padding = window // 2 if border == "same" else 0

    def blur(image: Tensor) -> Tensor:
        planes = image.permute(2, 0, 1).unsqueeze(1)
        planes = conv2d(planes, weights.view(1, 1, 1, -1), padding=(0, padding))
        return conv2d(planes, weights.view(1, 1, -1, 1), padding=(padding, 0))

    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    mean_p, mean_t = blur(prediction), blur(target)
    variances = blur(prediction * prediction + target * target) - mean_p * mean_p - mean_t * mean_t
    covariance = blur(prediction * target) - mean_p * mean_t
    luminance = (2 * mean_p * mean_t + c1) / (mean_p * mean_p + mean_t * mean_t + c1)
    return luminance * (2 * covariance + c2) / (variances + c2)


def l1_ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    ssim_weight: float,
    weight: Tensor | None = None,
    weigh_all: bool = False,
    edge_weight: float = 0.0,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
) -> Tensor:
    """The colour loss of 3DGS, (1 - ssim_weight) mean(weight |p - t|) + ssim_weight (1 - SSIM), and edge_weight times
    the error of the edges; a scalar.

    Kerbl et al. 2023, equation 7. weight: (H, W), no gradient; it acts on L1 and, if `weigh_all` is true, also on the
    dissimilarity of each pixel, so that the second term is mean(weight (1 - S)), and on the edges, where a pair has the
    mean of its two pixels' weights. Means are taken over all pixels (with the border "valid", those that `ssim` counts)
    and channels, whatever the sum of the weights. The error of the edges is that of the differences between
    neighbouring pixels, mean |(p - t)(x + 1) - (p - t)(x)| over all neighbours in a row, and the same in columns, added
    up. Other arguments as in `ssim`.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    check_weight(prediction, weight)
    difference = (prediction - target).abs()
    if weight is not None:
        difference = difference * weight[..., None]
    colour = (1 - ssim_weight) * difference.mean()
    unlike = 1 - _similarity(prediction, target, border, window, sigma, data_range)
    if weigh_all and weight is not None:
        margin = window // 2 if border == "valid" else 0
        height, width = weight.shape
        unlike = unlike * weight[margin : height - margin, margin : width - margin]
    loss = colour + ssim_weight * unlike.mean()
    if not edge_weight:
        return loss
    return loss + edge_weight * _edges(prediction - target, weight if weigh_all else None)


def _edges(error: Tensor, weight: Tensor | None) -> Tensor:
    """mean |error(x + 1) - error(x)| over rows, and over columns, added up; a direction without neighbours counts 0."""
    total = error.new_zeros(())
    for along in (0, 1):
        steps = error.diff(dim=along).abs()
        if weight is not None:
            first, second = (weight.narrow(along, start, steps.shape[along]) for start in (0, 1))
            steps = steps * (0.5 * (first + second))[..., None]
        if steps.numel():
            total = total + steps.mean()
    return total
