"""The options of `dofbench validate-renderer`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from dofbench.core.options import options


@options()
class ValidateRenderer:
    """Compare the renderers with optical blur: exact thin-lens planes, rendered scenes, real light fields."""

    truths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Rendered scenes (scene.json), light fields (grid.json and views/RR_CC images), BLB scenes (info.json and EXR
    images), or folders of these, besides the built-in planes."""
    out: Path = Path("reports/renderer")
    """Output folder. It keeps finished scores: rerun the same command to resume."""
    planes: bool = True
    """Score the built-in planes."""
    pictures: bool = True
    """Write picture strips of photographs and renderings."""
