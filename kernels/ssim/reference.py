"""The definition of `ssim` and `l1_ssim`: plain torch, any floating type."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import conv2d

from dofbench.runtime.backend import Backend
from dofbench.runtime.device_numbers import beside

from .op import K1, K2, Border, gaussian_window

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def ssim(prediction: Tensor, target: Tensor, border: Border, window: int, sigma: float, data_range: float) -> Tensor:
    return _similarity(prediction, target, border, window, sigma, data_range).mean()


def l1_ssim(
    prediction: Tensor, target: Tensor, ssim_weight: float, weight: Tensor | None, weigh_all: bool, edge_weight: float,
    border: Border, window: int, sigma: float, data_range: float,
) -> Tensor:  # fmt: skip
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
