"""Parts of the small networks of learned blur: positional encoding, first weights, an optimiser."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor, nn

from dofbench.training.common.monitor import finite_part


class NetworkAdam:
    """Adam over named parameters, at a rate that falls exponentially to `final` times itself."""

    def __init__(self, parameters: Iterable[tuple[str, nn.Parameter]], rate: float, final: float):
        self._parameters, self._rate, self._final = dict(parameters), rate, final
        self._adam = torch.optim.Adam(self._parameters.values(), lr=rate)

    def gradients(self) -> dict[str, Tensor | None]:
        """Gradients of the parameters by name."""
        return {name: parameter.grad for name, parameter in self._parameters.items()}

    def gradient(self) -> Tensor | None:
        """All of them in one row."""
        return in_a_row(self.gradients().values())

    def step(self, progress: float, cooldown: float = 1.0) -> None:
        """Update by the gradients, if any, and drop them. progress: 0 to 1. cooldown: a factor on the rate."""
        for group in self._adam.param_groups:
            group["lr"] = self._rate * self._final**progress * cooldown
        for parameter in self._parameters.values():
            if parameter.grad is not None:
                parameter.grad = finite_part(parameter.grad)
        self._adam.step()
        self._adam.zero_grad()


def in_a_row(gradients: Iterable[Tensor | None]) -> Tensor | None:
    """The gradients that aren't None, in one row; None if there are none."""
    found = [gradient.flatten() for gradient in gradients if gradient is not None]
    return torch.cat(found) if found else None


def encoded_places(values: Tensor, frequencies: int) -> Tensor:
    """(..., D (1 + 2 F)): values (..., D), radians, and sines and cosines of 2^k times them (NeRF, Eq. 4)."""
    scaled = [values * 2.0**k for k in range(frequencies)]
    return torch.cat([values, *(wave(angle) for angle in scaled for wave in (torch.sin, torch.cos))], -1)


def rectified(layer: nn.Module, inputs: Tensor, also: Tensor | None = None) -> Tensor:
    """(..., W): a linear layer and a ReLU in place. also: (W,), added to the bias, the same for all rows."""
    assert isinstance(layer, nn.Linear)  # for the type checker: a ModuleList's items are modules
    parts = [part for part in (layer.bias, also) if part is not None]
    bias = sum(parts[1:], parts[0]) if parts else None
    return torch.relu_(nn.functional.linear(inputs, layer.weight, bias))


@torch.no_grad()
def redraw(network: nn.Module, generator: torch.Generator) -> None:
    """Draw the weights of all linear and convolutional layers as torch does, but from this generator."""
    for layer in network.modules():
        if isinstance(layer, nn.Linear | nn.Conv2d):
            bound = 1 / math.sqrt(layer.weight[0].numel())
            for parameter in layer.parameters():
                parameter.uniform_(-bound, bound, generator=generator)
