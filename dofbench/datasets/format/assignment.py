"""How the lenses of a dataset are assigned to its views."""

from __future__ import annotations

from typing import Literal

# Values of `make-dataset --assign`.
Assign = Literal["per-view", "fixed", "held-out", "continuous"]
Assignment = Assign | Literal["unknown"]  # unknown: real photographs, whose lens isn't known
