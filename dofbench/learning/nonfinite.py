"""NaNs and infinities in training: detected where they first appear, and reported with step, view and stage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.contracts import NonFinite


class NonFiniteError(FloatingPointError):
    """Raised for a NaN or infinity; `event` says where it first appeared."""

    def __init__(self, event: NonFinite):
        self.event = event
        super().__init__(f"step {event.step}, view {event.view}, {event.stage}: {event.detail}")


@dataclass(frozen=True)
class Place:
    """Where training is: the number of the step, and the name of the view that the step is taken on."""

    step: int
    view: str

    def error(self, stage: str, detail: str) -> NonFiniteError:
        """The exception to raise for a value at this place that isn't finite."""
        return NonFiniteError(NonFinite(self.step, self.view, stage, detail))

    def check(self, tensor: Tensor | None, stage: str) -> None:
        """Raises NonFiniteError unless all values are finite."""
        # A sum is non-finite when any element is, and is much cheaper than testing each element.
        if tensor is not None and not math.isfinite(float(tensor.detach().sum())):
            bad = int((~torch.isfinite(tensor)).sum())
            if bad:
                raise self.error(stage, f"{bad} of {tensor.numel()} values")

    @contextmanager
    def located(self, stage: str) -> Iterator[None]:
        """Turn a kernel's FloatingPointError into a NonFiniteError with step, view and stage. Of nested blocks the
        innermost names the stage."""
        try:
            yield
        except NonFiniteError:
            raise
        except FloatingPointError as error:
            raise self.error(stage, str(error)) from None
