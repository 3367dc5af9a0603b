"""What a call of `dofbench report` says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Report:
    """Make leaderboards, curves and per-view tables of every result below a folder."""

    results: Annotated[Path, tyro.conf.Positional] = Path("results")
    """Folder of results, as `dofbench run` writes them."""
    out: Path = Path("reports/leaderboard")
    """Folder to write to."""
    pictures: bool = True
    """Strips of photographs and predictions; leave them out of a board that is published where the
    photographs may not be."""
