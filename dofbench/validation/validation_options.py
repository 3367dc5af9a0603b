"""What a call of `dofbench validate-renderer` says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class ValidateRenderer:
    """Compare the renderers with optical blur: planes before an exact thin lens, rendered scenes, real light fields."""

    truths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Rendered scenes (scene.json), light fields (grid.json and views/RR_CC images), scenes of BLB (info.json and
    EXR images), or folders of these, besides the built-in planes."""
    out: Path = Path("reports/renderer")
    """Folder to write to. Finished scores are kept in it: the same command goes on from them."""
    planes: bool = True
    """The built-in planes; leave them out where only what is given counts."""
    pictures: bool = True
    """Strips of photographs and renders; leave them out of a report that is published where the
    photographs may not be."""
