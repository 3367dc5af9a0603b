"""The options of `dofbench validate-renderer`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from dofbench.core.options import options


@options()
class ValidateRenderer:
    """Compare the renderers with optical blur: planes before an exact thin lens, rendered scenes, real light fields."""

    truths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Rendered scenes (scene.json), light fields (grid.json and views/RR_CC images), scenes of BLB (info.json and
    EXR images), or folders of these, besides the built-in planes."""
    out: Path = Path("reports/renderer")
    """Folder to write to. It keeps finished scores, so the same command continues after an interruption."""
    planes: bool = True
    """Score the built-in planes too; --no-planes scores only the folders given."""
    pictures: bool = True
    """Write picture strips of photographs and renderings; --no-pictures leaves them out, for example if the photographs
    may not be published."""
