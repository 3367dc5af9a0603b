"""LPIPS 0.1, a learned perceptual distance. Its weights are the user's: dofbench has none.

Source: Zhang, Isola, Efros, Shechtman, Wang, "The unreasonable effectiveness of deep features as a perceptual metric",
CVPR 2018, section 3 and equation 1. Version 0.1 of the authors' package shifts and scales the colours first.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from dofbench.core.errors import InputError
from dofbench.core.similarity import checked, unmasked

# Mean and standard deviation of ImageNet's colours, for values of -1 ... 1.
_SHIFT = np.array([-0.030, -0.088, -0.188])
_SCALE = np.array([0.458, 0.448, 0.450])
_EPSILON = 1e-10  # added to the norm over channels, as in the authors' package
_LINEAR_FILES = {"lpips_alex": "alex.pth", "lpips_vgg": "vgg.pth"}  # in the package's lpips/weights/v0.1
# Names in a state dict of torchvision, or of the package's `LPIPS`, which has both parts (the linear layers twice).
_CONVOLUTION = re.compile(r"(?:features|net\.slice\d)\.(\d+)\.(weight|bias)")
_LINEAR = re.compile(r"lin(\d)\.model\.\d\.weight")


class _Convolution(NamedTuple):
    """A convolution and its ReLU. channels: of the output. size, stride, padding: px."""

    channels: int
    size: int = 3
    stride: int = 1
    padding: int = 1


@dataclass(frozen=True)
class _Backbone:
    """A classifier's convolutions in blocks, whose outputs are compared. pool: px, maximum with a stride of 2. pooled:
    blocks before which it is. smallest: px, shorter side of an image that all blocks have a pixel of."""

    name: str
    pool: int
    pooled: tuple[int, ...]
    smallest: int
    blocks: tuple[tuple[_Convolution, ...], ...]

    def numbered(self) -> Iterator[list[tuple[int, _Convolution]]]:
        """Each block's convolutions with their indices in torchvision's `features`."""
        index = 0
        for number, block in enumerate(self.blocks):
            index += number in self.pooled
            yield [(index + 2 * place, one) for place, one in enumerate(block)]
            index += 2 * len(block)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each tensor, by name: convolutions, then the linear layers."""
        found: dict[str, tuple[int, ...]] = {}
        channels = 3
        for index, one in chain.from_iterable(self.numbered()):
            found[f"features.{index}.weight"] = (one.channels, channels, one.size, one.size)
            found[f"features.{index}.bias"] = (one.channels,)
            channels = one.channels
        return found | {f"lin{number}": (1, block[-1].channels, 1, 1) for number, block in enumerate(self.blocks)}


_BACKBONES = {
    "lpips_alex": _Backbone(
        "AlexNet",
        pool=3,
        pooled=(1, 2),
        smallest=31,
        blocks=(
            (_Convolution(64, 11, 4, 2),),
            (_Convolution(192, 5, 1, 2),),
            (_Convolution(384),),
            (_Convolution(256),),
            (_Convolution(256),),
        ),
    ),
    "lpips_vgg": _Backbone(
        "VGG16",
        pool=2,
        pooled=(1, 2, 3, 4),
        smallest=16,
        blocks=(
            (_Convolution(64),) * 2,
            (_Convolution(128),) * 2,
            (_Convolution(256),) * 3,
            (_Convolution(512),) * 3,
            (_Convolution(512),) * 3,
        ),
    ),
}


class Lpips:
    """LPIPS by one set of weights; an image metric.

    id: of the metric, "lpips_alex" or "lpips_vgg". name: of the backbone. smallest: px, shorter side of an image.
    sha256: of id and weights, as float32, little-endian, convolutions before linear layers: the same for the same
    weights in other files.
    """

    def __init__(self, metric_id: str, tensors: dict[str, Tensor]):
        self.id, self._backbone = metric_id, _BACKBONES[metric_id]
        self.name, self.smallest = self._backbone.name, self._backbone.smallest
        self._tensors = {key: tensors[key].float().contiguous() for key in self._backbone.shapes()}
        digest = hashlib.sha256(metric_id.encode())
        for tensor in self._tensors.values():
            digest.update(tensor.numpy().astype("<f4").tobytes())
        self.sha256 = digest.hexdigest()

    def __call__(self, prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None, /) -> float:
        """The distance, 0 for equal images; higher is worse.

        prediction, truth: (H, W, 3), encoded, [0, 1]. mask: (H, W) bool, True for the pixels to score; a feature counts
        by its valid share. The networks run in float32, as published. Raises ValueError for shapes that don't fit or
        sides under `smallest`.
        """
        images = np.stack(checked(*unmasked(prediction, truth, mask), smallest=self.smallest))
        pair = torch.from_numpy((2 * images - 1 - _SHIFT) / _SCALE).permute(0, 3, 1, 2).float()
        valid = None if mask is None else torch.from_numpy(mask)[None, None].double()
        total = 0.0
        with torch.inference_mode():
            for number, found in enumerate(self._features(pair)):
                unit = found / (found.square().sum(1, keepdim=True).sqrt() + _EPSILON)
                error = functional.conv2d((unit[:1] - unit[1:]).square(), self._tensors[f"lin{number}"]).double()
                share = torch.ones_like(error)
                if valid is not None:
                    share = functional.adaptive_avg_pool2d(valid, (error.shape[2], error.shape[3]))
                total += float((error * share).sum() / share.sum())
        return total

    def _features(self, images: Tensor) -> Iterator[Tensor]:
        """The output of each block."""
        for number, block in enumerate(self._backbone.numbered()):
            if number in self._backbone.pooled:
                images = functional.max_pool2d(images, self._backbone.pool, stride=2)
            for index, one in block:
                weight, bias = (self._tensors[f"features.{index}.{part}"] for part in ("weight", "bias"))
                images = functional.conv2d(images, weight, bias, one.stride, one.padding).relu()
            yield images


