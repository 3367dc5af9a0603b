"""Adam over the Gaussians' parameters, which density control can add rows to and remove rows from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.runtime.ops import load
from dofbench.training.gaussians.model import Gaussians

_EPSILON = 1e-15


@dataclass(frozen=True)
class RateOptions:
    """Adam's step on each of the Gaussians' parameters (3DGS's names)."""

    means_lr: float = 1.6e-4
    """Rate of the means at the start. Unit: scene's extent, a step. Source: 3DGS."""
    means_lr_final: float = 1.6e-6
    """Rate of the means at the end; it falls exponentially in between. Unit: scene's extent, a step. Source: 3DGS."""
    sh_dc_lr: float = 2.5e-3
    """Rate of the constant spherical harmonic of each colour. Unit: coefficient, a step. Source: 3DGS."""
    sh_rest_lr: float = 1.25e-4
    """Rate of the other spherical harmonics. Unit: coefficient, a step. Source: 3DGS."""
    opacity_lr: float = 0.05
    """Rate of the opacities' logits. Unit: logit, a step. Source: 3DGS."""
    scale_lr: float = 5e-3
    """Rate of the scales' logarithms. Unit: logarithm, a step. Source: 3DGS."""
    rotation_lr: float = 1e-3
    """Rate of the quaternions. Unit: component, a step. Source: 3DGS."""


@dataclass
class _Moments:
    """Adam's means of a parameter's gradient and of its square, and how many steps they are from."""

    exp_avg: Tensor
    exp_avg_sq: Tensor
    steps: int = 0

    def copy(self) -> _Moments:
        return _Moments(self.exp_avg.clone(), self.exp_avg_sq.clone(), self.steps)


@dataclass(frozen=True)
class ParameterState:
    """A copy of a parameter and of its moments, None before the first step."""

    value: Tensor
    moments: _Moments | None


class GaussianOptimiser:
    """Adam with a rate for each parameter, eps 1e-15 as in 3DGS."""

    def __init__(self, gaussians: Gaussians, options: RateOptions, extent: float):
        self.gaussians = gaussians
        self._options = options
        self._rates = {
            "means": options.means_lr * extent,
            "log_scales": options.scale_lr,
            "quaternions": options.rotation_lr,
            "opacity_logits": options.opacity_lr,
            "sh_dc": options.sh_dc_lr,
            "sh_rest": options.sh_rest_lr,
        }
        self._moments: dict[str, _Moments] = {}
        self._adam = load("adam")
        self.means_rate = 0.0
        """The rate of the means in the last step, scene units; 0 before the first."""

    def step(self, progress: float, cooldown: float = 1.0, found_inf: Tensor | None = None) -> None:
        """One Adam step, all rates times `cooldown`; the means' rate falls log-linearly with `progress` (0 ... 1).
        found_inf: a scalar on the parameters' device; if it is 1, nothing is changed."""
        options = self._options
        decay = (options.means_lr_final / options.means_lr) ** progress
        self.means_rate = self._rates["means"] * decay * cooldown
        due = {name: one for name, one in self.gaussians.parameters.items() if one.grad is not None}
        for name, parameter in due.items():
            if name not in self._moments:
                self._moments[name] = _Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
            self._moments[name].steps += 1
        if due:
            moments = [self._moments[name] for name in due]
            self._adam(
                list(due.values()),
                [parameter.grad for parameter in due.values()],
                [one.exp_avg for one in moments],
                [one.exp_avg_sq for one in moments],
                steps=[one.steps for one in moments],
                lrs=[self.means_rate if name == "means" else self._rates[name] * cooldown for name in due],
                eps=_EPSILON,
                found_inf=found_inf,
            )
        self.discard_gradients()

    def discard_gradients(self) -> None:
        """Discard the gradients, of a step that was carried out, or isn't because a value isn't finite."""
        for parameter in self.gaussians.parameters.values():
            parameter.grad = None

    def state(self) -> dict[str, ParameterState]:
        """A copy of each parameter and its moments, for `restore`."""
        return {
            name: ParameterState(parameter.detach().clone(), moments and moments.copy())
            for name, parameter, moments in self._each()
        }

    def restore(self, state: dict[str, ParameterState]) -> None:
        """Set parameters and moments to an earlier `state`, even if Gaussians were added or removed since."""
        self._moments = {name: kept.moments.copy() for name, kept in state.items() if kept.moments is not None}
        for name, kept in state.items():
            self.gaussians.parameters[name] = kept.value.clone().requires_grad_()

    def rebuild(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the Gaussians with index in `kept`, then append `added`, whose moments start at zero."""
        for name, old, moments in self._each():
            new = torch.cat([old.detach()[kept], added[name]]).contiguous().requires_grad_()
            if moments is not None:
                moments.exp_avg, moments.exp_avg_sq = (
                    torch.cat([moment[kept], torch.zeros_like(added[name])]).contiguous()
                    for moment in (moments.exp_avg, moments.exp_avg_sq)
                )
            self.gaussians.parameters[name] = new

    def forget(self, rows: Tensor) -> None:
        """Forget the moments of these Gaussians."""
        for moments in self._moments.values():
            moments.exp_avg[rows] = 0
            moments.exp_avg_sq[rows] = 0

    def replace(self, name: str, value: Tensor) -> None:
        """Overwrite one parameter and forget its moments (opacity reset)."""
        with torch.no_grad():
            self.gaussians.parameters[name].copy_(value)
        if moments := self._moments.get(name):
            moments.exp_avg.zero_()
            moments.exp_avg_sq.zero_()

    def _each(self) -> list[tuple[str, Tensor, _Moments | None]]:
        return [(name, value, self._moments.get(name)) for name, value in self.gaussians.parameters.items()]
