"""Early stopping by held-out pixels of the training views, and the model with the best score on them.

Tiles of every training view (option held_back) are kept from the colour losses for the whole training, and scored in
its course; test views are never used. The score is SSIM, since overfitting shows in it first: PSNR may still rise while
noise replaces detail (docs/notes/training.md). Once the score has not improved for the patience, training returns to
the best state and carries out its cooldown from there, so that a training that stops early also ends with small steps.
The learning rates are those of the end of a training that was planned to be that short.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dofbench.core.contracts import Decision

_SCORINGS = 8  # in the length of the patience
_VISITS = 20  # of each view between two scorings: a rendering takes a third of a step or less


@dataclass(frozen=True)
class StoppingOptions:
    """When a training ends before its time."""

    patience: float = 0.0
    """How long the SSIM on held-out pixels may go without a gain before training stops early; the model with the best
    one is kept. 0 trains to the end and keeps the last model. Unit: share of the training. Source: own."""


@dataclass(frozen=True, eq=False)
class Best:
    """The best state so far. ssim: on held-out pixels. state: a snapshot."""

    step: int
    ssim: float
    state: Any


class EarlyStopping:
    """Watches the SSIM on held-out pixels. views: number of training views. begins: share of the training from which it
    is watched. cooldown_from: share at which the cooldown begins; from then on training isn't stopped any more."""

    def __init__(self, options: StoppingOptions, cooldown_from: float, views: int, begins: float = 0.0):
        self._patience, self._cooldown_from, self._least = options.patience, cooldown_from, _VISITS * views
        self._begins = begins
        self._step, self._progress, self._best_at = 0, 0.0, math.inf
        self.active = options.patience > 0
        self.best: Best | None = None
        self.stopped: int | None = None
        """The step after which the score had not improved for the patience; None before that."""

    def due(self, step: int, progress: float) -> bool:
        """Whether to score after `step`, at `progress`, 0 to 1."""
        if not self.active or self.stopped is not None or not self._begins <= progress < self._cooldown_from:
            return False
        return progress >= self._progress + self._patience / _SCORINGS and step >= self._step + self._least

    def scored(self, step: int, progress: float, ssim: float, snapshot: Callable[[], Any]) -> bool:
        """Note a score, and take a snapshot if it is the best so far; returns whether it is. A score that isn't finite
        never is."""
        self._step, self._progress = step, progress
        best = math.isfinite(ssim) and (self.best is None or ssim > self.best.ssim)
        if best:
            self.best, self._best_at = Best(step, ssim, snapshot()), progress
        elif progress >= self._best_at + self._patience:
            self.stopped = step
        return best

    def cooldown_steps(self) -> int:
        """Steps of the cooldown from the best state, as of a training planned to begin it there."""
        return 0 if self.best is None else round(self.best.step * (1 / self._cooldown_from - 1))

    def decision(self, kept: Best, end: int) -> Decision:
        """Which state was kept, and why training ended after `end` steps."""
        why = f"ended after step {end}"
        if self.best is not None and self.stopped is not None:
            why = f"stopped early: no gain from step {self.best.step} to step {self.stopped}; {why}"
        reason = f"kept the model of step {kept.step}, held-out SSIM {kept.ssim:.3f}; {why}"
        return Decision("early_stopping", True, reason, {"kept": float(kept.step), "held-out SSIM": kept.ssim})
