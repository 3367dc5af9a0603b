"""Typed statuses of exceptions out of a method."""

from __future__ import annotations

import traceback

from dofbench.core.errors import Ended, Status, out_of_memory


def classify(error: BaseException) -> tuple[Status, str]:
    """The typed status of an exception out of a method, and one line about it; a crash with the file and line of the
    failing code."""
    if isinstance(error, Ended):
        return error.status, " ".join(str(error).split())
    text = " ".join(f"{type(error).__name__}: {error}".split())
    if out_of_memory(error):
        return Status.OUT_OF_MEMORY, text
    if isinstance(error, FloatingPointError):
        return Status.DIVERGED, text
    return Status.CRASHED, f"{text}{_place(error)}"


def _place(error: BaseException) -> str:
    """Where the error was raised: the innermost line of code that isn't an installed library's."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    return f" ({own[-1].filename}:{own[-1].lineno})" if own else ""
