"""What a call of `dofbench validate-renderer` says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class ValidateRenderer:
    """Compare the renderers with optical blur: planes before an exact thin lens, and real light fields."""

    lightfields: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders of light fields (grid.json and views/RR_CC images), besides the built-in planes."""
    out: Path = Path("reports/renderer")
    """Folder to write to."""
    pictures: bool = True
    """Strips of photographs and renders; leave them out of a report that is published where the
    photographs may not be."""
