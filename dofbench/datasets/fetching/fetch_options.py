"""The options of `fetch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from dofbench.core.options import options


@options()
class Fetch:
    """Download the scenes of a named dataset, after stating its licence, and unpack them where `scenes` and
    `make-dataset` find them. Rerun the same command to resume."""

    name: Annotated[str, Positional]
    """A named dataset (llff), a scene of one (llff/fern), or the short name of a scene (fern)."""

    data_root: Path | None = None
    """Folder of named datasets, made if it isn't there; without it, the one in DOFBENCH_DATA."""

    keep_archive: bool = False
    """Keep the archive in DATA_ROOT/.downloads, to unpack other scenes of it later."""
