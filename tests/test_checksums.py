"""Checksums are those of the files as they are now, and unchanged files aren't read again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from dofbench.core import checksums as module
from dofbench.core.checksums import cache_folder, checksums


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "SETTLED", -1.0)  # files just written count as settled
    (tmp_path / "root" / "sub").mkdir(parents=True)
    for name in ("a", "sub/b"):
        (tmp_path / "root" / name).write_text(name)
    return tmp_path / "root"


def sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def no_reading(path: Path) -> str:
    raise AssertionError(f"{path} was read again")


def test_unchanged_files_are_read_once(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = {"a": sha("a"), "sub/b": sha("sub/b"), "c": None}
    assert checksums(root, expected) == expected
    monkeypatch.setattr(module, "sha256_file", no_reading)
    assert checksums(root, expected) == expected


def test_a_change_that_keeps_size_time_and_inode_is_seen(root: Path) -> None:
    checksums(root, ["a"])
    before = (root / "a").stat()
    (root / "a").write_text("b")
    os.utime(root / "a", ns=(before.st_atime_ns, before.st_mtime_ns))
    after = (root / "a").stat()
    assert (after.st_size, after.st_mtime_ns, after.st_ino) == (before.st_size, before.st_mtime_ns, before.st_ino)
    assert checksums(root, ["a"]) == {"a": sha("b")}


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b'{"version": 1, "files": {"a": 3}}', b"[" * 100_000])
def test_a_damaged_cache_is_no_obstacle(root: Path, content: bytes) -> None:
    checksums(root, ["a"])
    folder = cache_folder()
    assert folder is not None
    (file,) = folder.rglob("*.json")
    file.write_bytes(content)
    assert checksums(root, ["a"]) == {"a": sha("a")}


def test_a_cache_that_cant_be_written_is_no_obstacle(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (root / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(root / "file"))
    assert checksums(root, ["a"]) == {"a": sha("a")}


def test_a_file_that_may_change_within_a_tick_isnt_kept(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SETTLED", 60.0)
    checksums(root, ["a"])
    monkeypatch.setattr(module, "sha256_file", no_reading)
    with pytest.raises(AssertionError, match="read again"):
        checksums(root, ["a"])


def test_without_a_home_every_file_is_read(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")

    def homeless(path: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", homeless)
    assert checksums(root, ["a"]) == {"a": sha("a")}
