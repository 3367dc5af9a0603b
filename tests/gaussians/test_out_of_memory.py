"""A GPU without enough memory ends a training with a typed status, and says how many Gaussians would fit."""

from __future__ import annotations

import pytest
import torch
from made_up import Recorder
from small_scene import options, training_set

from dofbench.core.budget import Budget
from dofbench.core.errors import Ended, Status
from dofbench.running.execution import classify
from dofbench.runtime.device_memory import would_fit
from dofbench.training.gaussians import trainer as module
from dofbench.training.gaussians.trainer import Trainer

GIB = 2**30


def memory(monkeypatch: pytest.MonkeyPatch, free: float, in_use: float, held: float) -> None:
    """A GPU with so many GiB free, and so many in use and held by this process."""
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (int(free * GIB), 80 * GIB))
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: int(in_use * GIB))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: int(held * GIB))


@pytest.mark.parametrize(
    ("free", "in_use", "held", "asked", "expected"),
    [
        (1.0, 6.0, 7.0, "2.00 GiB", 9e5),  # 8 GiB needed where 8 are: but for what is lost between pieces
        (1.0, 14.0, 15.0, "2.00 GiB", 9e5),
        (2.0, 14.0, 14.0, "18.00 GiB", 4.5e5),  # 32 GiB needed where 16 are
        (0.0, 8.0, 8.0, "512.00 MiB", 8.5e5),
        (0.0, 8.0, 8.0, "", 9e5),
    ],
)
def test_what_fits_is_in_proportion_to_the_memory(
    free: float, in_use: float, held: float, asked: str, expected: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory(monkeypatch, free, in_use, held)
    message = (
        f"CUDA out of memory. Tried to allocate {asked}. GPU 0 has a total capacity of 80.00 GiB" if asked else "?"
    )
    assert would_fit(1_000_000, "cuda", torch.OutOfMemoryError(message)) == expected


def test_training_ends_with_the_number_of_gaussians_that_would_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    memory(monkeypatch, 2.0, 14.0, 14.0)
    take_step = module.take_step

    def full(state, step, *rest):
        if step == 3:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 18.00 GiB. GPU 0 has")
        return take_step(state, step, *rest)

    monkeypatch.setattr(module, "take_step", full)
    with pytest.raises(
        Ended, match=r"^250 Gaussians at step 2 are too many for cpu; try --set max_gaussians=110$"
    ) as end:
        Trainer(training_set(), options(), seed=0).fit(Budget(steps=5), Recorder())
    assert classify(end.value)[0] is Status.OUT_OF_MEMORY
