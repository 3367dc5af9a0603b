"""The options of `dofbench view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import options


@options()
class View:
    """Look at trained scenes and datasets in the browser: move, focus by a click, open the aperture, compare."""

    what: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Runs' folders, a dataset's folder, or 3DGS' .ply files. Several are shown side by side under one camera."""
    host: str = "127.0.0.1"
    """Address to listen at. Another one than this machine's own needs --token."""
    port: Annotated[int, Field(ge=1, le=65535)] = 8080
    """Port; the next free one is taken where it is in use."""
    token: str | None = None
    """Secret of at least 16 letters that the page's address must hold: http://HOST:PORT/?token=TOKEN."""
    width: Annotated[int, Field(ge=64)] = 1008
    """Largest width of a picture at rest, pixels."""
    keyframes: Path = Path("keyframes.json")
    """File that the button "save" writes, for `dofbench render --keyframes`."""

    def __post_init__(self) -> None:
        if not self.what:
            raise InputError("what", "nothing", "a run's folder, a dataset, or a .ply")
        if self.host not in LOOPBACK and self.token is None:
            raise InputError("--host", self.host, "--token too, as others on the network can reach it")
        if self.token is not None and (len(self.token) < 16 or not self.token.isalnum()):
            raise InputError("--token", f"{len(self.token)} characters", "at least 16 letters and digits")


LOOPBACK = ("127.0.0.1", "localhost", "::1")
