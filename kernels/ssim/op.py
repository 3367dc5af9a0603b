"""Structural similarity, and the colour loss of 3DGS with it.

Sources: Wang et al., "Image quality assessment: from error visibility to structural similarity", IEEE TIP 2004,
equation 13, with K1 = 0.01, K2 = 0.03 and a Gaussian window; Kerbl et al., SIGGRAPH 2023, equation 7.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import torch
from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["ssim", "l1_ssim"]  # noqa: RUF022  # the op's name first

K1, K2 = 0.01, 0.03
Border = Literal["same", "valid"]


def ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
    backend: str = AUTO,
) -> Tensor:
    """Mean structural similarity over pixels and channels; a scalar, differentiable with respect to `prediction`.

    prediction, target: (H, W, C). window: side of the Gaussian window, pixels, odd. sigma: its standard deviation,
    pixels. data_range: difference between white and black. border: "same" pads with zeros and averages over all pixels,
    as the 3DGS loss does; "valid" averages over the pixels whose window lies inside, which equals scikit-image with
    `gaussian_weights=True, use_sample_covariance=False`. Covariances are those of the population (no n / (n - 1)).
    Raises ValueError for invalid arguments; a NaN in an image makes the result NaN.
    """
    _check(prediction, target, border, window, sigma, data_range)
    found = implementation("ssim", backend, prediction=prediction, target=target)
    return found.ssim(prediction, target, border, window, sigma, data_range)


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
    backend: str = AUTO,
) -> Tensor:
    """(1 - ssim_weight) mean(weight |p - t|) + ssim_weight (1 - SSIM) + edge_weight times the error of the edges.

    weight: (H, W), no gradient; it acts on L1 and, if `weigh_all` is true, also on the dissimilarity of each pixel, so
    that the second term is mean(weight (1 - S)), and on the edges, where a pair has the mean of its two pixels'
    weights. Means are taken over all pixels (with the border "valid", those that `ssim` counts) and channels, whatever
    the sum of the weights. Error of the edges: mean |(p - t)(x + 1) - (p - t)(x)| over all neighbours in a row, and the
    same in columns, added up. Other arguments as in `ssim`.
    """
    _check(prediction, target, border, window, sigma, data_range)
    if weight is not None:
        if weight.shape != prediction.shape[:2]:
            expected = f"expected {tuple(prediction.shape[:2])}, found {tuple(weight.shape)}"
            raise ValueError(f"l1_ssim weight: {expected}")
        if weight.requires_grad:
            raise ValueError("l1_ssim: expected a weight without gradient, found one that requires it")
    found = implementation("ssim", backend, prediction=prediction, target=target, weight=weight)
    options = ssim_weight, weight, weigh_all, edge_weight
    return found.l1_ssim(prediction, target, *options, border, window, sigma, data_range)


@cache
def gaussian_window(window: int, sigma: float) -> tuple[float, ...]:
    """The `window` weights of a sampled Gaussian, scaled to sum to one; cached, since every training step needs
    them."""
    radius = window // 2
    samples = torch.exp(-0.5 * (torch.arange(-radius, radius + 1, dtype=torch.float64) / sigma) ** 2)
    return tuple((samples / samples.sum()).tolist())


def _check(prediction: Tensor, target: Tensor, border: str, window: int, sigma: float, data_range: float) -> None:
    if prediction.ndim != 3 or prediction.shape != target.shape:
        raise ValueError(
            f"ssim: expected two images of one shape (H, W, C), found {tuple(prediction.shape)}, {tuple(target.shape)}"
        )
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
