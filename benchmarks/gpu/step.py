"""Profile a training step on a GPU: its kernels, their launches, and calls of the host."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch.profiler import profile, supported_activities

from dofbench.core.budget import Budget
from dofbench.datasets.format.dataset import Dataset
from dofbench.methods.cards import find_method
from dofbench.runtime.device_host import feeding
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.trainer import Trainer

MOST = 40  # kernels, and calls of the host, that are listed


def profiler() -> profile:
    """A profiler of the host and, where there is one, of the GPU."""
    return profile(activities=supported_activities())


def is_kernel(event: Any) -> bool:
    """Whether an entry of a profile is a GPU kernel, not an annotation that spans kernels."""
    return event.device_type == torch.autograd.DeviceType.CUDA and not event.key.startswith("Optimizer.")


@dataclass
class Watch:
    """An observer that times `count` steps after `warm` ones, profiles as many again, and ends the training.

    times: from one step's end to the next one's, ms. The host waits for the GPU once in a step, so they are the GPU's
    too.
    """

    warm: int
    count: int
    times: list[float] = field(default_factory=list)
    profile: profile = field(default_factory=profiler)
    _began: float = 0.0

    def seconds(self) -> float:
        """No time limit."""
        return 0.0

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""

    def after_step(self, step: int, loss: float) -> bool:
        """Time and profile; False after the last step."""
        now = time.perf_counter()
        if self.warm < step <= self.warm + self.count:
            self.times.append(1e3 * (now - self._began))
        self._began = now
        if step == self.warm + self.count:
            torch.cuda.synchronize()
            self.profile.start()
        if step == self.warm + 2 * self.count:
            torch.cuda.synchronize()
            self.profile.stop()
            return False
        return True


def step_parts(data: Path, method_id: str, preset: str | None, device: str, warm: int, count: int) -> dict[str, Any]:
    """Time, GPU time and launches of a step of a Gaussian method; time, ms, and number a step of longest kernels and
    host calls."""
    entry, training_set = find_method(method_id), Dataset.load(data).training_set("shallow")
    _, options, _ = entry.preset(preset)
    method = entry.create(options, 0, device)
    assert isinstance(method, GaussianMethod)
    trainer = Trainer(training_set, method.options, 0, device)
    watch = Watch(warm, count)
    with feeding(device):  # as a run does
        trainer.fit(Budget(steps=options["steps"]), watch)
    kernels, calls = {}, {}
    for event in watch.profile.key_averages():
        if is_kernel(event):
            kernels[event.key] = [event.self_device_time_total / 1e3 / count, event.count / count]
        elif event.device_type == torch.autograd.DeviceType.CPU:
            calls[event.key] = [event.self_cpu_time_total / 1e3 / count, event.count / count]
    return {
        "gaussians": len(trainer.gaussians),
        "step_ms": statistics.median(watch.times),
        "longest_ms": max(watch.times),
        "gpu_ms": sum(took for took, _ in kernels.values()),
        "launches": sum(number for _, number in kernels.values()),
        "kernels": _longest(kernels),
        "host": _longest(calls),
    }


def _longest(found: dict[str, list[float]]) -> dict[str, list[float]]:
    return dict(sorted(found.items(), key=lambda one: -one[1][0])[:MOST])
