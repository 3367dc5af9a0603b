"""NaNs and infinities in training: found at once, and named by step, view and stage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.contracts import NonFinite


class NonFiniteError(FloatingPointError):
    """A NaN or infinity, with the place where it appeared first."""

    def __init__(self, event: NonFinite):
        self.event = event
        super().__init__(f"step {event.step}, view {event.view}, {event.stage}: {event.detail}")


@dataclass(frozen=True)
class Place:
    """Where training is: which step, and the name of the view that it takes the step on."""

    step: int
    view: str

    def error(self, stage: str, detail: str) -> NonFiniteError:
        """What to raise for something that isn't finite here."""
        return NonFiniteError(NonFinite(self.step, self.view, stage, detail))

    def check(self, tensor: Tensor | None, stage: str) -> None:
        """Raises NonFiniteError unless all values are finite."""
        # A sum is non-finite when any element is, and is much cheaper than looking at each.
        if tensor is not None and not math.isfinite(float(tensor.detach().sum())):
            bad = int((~torch.isfinite(tensor)).sum())
            if bad:
                raise self.error(stage, f"{bad} of {tensor.numel()} values")

    @contextmanager
    def located(self, stage: str) -> Iterator[None]:
        """Turns a kernel's complaint into one that names step, view and stage; the innermost stage is named."""
        try:
            yield
        except NonFiniteError:
            raise
        except FloatingPointError as error:
            raise self.error(stage, str(error)) from None
