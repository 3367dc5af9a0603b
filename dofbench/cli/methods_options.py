"""The arguments of `dofbench methods`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from dofbench.core.errors import InputError


@dataclass(frozen=True)
class Methods:
    """List the methods that can be trained; or, of one method, its presets, options, devices and published figures."""

    method: Annotated[str | None, tyro.conf.Positional] = None
    """Id of the method. Default: list all methods, one per line."""
    freeze: str | None = None
    """Freeze this preset of the method: write the commit and a digest of all that it chooses into the method's
    frozen.toml. Only frozen presets count on report scenes."""

    def __post_init__(self) -> None:
        if self.freeze is not None and self.method is None:
            raise InputError("--freeze", f"{self.freeze}, and no method", "the id of its method too")
