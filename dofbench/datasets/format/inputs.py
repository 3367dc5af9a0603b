"""Which photographs a method trains on."""

from __future__ import annotations

from typing import Literal

Inputs = Literal["shallow", "all-in-focus"]
