"""Monitoring of a training: NaNs and infinities where they first appear, the reported loss, the time of each stage.

On the CPU a value is checked where it is made, before anything learns from it. On another device a check would make the
host wait, several times a step. There a `Watch` gathers the answers on the device and is asked every so many steps;
until then optimisers have to skip gradients that aren't finite.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.contracts import NonFinite

_LOOK_EVERY = 50  # steps between two answers from a device


class NonFiniteError(FloatingPointError):
    """Raised for a NaN or infinity; `event` says where it first appeared."""

    def __init__(self, event: NonFinite):
        self.event = event
        super().__init__(f"step {event.step}, view {event.view}, {event.stage}: {event.detail}")


class Watch:
    """Gathers on the device whether values are finite, in the order of the checks.

    The tensors of a step are checked together when the first answer is asked for; one by one, they took a quarter of
    all launches of a step (docs/notes/gpu.md). Until then nothing may change them.
    """

    def __init__(self) -> None:
        self._checks: list[tuple[Place, str, int]] = []
        self._waiting: list[Tensor] = []
        self._largest: list[Tensor] = []
        self._any: Tensor | None = None

    def note(self, place: Place, tensor: Tensor, stage: str) -> None:
        """Add a check, without waiting for the answer."""
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
        """`found_inf` of torch's fused optimisers: a scalar on the device, 1 if any value so far wasn't finite, else 0;
        None before the first check."""
        self._gather()
        return self._any

    def look(self) -> None:
        """Wait for the answers. Raises NonFiniteError for the first check with a value that isn't finite."""
        self._gather()
        if not self._largest:
            return
        largest = torch.cat(self._largest).tolist()
        checks, self._checks, self._largest = self._checks, [], []
        for (place, stage, size), value in zip(checks, largest, strict=True):
            if not math.isfinite(value):
                self._any = None  # training may continue from an earlier state
                raise place.error(stage, f"some of {size} values" if size > 1 else f"{stage} isn't finite")


@dataclass(frozen=True)
class Place:
    """The number of the step, and its view's name. watch: gathers the checks of tensors that aren't on the CPU; without
    one they are carried out at once too."""

    step: int
    view: str
    watch: Watch | None = None

    def error(self, stage: str, detail: str) -> NonFiniteError:
        """The exception to raise for a value at this place that isn't finite."""
        return NonFiniteError(NonFinite(self.step, self.view, stage, detail))

    def check(self, tensor: Tensor | None, stage: str) -> None:
        """Raise NonFiniteError unless all values are finite, or leave that to the watch."""
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
        """Turn a kernel's FloatingPointError into a NonFiniteError; the innermost block names the stage."""
        try:
            yield
        except NonFiniteError:
            raise
        except FloatingPointError as error:
            raise self.error(stage, str(error)) from None


def finite_part(gradient: Tensor) -> Tensor:
    """The gradient to learn from: on the CPU it has been checked; elsewhere what isn't finite becomes 0."""
    return gradient if gradient.device.type == "cpu" else torch.nan_to_num(gradient, 0.0, 0.0, 0.0)


class ReportedLoss:
    """The loss for the observer, without the host waiting for a device at every step."""

    def __init__(self, watch: Watch):
        self._watch = watch
        self._loss, self._next_look = math.nan, 0

    def after(self, step: int, loss: Tensor) -> float:
        """The loss of this step on the CPU, on a device that of the last look. Raises the errors of `Watch.look`."""
        if loss.device.type == "cpu" or step >= self._next_look:
            self._watch.look()
            self._loss, self._next_look = float(loss.detach()), step + _LOOK_EVERY
        return self._loss


class StageClock:
    """Adds up seconds by stage. Time in a nested stage counts for that stage only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._within = [0.0]  # for each open stage, the seconds of the stages nested in it

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the seconds of the block to the stage."""
        self._within.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            own = spent - self._within.pop()
            self._within[-1] += spent
            self.seconds[stage] = self.seconds.get(stage, 0.0) + own
