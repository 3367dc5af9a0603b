"""The arguments of `dofbench methods`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Methods:
    """List the methods that can be trained; or, of one method, its presets, options, devices and published figures."""

    method: Annotated[str | None, tyro.conf.Positional] = None
    """Id of the method. Default: list all methods, one per line."""
