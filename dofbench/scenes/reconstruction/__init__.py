"""Structure from motion: photographs or a video in, a scene with camera poses and sparse points out.

`reconstruct` is the way in. Everything that it finds out stands in the scene's reconstruct.json.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct


def reconstruct(settings: Reconstruct, *, progress: Progress | None = None) -> bool:
    """Make the scene that `settings` describe; False where no scene came of the photographs, with the reason said.

    A run that was killed goes on after the last stage that it finished; a scene that is complete is left as it is.
    progress: None shows it on standard error, and what came of it on standard output. Raises InputError for wrong
    input, or when the folder holds something else.
    """
    from dofbench.core.progress import Terminal
    from dofbench.scenes.reconstruction.reconstructing import run

    outcome = run(settings, Terminal() if progress is None else progress)
    for line in outcome.remarks:
        print(line, file=sys.stderr, flush=True)
    return outcome.folder is not None


__all__ = ["reconstruct"]
