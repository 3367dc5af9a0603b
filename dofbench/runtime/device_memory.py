"""A GPU's memory: the most that was in use, and how much of something it would hold after there wasn't enough of it."""

from __future__ import annotations

import re

import torch

_SPARE = 0.9  # of the memory: the rest is lost to pieces between what is in use
_UNITS = {"bytes": 1, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}


def forget_peak(device: str) -> None:
    """Begin to look for the most memory anew; nothing on the CPU."""
    if device != "cpu":
        torch.cuda.reset_peak_memory_stats(device)


def peak_mb(device: str) -> dict[str, float]:
    """{"device_peak_mb": the most memory that this process had in use, MB}; nothing on the CPU."""
    return {} if device == "cpu" else {"device_peak_mb": torch.cuda.max_memory_allocated(device) / 1e6}


def would_fit(count: int, device: str, error: torch.OutOfMemoryError) -> int:
    """How many things a GPU would hold, where `count` of them were too many: in proportion to the memory that this
    process has in use and asked for, which torch's message says. To two digits, since no more is known."""
    free, _ = torch.cuda.mem_get_info(device)
    asked = re.search(r"Tried to allocate ([\d.]+) (\w+)", str(error))
    more = float(asked[1]) * _UNITS.get(asked[2], 1) if asked else 0.0
    in_use, held = torch.cuda.memory_allocated(device), torch.cuda.memory_reserved(device)
    fitting = _SPARE * count * (free + held) / max(in_use + more, free + held)
    return int(float(f"{fitting:.1e}"))
