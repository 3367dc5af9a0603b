"""Scores on disk, written as soon as they are computed, so that the same command continues after an interruption.

One file per photograph, named by a hash of the photograph's content and the code. Scores by other code are never read,
and are removed.
"""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path

from dofbench.core.files import read_json, sha256_text, write_json
from dofbench.core.source_digest import SCORED, package_digest
from dofbench.evaluation.renderer.renderer_scores import Score
from dofbench.evaluation.renderer.renderer_truth import Case

FOLDER = ".scores"
_NAME = re.compile(r"[0-9a-f]{16}-[0-9a-f]{24}\.json")


class Store:
    """The scores in a folder, by photograph and variant."""

    def __init__(self, out: Path):
        self._folder, self._code = out / FOLDER, package_digest((*SCORED, "evaluation/renderer"))
        for file in self._folder.glob("*.json"):
            if _NAME.fullmatch(file.name) and not file.name.startswith(self._code[:16]):
                file.unlink()

    def read(self, case: Case) -> dict[str, list[Score]]:
        """The rows of each variant that is scored; empty if none is, or if the file is damaged."""
        try:
            kept = read_json(self._file(case))
            return {name: [Score(**row) for row in rows] for name, rows in kept.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}

    def write(self, case: Case, rows: dict[str, list[Score]]) -> None:
        """Write the rows of a photograph's variants, atomically, in place of earlier ones."""
        write_json(self._file(case), {name: [asdict(row) for row in of_one] for name, of_one in rows.items()})

    def _file(self, case: Case) -> Path:
        return self._folder / f"{self._code[:16]}-{sha256_text(case.key)[:24]}.json"
