"""What training may find out for itself (`trials.py`)."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.core.errors import InputError

QUESTIONS = ("lens", "share", "model")


@dataclass(frozen=True)
class TrialOptions:
    """Which questions are tried out while training, when, and for how long."""

    lens_trials: str = ""
    """What is decided by what explains held-back pixels: any of lens (is there one), share (do photographs share it)
    and model (the forward model), with commas. Unit: none. Source: own."""
    lens_trials_at: float = 0.35
    """When it is tried. Unit: share of the training. Source: own."""
    lens_trials_steps: float = 0.03
    """How long each way is tried. Unit: share of the training. Source: own."""

    def __post_init__(self) -> None:
        unknown = sorted(set(filter(None, self.lens_trials.split(","))) - set(QUESTIONS))
        if unknown:
            raise InputError("option lens_trials", repr(unknown[0]), "some of lens, share, model, with commas")
