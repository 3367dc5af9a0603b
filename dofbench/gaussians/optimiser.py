"""Adam over the Gaussians' parameters, which density control can add rows to and remove rows from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.gaussians.model import Gaussians

_MOMENTS = ("exp_avg", "exp_avg_sq")


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


class GaussianOptimiser:
    """torch's fused Adam, one group per parameter, eps 1e-15 as in 3DGS."""

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
        groups = [{"params": [parameter], "name": name} for name, parameter in gaussians.parameters.items()]
        self._adam = torch.optim.Adam(groups, lr=0.0, eps=1e-15, fused=True)

    def step(self, progress: float, cooldown: float = 1.0, unless: Tensor | None = None) -> None:
        """One Adam step, all rates times `cooldown`; the means' rate falls log-linearly with `progress` (0 ... 1).
        unless: a scalar on the parameters' device; if it is 1, nothing is changed."""
        options = self._options
        for group in self._adam.param_groups:
            decay = (options.means_lr_final / options.means_lr) ** progress if group["name"] == "means" else 1.0
            group["lr"] = self._rates[group["name"]] * decay * cooldown
        self._adam.found_inf = unless  # type: ignore[attr-defined]  # as torch's own gradient scaler hands it over
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def discard_gradients(self) -> None:
        """Discard the gradients of a step that isn't carried out because a value isn't finite."""
        self._adam.zero_grad(set_to_none=True)

    def state(self) -> dict[str, dict[str, Tensor]]:
        """A copy of each parameter and its moments, for `restore`."""
        return {
            group["name"]: {
                "value": group["params"][0].detach().clone(),
                **{key: value.clone() for key, value in self._adam.state.get(group["params"][0], {}).items()},
            }
            for group in self._adam.param_groups
        }

    def restore(self, state: dict[str, dict[str, Tensor]]) -> None:
        """Set parameters and moments to an earlier `state`, even if Gaussians were added or removed since."""
        for group in self._adam.param_groups:
            kept = {key: value.clone() for key, value in state[group["name"]].items()}
            self._adam.state.pop(group["params"][0], None)
            parameter = kept.pop("value").requires_grad_()
            group["params"] = [parameter]
            self.gaussians.parameters[group["name"]] = parameter
            if kept:
                self._adam.state[parameter] = kept

    def rebuild(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the Gaussians with index in `kept`, then append `added`, whose moments start at zero."""
        for group in self._adam.param_groups:
            name, old = group["name"], group["params"][0]
            new = torch.cat([old.detach()[kept], added[name]]).contiguous().requires_grad_()
            state = self._adam.state.pop(old, None)
            if state:
                for moment in _MOMENTS:
                    state[moment] = torch.cat([state[moment][kept], torch.zeros_like(added[name])]).contiguous()
                self._adam.state[new] = state
            group["params"] = [new]
            self.gaussians.parameters[name] = new

    @property
    def means_rate(self) -> float:
        """The rate of the means in the last step, scene units; 0 before the first."""
        return float(next(group["lr"] for group in self._adam.param_groups if group["name"] == "means"))

    def forget(self, rows: Tensor) -> None:
        """Forget the moments of these Gaussians."""
        for parameter in self.gaussians.parameters.values():
            state = self._adam.state.get(parameter)
            if state:
                for moment in _MOMENTS:
                    state[moment][rows] = 0

    def replace(self, name: str, value: Tensor) -> None:
        """Overwrite one parameter and forget its moments (opacity reset)."""
        parameter = self.gaussians.parameters[name]
        with torch.no_grad():
            parameter.copy_(value)
        state = self._adam.state.get(parameter)
        if state:
            for moment in _MOMENTS:
                state[moment].zero_()
