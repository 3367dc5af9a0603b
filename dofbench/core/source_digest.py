"""Which code made a result: a hash of the sources of whole folders."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from dofbench.core.content import content_folder

PACKAGE = Path(__file__).resolve().parent.parent
# The packages that a training or a score can depend on.
SCORED = (
    "core",
    "runtime",
    "optics",
    "scenes",
    "training",
    "datasets/format",
    "methods",
    "evaluation/metrics",
    "evaluation/scoring",
)


def source_digest(
    folders: Iterable[Path], suffixes: tuple[str, ...] = (".py",), *, skip: str = "", deep: bool = True
) -> str:
    """Return the sha256 over names (relative to their folder) and contents of all source files below the folders.

    skip: a pattern of file names that don't count. deep: with the files of inner folders.
    Raises ValueError for a folder that isn't there.
    """
    digest = hashlib.sha256()
    for folder in folders:
        if not folder.is_dir():
            raise ValueError(f"sources: found no folder {folder}, expected one of Python files")
        for file in sorted(folder.rglob("*") if deep else folder.glob("*")):
            if file.suffix in suffixes and not (skip and file.match(skip)):
                content = file.read_bytes()
                digest.update(f"{file.relative_to(folder).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()


@cache
def package_digest(packages: tuple[str, ...] = SCORED, device: str | None = None) -> str:
    """Return the `source_digest` of packages of dofbench and of all kernels, read once per process.

    device: "cpu" skips the backends that only a GPU's tensors get, `gpu*.py`.
    """
    kernels = source_digest([content_folder("kernels")], skip="gpu*.py" if device == "cpu" else "")
    return hashlib.sha256((source_digest(PACKAGE / name for name in packages) + kernels).encode()).hexdigest()
