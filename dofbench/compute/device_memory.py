"""How much of something a GPU's memory would hold, after there wasn't enough of it."""

from __future__ import annotations

import re

import torch

_SPARE = 0.9  # of the memory: the rest is lost to pieces between what is in use
_UNITS = {"bytes": 1, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}


def would_fit(count: int, device: str, error: torch.OutOfMemoryError) -> int:
    """How many things a GPU would hold, where `count` of them were too many: in proportion to the memory that this
    process has in use and asked for, which torch's message says. To two digits, since no more is known."""
    free, _ = torch.cuda.mem_get_info(device)
    asked = re.search(r"Tried to allocate ([\d.]+) (\w+)", str(error))
    more = float(asked[1]) * _UNITS.get(asked[2], 1) if asked else 0.0
    in_use, held = torch.cuda.memory_allocated(device), torch.cuda.memory_reserved(device)
    fitting = _SPARE * count * (free + held) / max(in_use + more, free + held)
    return int(float(f"{fitting:.1e}"))
