"""The network: one RGB image to relative disparity, about a million parameters, fully convolutional."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

CHANNELS = (24, 40, 72, 96, 112)  # at 1/2, 1/4, 1/8, 1/16 and 1/32 of the input's size
MEAN, STD = (0.45, 0.45, 0.45), (0.25, 0.25, 0.25)
MULTIPLE = 32


class _Conv(nn.Sequential):
    def __init__(self, inputs: int, outputs: int, stride: int = 1):
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
        )


class _Residual(nn.Module):
    def __init__(self, channels: int):
        super().__init__()
        self.first = _Conv(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.second(self.first(x)))


class DepthNet(nn.Module):
    """An encoder of strided convolutions with residual blocks, a decoder with skips, output at the input's size."""

    def __init__(self) -> None:
        super().__init__()
        c = CHANNELS
        self.stem = _Conv(3, c[0], 2)
        self.down = nn.ModuleList([
            nn.Sequential(_Conv(c[index], c[index + 1], 2), _Residual(c[index + 1])) for index in range(len(c) - 1)
        ])
        # What the whole picture is about, told to every place in it.
        self.context = nn.Sequential(nn.Conv2d(c[4], c[4], 1), nn.ReLU(inplace=True))
        self.up = nn.ModuleList([_Conv(c[4] + c[3], 80), _Conv(80 + c[2], 56), _Conv(56 + c[1], 32)])
        self.narrow = nn.Conv2d(32, 16, 1)
        self.last = _Conv(16 + c[0], 16)
        self.head = nn.Conv2d(16, 1, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:
        """image: (B, 3, H, W), normalised, H and W multiples of 32. Returns (B, 1, H, W), larger is nearer."""
        skips = [self.stem(image)]
        for stage in self.down:
            skips.append(stage(skips[-1]))
        x = skips.pop()
        x = x + self.context(x.mean((2, 3), keepdim=True))
        for layer in self.up:
            x = layer(torch.cat([_double(x), skips.pop()], 1))
        x = self.last(torch.cat([_double(self.narrow(x)), skips.pop()], 1))
        return _double(self.head(x))


def _double(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
