"""make-scene: procedural scenes, rendered through a pinhole and through a real thin lens, with exact depth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.scenes.procedural.scene_options import MakeScene


def make_scene(settings: MakeScene, *, progress: Progress | None = None) -> list[Path]:
    """Render the scenes that `settings` asks for and return their folders.

    A run that was killed continues where it stopped, image by image. progress: None shows the progress on standard
    error, and the folders on standard output. Raises InputError for wrong input, without mitsuba, or when a folder
    holds something else.
    """
    from dofbench.core.progress import Terminal
    from dofbench.scenes.procedural.scene_builder import make

    return make(settings, Terminal() if progress is None else progress)


__all__ = ["make_scene"]
