"""Structure from motion: photographs or a video to a scene with camera poses and sparse points (`reconstruct`)."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct


def reconstruct(settings: Reconstruct, *, progress: Progress | None = None) -> bool:
    """Make the scene of `settings`; False, with the reason printed, where the photographs don't give one.

    An interrupted run resumes after its last finished stage; a complete scene is kept. progress: None shows it on
    standard error, and the result on standard output. Raises InputError for wrong input, or when the folder holds
    something else.
    """
    from dofbench.core.progress import Terminal
    from dofbench.scenes.reconstruction.reconstructing import run

    outcome = run(settings, Terminal() if progress is None else progress)
    for line in outcome.remarks:
        print(line, file=sys.stderr, flush=True)
    return outcome.folder is not None


__all__ = ["reconstruct"]
