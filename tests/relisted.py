"""Datasets and results that a test has changed, with checksums and digests of what is there now."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from dofbench.core.digests import write_with_digest
from dofbench.core.files import sha256_file, write_json

MANIFEST = "dataset.json"


def edit_json(path: Path, change: Callable[[dict], object]) -> None:
    """Change the content of a JSON file, and its digest if it has one."""
    content = json.loads(path.read_text())
    change(content)
    write_again(path, content)


def write_again(path: Path, content: dict) -> None:
    """Write a JSON file, with a new digest if it has one."""
    (write_with_digest if "digest" in content else write_json)(path, content)


def relist(folder: Path) -> None:
    """Bring the manifest up to date with the files, as a program would that makes such a dataset."""
    files = {
        path.relative_to(folder).as_posix(): {"sha256": sha256_file(path), "size": path.stat().st_size}
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != MANIFEST
    }
    edit_json(folder / MANIFEST, lambda manifest: manifest.update(files=files))
