"""What the host leaves out while a training runs on a device."""

from __future__ import annotations

import gc

import pytest
import torch

from dofbench.runtime.device_host import feeding


def state() -> tuple[bool, int]:
    return torch.autograd.is_multithreading_enabled(), gc.get_freeze_count()


def test_on_the_cpu_nothing_changes() -> None:
    before = state()
    with feeding("cpu"):
        assert state() == before


@pytest.mark.parametrize("device", ["cuda", "cuda:1"])
def test_on_a_gpu_one_thread_and_what_is_there_is_left_to_the_collector_afterwards(device: str) -> None:
    before = state()
    with pytest.raises(KeyError), feeding(device):
        threads, frozen = state()
        assert not threads and frozen > before[1] + 1000
        raise KeyError
    assert state() == before
