"""Adam over the Gaussians, with the surgery that density control needs."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.gaussians.model import Gaussians
from dofbench.learning.options import TrainerOptions

_MOMENTS = ("exp_avg", "exp_avg_sq")


class GaussianOptimiser:
    """torch's fused Adam, one group a parameter, eps 1e-15 as in 3DGS."""

    def __init__(self, gaussians: Gaussians, options: TrainerOptions, extent: float):
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

    def step(self, progress: float) -> None:
        """One Adam step; the means' rate falls log-linearly with `progress` (0 ... 1), all of them in the cooldown."""
        options = self._options
        cooldown = options.cooldown(progress)
        for group in self._adam.param_groups:
            decay = (options.means_lr_final / options.means_lr) ** progress if group["name"] == "means" else 1.0
            group["lr"] = self._rates[group["name"]] * decay * cooldown
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def discard_gradients(self) -> None:
        """Drop the gradients of a step that must not be taken."""
        self._adam.zero_grad(set_to_none=True)

    def state(self) -> dict[str, dict[str, Tensor]]:
        """Each parameter with its moments, copied, to come back to."""
        return {
            group["name"]: {
                "value": group["params"][0].detach().clone(),
                **{key: value.clone() for key, value in self._adam.state.get(group["params"][0], {}).items()},
            }
            for group in self._adam.param_groups
        }

    def restore(self, state: dict[str, dict[str, Tensor]]) -> None:
        """Go on from a `state`, whatever has been added or removed since."""
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

    def replace(self, name: str, value: Tensor) -> None:
        """Overwrite one parameter and forget its moments (opacity reset)."""
        parameter = self.gaussians.parameters[name]
        with torch.no_grad():
            parameter.copy_(value)
        state = self._adam.state.get(parameter)
        if state:
            for moment in _MOMENTS:
                state[moment].zero_()
