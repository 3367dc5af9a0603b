"""Names that a file brings: a view, a file inside a folder, a run. Checked before a path is made of them.

Whoever wrote a manifest, a model or a result may be a stranger. A name from one is joined to a folder of the user's,
so one that leads out of the folder would have this program write, copy or delete a file somewhere else.
"""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated

from pydantic import AfterValidator

from dofbench.core.errors import InputError

# Of one part of a path, bytes in UTF-8. Linux allows 255; what is written beside a file adds a suffix to its name.
LONGEST = 200
_INSIDE = "a name inside the folder: no absolute path, no .., no control character"


def problem_with(name: str) -> str:
    """Why `name` is no name of a file inside a folder, in a few words; "" where it is one.

    Parts are separated by '/'. A name that isn't UTF-8 (with surrogate escapes) is refused as well: it could not be
    written into a JSON file, or printed.
    """
    if not name or name in (".", "/"):
        return "an empty name"
    if any(ord(character) < 32 or ord(character) == 127 for character in name):
        return "a control character in a name"
    try:
        parts = [len(part.encode()) for part in name.split("/")]
    except UnicodeEncodeError:
        return "a name that isn't UTF-8"
    if max(parts) > LONGEST:
        return f"a name of {max(parts)} bytes, {LONGEST} at most"
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor:
        return "an absolute path"
    return "a path with .." if ".." in name.replace("\\", "/").split("/") else ""


def inside(name: object, subject: object) -> str:
    """`name` unchanged, where it is the name of a file inside a folder. Raises InputError about `subject`, the file
    that brings it, where it isn't."""
    problem = problem_with(name) if isinstance(name, str) else f"a name that is {type(name).__name__}"
    if problem:
        raise InputError(subject, f"{problem} ({name!r:.80})", _INSIDE)
    return str(name)


def _valid(name: str) -> str:
    problem = problem_with(name)
    if problem:
        raise ValueError(f"{problem} ({name!r:.80}), expected {_INSIDE}")
    return name


def _valid_part(name: str) -> str:
    if "/" in name or "\\" in name:
        raise ValueError(f"a path ({name!r:.80}), expected the name of one file or folder")
    return _valid(name)


# In a pydantic record: a path inside the folder that the record's file is in; and one part of such a path.
InsidePath = Annotated[str, AfterValidator(_valid)]
InsideName = Annotated[str, AfterValidator(_valid_part)]
