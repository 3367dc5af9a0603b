"""DP-NeRF's adaptive weight proposal (Lee et al., CVPR 2023, section 4.2): how a pixel's rays are weighed, by what the
field stores along them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.training.common.networks import encoded_places, rectified, redraw

_WIDTH, _HIDDEN = 64, 4  # of the network on each sample
_RAY, _RAY_LAYERS, _FREQUENCIES = 32, 2, 2  # of the network on each ray, and of its direction
_SLOPE = 0.2  # of the leaky rectifier below zero


@dataclass(frozen=True)
class WeightProposalOptions:
    """Whether weights are proposed for every pixel, and how much that counts."""

    weight_proposal: bool = True
    """Whether the weights of a pixel's rays are proposed by what lies along them, beside those of the whole photograph.
    Unit: none. Source: DP-NeRF."""
    proposal_samples: int = 8
    """Samples along a ray for the proposal. Unit: none. Source: own (docs/notes/tuning.md); 128 in DP-NeRF."""
    proposal_first: float = 0.1
    """Share of the mixture by proposed weights in the loss when the kernel begins. Unit: none. Source: DP-NeRF."""
    proposal_last: float = 0.9
    """The same at the end; it grows exponentially. Unit: none. Source: DP-NeRF."""
    proposal_every: float = 0.05
    """Interval at which it grows. Unit: share of the training. Source: DP-NeRF, 10 000 steps of 200 000."""

    def __post_init__(self) -> None:
        if self.proposal_samples < 1:
            raise InputError("option proposal_samples", str(self.proposal_samples), "at least 1")
        for name in ("proposal_first", "proposal_last"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"option {name}", str(getattr(self, name)), "between 0 and 1")
        if not self.proposal_every > 0:
            raise InputError("option proposal_every", str(self.proposal_every), "above 0")

    def share(self, progress: float, begins: float) -> float:
        """That share at `progress`, for a kernel that begins at `begins`."""
        known = max(begins, math.floor(progress / self.proposal_every) * self.proposal_every)
        grown = (known - begins) / (1 - begins)
        return float(self.proposal_first * (self.proposal_last / self.proposal_first) ** grown)


class WeightProposal(nn.Module):
    """Proposes weights of `rays` rays. channels: numbers at each sample. about: numbers about the photograph."""

    def __init__(self, rays: int, channels: int, about: int, generator: torch.Generator):
        super().__init__()
        widths = [channels, *[_WIDTH] * _HIDDEN]
        self.of_sample = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        widths = [_WIDTH + about + 3 * (1 + 2 * _FREQUENCIES), *[_RAY] * _RAY_LAYERS]
        self.of_ray = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.reduce = nn.Linear(_WIDTH, _RAY)
        self.attention = _CurveAttention(_RAY)
        self.head = nn.Linear(_RAY, rays)
        redraw(self, generator)

    def forward(self, samples: Tensor, about: Tensor, directions: Tensor) -> Tensor:
        """(P, N) weights that add up to 1 for a pixel. samples: (P, N, L, C), what lies along the N rays of each of P
        pixels. about: (P, A). directions: (P, 3), unit length, of the pixels' own rays."""
        local = samples
        for layer in self.of_sample:
            local = rectified(layer, local)
        ray = torch.cat([about, encoded_places(directions, _FREQUENCIES)], 1)[:, None].expand(-1, local.shape[1], -1)
        seen = torch.cat([integrated(local), ray], 2)
        for layer in self.of_ray:
            seen = rectified(layer, seen)
        seen = self.attention(seen, self.reduce(local))
        weights = torch.sigmoid(self.head(seen.mean(1)))
        return weights / weights.sum(1, keepdim=True)


def integrated(values: Tensor) -> Tensor:
    """(..., C): values (..., L, C), not negative, rendered along the L equal parts of a ray of length 1, where each
    channel is a colour and its own density."""
    count = values.shape[-2]
    # Sums over the samples are products with small matrices, which take a fraction of the time of `cumsum`.
    row = torch.arange(count, device=values.device)
    up_to = (row[:, None] >= row).to(values.dtype) / -count
    left = torch.exp(up_to @ values)  # of the light, behind each sample
    # A sample takes what was left before it less what is left behind it. Gathered by what is left, the sum is the first
    # value, and behind each sample what is left of the step to the next value.
    steps = torch.cat([values[..., 1:, :], torch.zeros_like(values[..., :1, :])], -2) - values
    return values[..., 0, :] + (left * steps).sum(-2)


class _CurveAttention(nn.Module):
    """What rays tell each other: attention of each ray to summaries of all rays and of all samples (CurveNet's
    aggregation; Xiang et al., ICCV 2021, section 3.3)."""

    def __init__(self, width: int):
        super().__init__()
        half = width // 2
        self.importance = nn.Linear(width, 1, bias=False)
        self.query, self.ray_key, self.sample_key = (nn.Linear(width, half, bias=False) for _ in range(3))
        self.ray_value, self.sample_value = (nn.Linear(half, half, bias=False) for _ in range(2))
        self.join = nn.Linear(2 * half, width, bias=False)
        self.norm = nn.BatchNorm1d(width)

    def forward(self, rays: Tensor, samples: Tensor) -> Tensor:
        """(P, N, W): rays (P, N, W), by samples (P, N, L, W)."""
        importance = self.importance(samples)[..., 0]
        # Weighted sums as products of matrices: (1, L) by (L, W) for each ray, (1, N) by (N, W) for each sample.
        of_rays = self.ray_key((importance.softmax(2)[:, :, None] @ samples)[:, :, 0])
        by_sample = importance.transpose(1, 2).softmax(2)[:, :, None]
        of_samples = self.sample_key((by_sample @ samples.transpose(1, 2))[:, :, 0])
        query = self.query(rays)
        told = [
            (query @ key.transpose(1, 2)).softmax(2) @ value(key)
            for key, value in ((of_rays, self.ray_value), (of_samples, self.sample_value))
        ]
        joined = self.join(torch.cat(told, 2))
        found = rays + self.norm(joined.transpose(1, 2)).transpose(1, 2)
        return torch.nn.functional.leaky_relu(found, _SLOPE)
