"""Options of the trials by which training decides questions about the lens (`trials.py`)."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.core.errors import InputError

QUESTIONS = ("lens", "share", "model")


@dataclass(frozen=True)
class TrialOptions:
    """Which questions are decided by trials while training, when, and how long a trial is."""

    lens_trials: str = ""
    """Questions that trials decide by the scores on held-back pixels, comma-separated: lens (is there one), share (do
    photographs share it), model (which forward model). Unit: none. Source: own."""
    lens_trials_at: float = 0.35
    """When the trials take place. Unit: share of the training. Source: own."""
    lens_trials_steps: float = 0.03
    """Length of each trial; beyond 200 steps only as far as its visits need it. Unit: share of the training. Source:
    own."""

    def __post_init__(self) -> None:
        unknown = sorted(set(filter(None, self.lens_trials.split(","))) - set(QUESTIONS))
        if unknown:
            raise InputError("option lens_trials", repr(unknown[0]), "some of lens, share, model, with commas")
