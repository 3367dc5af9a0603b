"""NaNs and infinities in training: detected where they first appear, and reported with step, view and stage.

On the CPU a value is looked at where it is made, before anything learns from it. On another device looking would have
the host wait for the device, several times in every step. There a `Watch` gathers the answers on the device, and they
are looked at every so many steps; until then whatever learns has to leave out gradients that aren't finite.
"""

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


class Watch:
    """Answers, still on the device, to whether values were finite, in the order of the checks.

    The tensors of a step are looked at together when the first answer is asked for; one by one, they took a quarter of
    all launches of a step (docs/notes/gpu.md). Until then nothing may change them.
    """

    def __init__(self) -> None:
        self._checks: list[tuple[Place, str, int]] = []
        self._waiting: list[Tensor] = []
        self._largest: list[Tensor] = []
        self._any: Tensor | None = None

    def note(self, place: Place, tensor: Tensor, stage: str) -> None:
        """Have the values looked at, without waiting for the answer."""
        if tensor.numel():
            self._checks.append((place, stage, tensor.numel()))
            self._waiting.append(tensor.detach())

    def _gather(self) -> None:
        if not self._waiting:
            return
        # The largest magnitude is finite if and only if all values are.
        largest = torch.stack(torch._foreach_norm(self._waiting, math.inf))
        self._largest.append(largest)
        self._waiting = []
        found = (largest.max() < math.inf).logical_not().float()  # a comparison with NaN is false
        self._any = found if self._any is None else torch.maximum(self._any, found)

    @property
    def found(self) -> Tensor | None:
        """A scalar on the device, 1 if any value so far wasn't finite, else 0; None before the first check there. It is
        what torch's fused optimisers take as `found_inf`."""
        self._gather()
        return self._any

    def look(self) -> None:
        """Wait for the answers. Raises NonFiniteError for the first check that found a value that isn't finite."""
        self._gather()
        if not self._largest:
            return
        largest = torch.cat(self._largest).tolist()
        checks, self._checks, self._largest = self._checks, [], []
        for (place, stage, size), value in zip(checks, largest, strict=True):
            if not math.isfinite(value):
                self._any = None  # training may go on from an earlier state
                raise place.error(stage, f"some of {size} values" if size > 1 else f"{stage} isn't finite")


@dataclass(frozen=True)
class Place:
    """Where training is: the number of the step, and the name of the view that the step is taken on. watch: gathers the
    checks of tensors that aren't on the CPU; without one they are carried out at once too."""

    step: int
    view: str
    watch: Watch | None = None

    def error(self, stage: str, detail: str) -> NonFiniteError:
        """The exception to raise for a value at this place that isn't finite."""
        return NonFiniteError(NonFinite(self.step, self.view, stage, detail))

    def check(self, tensor: Tensor | None, stage: str) -> None:
        """Raises NonFiniteError unless all values are finite; with a watch, for a tensor that isn't on the CPU,
        `Watch.look` does."""
        if tensor is not None and self.watch is not None and tensor.device.type != "cpu":
            self.watch.note(self, tensor, stage)
            return
        # A sum is non-finite when any element is, and is much cheaper than testing each element.
        if tensor is not None and not math.isfinite(float(tensor.detach().sum())):
            bad = int((~torch.isfinite(tensor)).sum())
            if bad:
                only = f"{stage} is {float(tensor.detach())}" if tensor.numel() == 1 else ""
                raise self.error(stage, only or f"{bad} of {tensor.numel()} values")

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


def finite_part(gradient: Tensor) -> Tensor:
    """The gradient to learn from: on the CPU as it is, since it has been checked; elsewhere nobody has looked at it
    yet, so what isn't finite counts as 0."""
    return gradient if gradient.device.type == "cpu" else torch.nan_to_num(gradient, 0.0, 0.0, 0.0)
