"""What a call of `dofbench methods` says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Methods:
    """List the methods that can be trained; of one, its presets, options, devices, and what its authors claim."""

    method: Annotated[str | None, tyro.conf.Positional] = None
    """Id of the method. Default: all of them, a line each."""
