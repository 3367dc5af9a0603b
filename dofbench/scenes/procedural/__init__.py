"""make-scene: procedural scenes, rendered through a pinhole and a thin lens, with exact depth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.scenes.procedural.scene_options import MakeScene


def make_scene(settings: MakeScene, *, progress: Progress | None = None) -> list[Path]:
    """Render the scenes of `settings` and return their folders; an interrupted run resumes image by image.

    progress: None shows it on standard error, and the folders on standard output. Raises InputError for wrong input,
    without mitsuba, or when a folder holds something else.
    """
    from dofbench.core.progress import Terminal
    from dofbench.scenes.procedural.scene_builder import make

    return make(settings, Terminal() if progress is None else progress)


__all__ = ["make_scene"]
