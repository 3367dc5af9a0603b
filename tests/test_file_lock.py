"""Locks on folders: they keep others out, and where there are none the work goes on without."""

from __future__ import annotations

import errno
import os

import pytest
from called import holding

from dofbench.core import file_lock
from dofbench.core.errors import InputError
from dofbench.core.file_lock import Lock, ask, only_writer


def without_locks(number):
    def flock(handle, operation):
        raise OSError(number, os.strerror(number))

    return flock


def test_another_process_is_kept_out_as_long_as_one_writes(tmp_path):
    imports = "from pathlib import Path\nfrom dofbench.core.file_lock import only_writer"
    other = holding(imports, f"only_writer(Path({str(tmp_path)!r}))")
    with pytest.raises(InputError, match="another run that is writing it"), only_writer(tmp_path):
        pass
    handle = os.open(tmp_path, os.O_RDONLY)
    assert ask(handle, shared=True) is Lock.THEIRS
    other.communicate("")
    assert ask(handle) is Lock.OURS and ask(handle, shared=True) is Lock.OURS
    os.close(handle)
    with only_writer(tmp_path):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_guards_nothing_and_stops_nobody(tmp_path, monkeypatch, number):
    monkeypatch.setattr(file_lock.fcntl, "flock", without_locks(number))
    with only_writer(tmp_path), only_writer(tmp_path):
        pass


def test_what_else_goes_wrong_is_not_hidden(tmp_path, monkeypatch):
    monkeypatch.setattr(file_lock.fcntl, "flock", without_locks(errno.EIO))
    with pytest.raises(OSError, match=os.strerror(errno.EIO)), only_writer(tmp_path):
        pass


def test_a_system_without_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(file_lock, "fcntl", None)
    handle = os.open(tmp_path, os.O_RDONLY)
    assert ask(handle) is Lock.NONE
    os.close(handle)
