"""A training as it was a few minutes ago, from which a later process goes on: after a kill, a time limit, a preemption.

A checkpoint is Python's pickle of the method's own state, which runs code when it is read. It is read only by the run
that wrote it, in its own folder and of the same key; no report, merge or check opens it.
"""

from __future__ import annotations

import pickle
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import torch

from dofbench.core.contracts import Resumes
from dofbench.core.errors import Interrupted
from dofbench.core.files import replacing

CHECKPOINT_FOLDER = "checkpoints"  # in the run's folder, until the training has ended
EVERY = 300.0  # s between two checkpoints
_KEPT = 2  # the last may be damaged, as by a disk that was full
_CONSTANT = "constant.pt"  # what doesn't change during the training, saved once
TWICE = 1.0  # s within which a second signal is the first one again
_ASKING = (signal.SIGTERM, signal.SIGUSR2)  # Slurm's, before a time limit or a preemption
_DAMAGED = (OSError, EOFError, RuntimeError, pickle.UnpicklingError, KeyError, TypeError, ValueError, AttributeError)


class Checkpoints:
    """Saves a training every few minutes, and when a signal asks the process to end: then the step is ended first.

    folder: the run's. key: of the run, so that no other one goes on from here. started: when the run began, by its
    first process. resumed: the steps after which a later process went on.
    """

    def __init__(self, folder: Path, key: str, method: Resumes, started: str):
        self._folder, self._key, self._method = folder / CHECKPOINT_FOLDER, key, method
        self.started, self.resumed = started, list[int]()
        self._last = time.monotonic()
        self._steps = 0  # that were taken since this process began: without any there is nothing to be saved
        self._constant_saved = False
        self._asked: int | None = None
        self._asked_at = 0.0
        self._before: dict[signal.Signals, Any] = {}
        self.problem = ""

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Answer the signals during the block. A second one, or one before the first step, does what it would without.
        One that comes twice at once, to the group and forwarded by the parent, counts once. Python handles signals in
        the main thread alone: in others nobody listens."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        self._before = {number: signal.getsignal(number) for number in _ASKING}

        def asked(number: int, frame: FrameType | None) -> None:
            if self._steps and self._asked is None:
                self._asked, self._asked_at = number, time.monotonic()
            elif self._asked is None or time.monotonic() - self._asked_at > TWICE:
                self._end(number)

        for number in _ASKING:
            signal.signal(number, asked)
        try:
            yield
        finally:
            for number, former in self._before.items():
                signal.signal(number, former)

    def _end(self, number: int) -> None:
        """What would have answered the signal answers it now. On a cluster that queues the job again, or does nothing,
        and training goes on until it is killed."""
        former = self._before.get(signal.Signals(number))
        if not callable(former):
            raise Interrupted(number)
        self._asked = None
        former(number, None)

    def due(self) -> bool:
        """Whether it is time for one; to be asked after every step."""
        self._steps += 1
        return self._asked is not None or time.monotonic() - self._last >= EVERY

    def save(self, step: int, observed: dict[str, Any]) -> None:
        """Save the training after a step, with the observer's state, and remove older ones but the last. Raises
        Interrupted where a signal asked for it.

        What can't be saved, as on a full disk, doesn't end a training; `problem` says so.
        """
        try:
            if not self._constant_saved:
                self._write(_CONSTANT, {"key": self._key, "method": self._method.constant_state()})
                self._constant_saved = True
            own = {"key": self._key, "step": step, "started": self.started, "resumed": self.resumed}
            self._write(f"{step:09d}.pt", {**own, "method": self._method.training_state(), "observed": observed})
        except (OSError, RuntimeError) as error:
            self.problem = f"no checkpoint after step {step}: {' '.join(str(error).split())}"
        for old in self._found()[:-_KEPT]:
            old.unlink(missing_ok=True)
        self._last = time.monotonic()
        if self._asked is not None:
            self._end(self._asked)

    def resume(self) -> dict[str, Any] | None:
        """Have the method go on from the last checkpoint that is whole; returns the observer's state, None without one.
        For a damaged one the one before it is taken."""
        constant = self._read(self._folder / _CONSTANT)
        for file in reversed(self._found()):
            state = self._read(file)
            if state is None or constant is None:
                continue
            self._method.resume_from(state["method"], constant["method"])
            self._constant_saved = True
            self.started, self.resumed = state["started"], [*state["resumed"], state["step"]]
            observed: dict[str, Any] = state["observed"]
            return observed
        self.remove()  # else they would count as later than those of the training that begins
        return None

    def remove(self) -> None:
        """Remove all, when they are of no more use."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _write(self, name: str, state: dict[str, Any]) -> None:
        with replacing(self._folder / name) as temporary:
            torch.save(state, temporary)

    def _read(self, file: Path) -> dict[str, Any] | None:
        """None for a file that isn't there, is damaged, or of another run."""
        try:
            state: dict[str, Any] = torch.load(file, weights_only=False)
            return state if state["key"] == self._key else None
        except _DAMAGED:
            return None

    def _found(self) -> list[Path]:
        return sorted(self._folder.glob("[0-9]*.pt"))
