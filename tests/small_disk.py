"""A file system of a few KiB, on which writes end with a full disk."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path, kib: int) -> Iterator[Callable[[str], None]]:
    """Mounts one at `folder`, which is made, and yields what mounts it anew with other options; skips where that isn't
    possible."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    folder.mkdir()

    def mount(*words: str) -> bool:
        return subprocess.run(["mount", *words, str(folder)], capture_output=True).returncode == 0

    if not mount("-t", "tmpfs", "-o", f"size={kib}k", "tmpfs"):
        pytest.skip("file systems can't be mounted here")

    def again(options: str) -> None:
        assert mount("-o", f"remount,{options}")

    try:
        yield again
    finally:
        subprocess.run(["umount", "-l", str(folder)], capture_output=True)
