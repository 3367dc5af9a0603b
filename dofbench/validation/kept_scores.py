"""Scores that are kept as soon as they are done, so that the same command goes on from what is finished.

One file a photograph, named after what it was made of and by: the photograph's content and the code. What was
scored by other code is never read again, and removed.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from dofbench.core.files import sha256_text, write_json
from dofbench.core.import_closure import closure_digest
from dofbench.validation.renderer_scores import Score, score
from dofbench.validation.renderer_truth import Case

FOLDER = ".scores"


class Store:
    """The scores in a folder, by photograph and variant."""

    def __init__(self, out: Path):
        self._folder, self._code = out / FOLDER, closure_digest([score, "dofbench.validation.variants:VARIANTS"])
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
