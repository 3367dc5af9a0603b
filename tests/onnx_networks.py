"""Tiny ONNX networks for tests, exported the way users export theirs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn


class Function(nn.Module):
    """A network that computes a function of its input (1, 3, H, W)."""

    def __init__(self, function: Callable[[Tensor], Tensor | tuple[Tensor, ...]]):
        super().__init__()
        self.function = function

    def forward(self, image: Tensor) -> Tensor | tuple[Tensor, ...]:
        return self.function(image)


def mean_of_channels(image: Tensor) -> Tensor:
    """(1, 1, H, W): what a grey image was fed as."""
    return image.mean(dim=1, keepdim=True)


def write_network(
    path: Path,
    function: Callable[[Tensor], Tensor | tuple[Tensor, ...]] = mean_of_channels,
    *,
    side: str | None = "",
    fixed: tuple[int, int] | None = None,
    outputs: tuple[str, ...] = ("map",),
) -> Path:
    """Export the function to `path` with the side file `side` (None: without one).

    fixed: (width, height) that the input is tied to; else any size goes in. An empty side file says: disparity,
    64 pixels wide, nothing subtracted.
    """
    width, height = fixed or (32, 32)
    axes = None if fixed else {"image": {2: "h", 3: "w"}} | {name: {2: "h", 3: "w"} for name in outputs}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            Function(function),
            (torch.zeros(1, 3, height, width),),
            str(path),
            input_names=["image"],
            output_names=list(outputs),
            dynamic_axes=axes,
            opset_version=17,
            dynamo=False,
        )
    if side is not None:
        text = side or 'longest = 64\noutput = "disparity"\n'
        path.with_name(f"{path.name}.toml").write_text(text)
    return path
