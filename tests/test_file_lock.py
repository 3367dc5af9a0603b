"""Locks on folders: they keep others out, end with their process, and leave no file."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from called import holding

from dofbench.core.errors import InputError
from dofbench.core.file_lock import HeldElsewhere, is_locked, locked, only_writer


def other(folder: Path):
    imports = "from pathlib import Path\nfrom dofbench.core.file_lock import only_writer"
    return holding(imports, f"only_writer(Path({str(folder)!r}))")


def test_another_process_is_kept_out_as_long_as_one_writes(tmp_path: Path) -> None:
    process = other(tmp_path)
    with pytest.raises(HeldElsewhere, match="another run that is writing it"), only_writer(tmp_path):
        pass
    process.communicate("")
    with only_writer(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_a_killed_process_keeps_nobody_out(tmp_path: Path) -> None:
    process = other(tmp_path)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    (file,) = tmp_path.iterdir()
    assert not is_locked(file)
    with only_writer(tmp_path):
        assert is_locked(file)
    assert not file.exists()


def test_what_the_block_writes_into_the_file_is_no_other_file(tmp_path: Path) -> None:
    """So that it can hold a record of the work."""
    file = tmp_path / "lock"
    with locked(file, "another", "none"):
        file.write_text("record")
        with pytest.raises(HeldElsewhere), locked(file, "another", "none"):
            pass
        assert is_locked(file) and file.read_text() == "record"
    assert not is_locked(file) and not file.exists()


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="a file"), only_writer(tmp_path / "file"):
        pass


def test_a_folder_that_cannot_be_written_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with only_writer(tmp_path):
        assert not list(tmp_path.iterdir())
