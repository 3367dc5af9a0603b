"""Datasets whose files a test has changed, with a manifest that lists them as they are now."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from dofbench.core.files import sha256_file, write_json

MANIFEST = "dataset.json"


def edit_json(path: Path, change: Callable[[dict], object]) -> None:
    """Change the content of a JSON file."""
    content = json.loads(path.read_text())
    change(content)
    write_json(path, content)


def relist(folder: Path) -> None:
    """Bring the manifest up to date with the files, as a program would that makes such a dataset."""
    files = {
        path.relative_to(folder).as_posix(): {"sha256": sha256_file(path), "size": path.stat().st_size}
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != MANIFEST
    }
    edit_json(folder / MANIFEST, lambda manifest: manifest.update(files=files))
