"""The length of a training, its coarse beginning, and the cooldown of its learning rates.

Times are shares of the whole training (0 ... 1), so a schedule keeps its shape under any budget; the published
schedules run over 30 000 steps (DoF-Gaussian section 5, Mip-Splatting, 3DGS).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScheduleOptions:
    """Length, the coarse beginning and the cooldown at the end."""

    steps: int = 7000
    """Length of the training if the budget doesn't give it. Unit: steps. Source: own; 30 000 in the
    paper."""
    coarse_until: float = 0.0
    """Train on shrunk photographs up to this share of the training. Unit: share of the training. Source: own."""
    coarse_factor: int = 2
    """How many times smaller the shrunk photographs are along each side. Unit: none. Source: own."""
    cooldown_from: float = 1.0
    """When all learning rates, the lens's too, begin to fall linearly; 1 for never. Unit: share of the training.
    Source: own."""
    cooldown_to: float = 0.1
    """Factor on all learning rates at the end of this fall. Unit: none. Source: own."""

    def cooldown(self, progress: float) -> float:
        """The factor on all learning rates at `progress`, 0 to 1."""
        if progress <= self.cooldown_from:
            return 1.0
        return 1.0 - (1.0 - self.cooldown_to) * (progress - self.cooldown_from) / (1.0 - self.cooldown_from)

    @property
    def sizes(self) -> tuple[int, ...]:
        """The factors by which photographs are shrunk in the course of the training; 1 is their full size."""
        return (1, self.coarse_factor) if self.coarse_until > 0 and self.coarse_factor != 1 else (1,)

    def size(self, progress: float) -> int:
        """The factor by which photographs are shrunk at `progress`, 0 to 1."""
        return self.coarse_factor if progress < self.coarse_until else 1