def load_lpips(files: Sequence[Path]) -> Lpips:
    """LPIPS by the weights in these files; the backbone is recognised by its shapes.

    files: state dicts that together hold torchvision's AlexNet or VGG16 and the linear layers of the lpips package; or
    one of the package's `LPIPS`, which has both. Raises InputError.
    """
    if not files:
        raise InputError("--lpips", "nothing", "a backbone of torchvision, and linear layers of the lpips package")
    tensors: dict[str, Tensor] = {}
    sources: dict[str, Path] = {}
    for file in files:
        for key, tensor in _read(file).items():
            if key in tensors:
                raise InputError(file, f"{key}, as in {sources[key]}", "one backbone, and its linear layers")
            tensors[key], sources[key] = tensor, file
    where = ", ".join(map(str, files))
    if not any(key.startswith("features") for key in tensors):
        raise InputError(where, "no backbone", "torchvision's weights of AlexNet or VGG16 too")
    faults = {metric_id: _faults(backbone, tensors) for metric_id, backbone in _BACKBONES.items()}
    metric_id = min(faults, key=lambda one: sum(key.startswith("features") for key in faults[one]))
    name = _BACKBONES[metric_id].name
    if not any(key.startswith("lin") for key in tensors):
        linear = f"lpips/weights/v0.1/{_LINEAR_FILES[metric_id]} of the lpips package too"
        raise InputError(where, f"{name} without the linear layers of LPIPS", linear)
    for key, (found, expected) in faults[metric_id].items():
        raise InputError(sources.get(key, where), found, f"{expected}, as for {name}")
    return Lpips(metric_id, tensors)


def _faults(backbone: _Backbone, tensors: dict[str, Tensor]) -> dict[str, tuple[str, str]]:
    """Key -> (what was found, what was expected)."""
    found: dict[str, tuple[str, str]] = {}
    for key, shape in backbone.shapes().items():
        tensor = tensors.get(key)
        if tensor is None:
            found[key] = f"no {key}", f"one of shape {shape}"
        elif tuple(tensor.shape) != shape:
            found[key] = f"{key} of shape {tuple(tensor.shape)}", f"shape {shape}"
        elif not tensor.isfinite().all() or (key.startswith("lin") and (tensor < 0).any()):
            found[key] = f"{key} with values that are negative or not finite", "weights"
    return found


def _read(file: Path) -> dict[str, Tensor]:
    """The tensors of LPIPS in a state dict, by `_key` of their names."""
    if not file.is_file():
        found = "a folder" if file.is_dir() else "no such file"
        raise InputError(file, found, "a file of weights for --lpips; results are named before --lpips")
    expected = "a state dict of torchvision's AlexNet or VGG16, or of the lpips package"
    try:
        with warnings.catch_warnings(action="ignore"):  # of pickles that torch didn't write
            state = torch.load(file, map_location="cpu", weights_only=True)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # a damaged pickle may raise anything
        damaged = "no state dict of tensors alone, or a damaged one"
        raise InputError(file, f"{damaged} ({type(error).__name__})", expected) from None
    tensors = {}
    for name, value in state.items() if isinstance(state, dict) else ():
        key = _key(str(name))
        if key and isinstance(value, Tensor) and value.is_floating_point():
            tensors[key] = value.detach()
    if not tensors:
        raise InputError(file, "neither convolutions nor linear layers of LPIPS", expected)
    return tensors


def _key(name: str) -> str:
    """The tensor's name as in `_Backbone.shapes`; "" for one that LPIPS has no use for."""
    if match := _CONVOLUTION.fullmatch(name):
        return f"features.{match[1]}.{match[2]}"
    return f"lin{match[1]}" if (match := _LINEAR.fullmatch(name)) else ""
