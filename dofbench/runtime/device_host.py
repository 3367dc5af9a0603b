"""What the host does beside the work that it hands to a device: as little as can be, while a training runs."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from dofbench.runtime.devices import kind_of


@contextmanager
def feeding(device: str) -> Iterator[None]:
    """A block in which a training on this device runs; on the CPU nothing changes.

    A step on a GPU takes as long as the host needs to hand over some hundreds of kernels. torch runs backward passes in
    a thread of their own for each device, and both threads then wait for Python's lock; here they run in the calling
    one. Python's garbage collector walks through everything that was imported; what there is when the block begins is
    left to it afterwards. In one thread and without any collections, a step took about two thirds of the time
    (docs/notes/gpu.md).
    """
    if kind_of(device) == "cpu":
        yield
        return
    gc.freeze()
    try:
        with torch.autograd.set_multithreading_enabled(False):
            yield
    finally:
        gc.unfreeze()
