"""Scores that are kept as soon as they are done, so that the same command goes on from what is finished.

One file a photograph, named after what it was made of and by: the photograph's content and the code. What was
scored by other code is never read again, and removed.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import dofbench
from dofbench.content import content_folder
from dofbench.files import sha256_text, write_json
from dofbench.validation.score import Score
from dofbench.validation.truth import Case

FOLDER = ".scores"
# The sources that scores depend on, in the package and among the kernels.
SCORING = (
    "metrics", "defocus.py", "layered.py", "mixed_pixels.py", "depth_edges.py", "lens.py", "images.py", "simd.py",
    *(f"validation/{name}.py" for name in (
        "blb", "lens_points", "lightfield", "planes", "planes_lens", "regions", "rendered", "sampled", "score", "truth",
        "variants")),
)
KERNELS = ("scatter",)


def code_version() -> str:
    """A hash of every source file that can change a score, but for those that make a truth alone."""
    package = Path(dofbench.__file__).resolve().parent
    kernels = content_folder("kernels")
    return sources_hash([*(package / name for name in SCORING), *(kernels / name for name in KERNELS)])


def sources_hash(roots: list[Path]) -> str:
    """A hash of Python files and of all that lie in folders, and of their names."""
    digest = hashlib.sha256()
    for root in roots:
        for file in [root] if root.is_file() else sorted(root.rglob("*.py")):
            digest.update(f"{root.name}/{file.relative_to(root.parent).as_posix()}\0".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


class Store:
    """The scores in a folder, by photograph and variant."""

    def __init__(self, out: Path):
        self._folder, self._code = out / FOLDER, code_version()
        for file in self._folder.glob("*.json"):
            if not file.name.startswith(self._code[:16]):
                file.unlink()

    def read(self, case: Case) -> dict[str, list[Score]]:
        """The rows of each variant that is done; empty where none is, or where the file isn't whole."""
        try:
            kept = json.loads(self._file(case).read_text(encoding="utf-8"))
            return {name: [Score(**row) for row in rows] for name, rows in kept.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}

    def write(self, case: Case, rows: dict[str, list[Score]]) -> None:
        """Keep the rows of a photograph's variants, atomically; what was kept of it before is replaced."""
        write_json(self._file(case), {name: [asdict(row) for row in of_one] for name, of_one in rows.items()})

    def _file(self, case: Case) -> Path:
        return self._folder / f"{self._code[:16]}-{sha256_text(case.key)[:24]}.json"
