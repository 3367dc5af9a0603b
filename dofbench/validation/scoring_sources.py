"""What code a score was made by: what is kept of other code is of no use."""

from __future__ import annotations

import hashlib
from pathlib import Path

import dofbench
from dofbench.core.content import content_folder

PACKAGE = Path(dofbench.__file__).resolve().parent
# The sources that every score depends on, in the package and among the kernels.
SCORING = (
    "metrics",
    "optics",
    "core/lens.py",
    "core/images.py",
    "compute/simd.py",
    *(f"validation/{name}.py" for name in ("lens_points", "regions", "renderer_scores", "variants")),
)
KERNELS = ("scatter",)


def scoring_version() -> str:
    """A hash of every source file that can change a score, but for those that make one kind of truth."""
    kernels = content_folder("kernels")
    return _hash([*(PACKAGE / name for name in SCORING), *(kernels / name for name in KERNELS)])


def truth_version(*names: str) -> str:
    """The same of the modules that make one kind of truth: files and folders within the package."""
    return _hash([PACKAGE / name for name in names])


def _hash(roots: list[Path]) -> str:
    digest = hashlib.sha256()
    for root in roots:
        for file in [root] if root.is_file() else sorted(root.rglob("*.py")):
            digest.update(f"{root.name}/{file.relative_to(root.parent).as_posix()}\0".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
