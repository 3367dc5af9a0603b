"""Where the content folders (datasets, methods, kernels, the report's templates) are: checkout or installed wheel.

`datasets` and `kernels` are also names of registry packages, so these folders must never be
importable at the top level: they hold content, loaded by id, and have no `__init__.py`.
"""

from __future__ import annotations

import os
from pathlib import Path

from dofbench.core.errors import InputError

_PACKAGE = Path(__file__).resolve().parent.parent
FOLDERS = ("datasets", "kernels", "methods", "reports/templates")


def content_folder(name: str) -> Path:
    """The folder that holds content of kind `name`, one of `FOLDERS`."""
    if name not in FOLDERS:
        raise InputError("content folder", repr(name), f"one of {', '.join(FOLDERS)}")
    installed = _PACKAGE / "_content" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def method_folders() -> list[Path]:
    """Folders searched for methods: the shipped one, then those in `DOFBENCH_METHODS`."""
    outside = os.environ.get("DOFBENCH_METHODS", "")
    folders = [content_folder("methods")]
    for entry in filter(None, outside.split(os.pathsep)):
        folder = Path(entry).expanduser()
        if not folder.is_dir():
            raise InputError("DOFBENCH_METHODS", f"{entry}, which is no folder", "folders of methods")
        folders.append(folder)
    return folders
