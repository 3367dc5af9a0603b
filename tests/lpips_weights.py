"""Files of weights for LPIPS, with random values in the shapes of torchvision's networks and the lpips package."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

# torchvision's `features`: output channels, or "M" for a pooling; every convolution has a ReLU.
VGG16 = (64, 64, "M", 128, 128, "M", 256, 256, 256, "M", 512, 512, 512, "M", 512, 512, 512)
VGG19 = (64, 64, "M", 128, 128, "M", *(256,) * 4, "M", *(512,) * 4, "M", *(512,) * 4)
CHANNELS = {"alex": (64, 192, 384, 256, 256), "vgg": (64, 128, 256, 512, 512)}  # of the compared features
TAPS = {"alex": (1, 4, 7, 9, 11), "vgg": (3, 8, 15, 22, 29)}  # their indices in `features`


def alexnet() -> nn.Sequential:
    """torchvision's `alexnet().features`, in which every second layer is a ReLU or a pooling."""
    return nn.Sequential(
        *(nn.Conv2d(3, 64, kernel_size=11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(64, 192, kernel_size=5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(192, 384, kernel_size=3, padding=1), nn.ReLU()),
        *(nn.Conv2d(384, 256, kernel_size=3, padding=1), nn.ReLU()),
        *(nn.Conv2d(256, 256, kernel_size=3, padding=1), nn.ReLU()),
    )


def vgg(plan: tuple[int | str, ...] = VGG16) -> nn.Sequential:
    """torchvision's `vgg16().features`, or another VGG's."""
    layers: list[nn.Module] = []
    channels = 3
    for one in plan:
        if isinstance(one, int):
            layers += [nn.Conv2d(channels, one, kernel_size=3, padding=1), nn.ReLU()]
            channels = one
        else:
            layers.append(nn.MaxPool2d(2, 2))
    return nn.Sequential(*layers)


def backbone(name: str, seed: int = 0) -> nn.Sequential:
    """The features of "alex" or "vgg", with random weights."""
    torch.manual_seed(seed)
    return alexnet() if name == "alex" else vgg()


def state(features: nn.Sequential) -> dict[str, Tensor]:
    """As torchvision names it; the classifier is of no use to LPIPS."""
    named = {f"features.{key}": value for key, value in features.state_dict().items()}
    return {**named, "classifier.6.weight": torch.zeros(10, 4)}


def linear(name: str, seed: int = 0) -> dict[str, Tensor]:
    """The linear layers, as the lpips package names them."""
    random = torch.Generator().manual_seed(seed)
    return {
        f"lin{number}.model.1.weight": torch.rand(1, channels, 1, 1, generator=random)
        for number, channels in enumerate(CHANNELS[name])
    }


def write_weights(folder: Path, name: str = "alex", seed: int = 0) -> list[Path]:
    """The backbone's file and that of the linear layers."""
    files = [folder / f"{name}net-{seed}.pth", folder / f"{name}-{seed}.pth"]
    for file, content in zip(files, (state(backbone(name, seed)), linear(name, seed)), strict=True):
        torch.save(content, file)
    return files
