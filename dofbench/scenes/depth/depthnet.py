"""The shipped network: one RGB image to relative disparity, about a million parameters, fully convolutional.

`datasets/depthnet/train.py` trains it and exports it as ONNX, which folds each batch normalisation into the convolution
before it; `load_folded` reads that file back into a network that can be trained further.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from dofbench.core.errors import InputError

CHANNELS = (24, 40, 72, 96, 112)  # at 1/2, 1/4, 1/8, 1/16 and 1/32 of the input's size
MEAN, STD = (0.45, 0.45, 0.45), (0.25, 0.25, 0.25)
MULTIPLE = 32


def _normalised(inputs: int, outputs: int, stride: int, folded: bool) -> list[nn.Module]:
    """A convolution and its batch normalisation; the convolution alone, with a bias, where that is folded into it."""
    convolution = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=folded)
    return [convolution] if folded else [convolution, nn.BatchNorm2d(outputs)]


class _Conv(nn.Sequential):
    def __init__(self, inputs: int, outputs: int, stride: int = 1, *, folded: bool):
        super().__init__(*_normalised(inputs, outputs, stride, folded), nn.ReLU(inplace=True))


class _Residual(nn.Module):
    def __init__(self, channels: int, folded: bool):
        super().__init__()
        self.first = _Conv(channels, channels, folded=folded)
        self.second = nn.Sequential(*_normalised(channels, channels, 1, folded))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.second(self.first(x)))


class DepthNet(nn.Module):
    """An encoder of strided convolutions with residual blocks, a decoder with skips, output at the input's size.

    folded: without batch normalisation, as it is exported.
    """

    def __init__(self, *, folded: bool = False) -> None:
        super().__init__()
        c = CHANNELS
        self.stem = _Conv(3, c[0], 2, folded=folded)
        pairs = itertools.pairwise(c)
        stages = [nn.Sequential(_Conv(a, b, 2, folded=folded), _Residual(b, folded)) for a, b in pairs]
        self.down = nn.ModuleList(stages)
        # Global context: the mean over all positions is added to each position.
        self.context = nn.Sequential(nn.Conv2d(c[4], c[4], 1), nn.ReLU(inplace=True))
        widths = ((c[4] + c[3], 80), (80 + c[2], 56), (56 + c[1], 32))
        self.up = nn.ModuleList([_Conv(inputs, outputs, folded=folded) for inputs, outputs in widths])
        self.narrow = nn.Conv2d(32, 16, 1)
        self.last = _Conv(16 + c[0], 16, folded=folded)
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


def load_folded(file: Path) -> DepthNet:
    """The network of an ONNX file that `train.py` exported, batch normalisation folded, float32, trainable.

    Raises InputError for a file whose convolutions are not this network's.
    """
    network = DepthNet(folded=True)
    own = [module for module in network.modules() if isinstance(module, nn.Conv2d)]
    given = _convolutions(file)
    shapes = [tuple(weight.shape) for weight, _ in given]
    if shapes != [tuple(module.weight.shape) for module in own]:
        raise InputError(file, f"{len(given)} convolutions of other shapes", f"the {len(own)} of the shipped network")
    with torch.no_grad():
        for module, (weight, bias) in zip(own, given, strict=True):
            module.weight.copy_(torch.from_numpy(weight))
            assert module.bias is not None
            module.bias.copy_(torch.from_numpy(bias))
    return network


def _convolutions(file: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """(weight, bias), float32, of each convolution in running order; casts of half precision are followed."""
    import onnx  # slow to import, and only needed here

    try:
        graph = onnx.load(file, load_external_data=False).graph
        tensors = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer}
        found = []
        for node in graph.node:
            if node.op_type == "Cast" and node.input[0] in tensors:
                tensors[node.output[0]] = tensors[node.input[0]]
            elif node.op_type == "Conv":
                weight = tensors[node.input[1]].astype(np.float32)
                bias = tensors[node.input[2]] if len(node.input) > 2 else np.zeros(len(weight))
                found.append((weight, bias.astype(np.float32)))
    except OSError as error:
        raise InputError(file, error.strerror or "no readable file", "an ONNX network") from None
    except Exception as error:  # protobuf's errors have no common base class, and a damaged file raises others too
        raise InputError(file, f"no readable weights ({error})", "an ONNX network of convolutions") from None
    return found


def _double(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
