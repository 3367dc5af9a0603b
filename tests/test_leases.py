"""Leases: one owner at a time, on one machine and on several, and no waiting for dead owners."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from pathlib import Path

import pytest
from called import holding
from hypothesis import given, settings
from hypothesis import strategies as st

from dofbench.core import file_lock
from dofbench.core.errors import InputError
from dofbench.core.file_lock import Lock
from dofbench.runtime import leases
from dofbench.runtime.leases import EXPIRES_AFTER, at_work, leased, leased_folders, left_note

NO_LOCKS = pytest.mark.parametrize("locks", [True, False], ids=["locks", "no locks"])


def hold(folder: Path) -> subprocess.Popen[str]:
    """A process that holds the folder's lease until its input ends."""
    imports = "from pathlib import Path\nfrom dofbench.runtime.leases import leased"
    return holding(imports, f"leased(Path({str(folder)!r}), {{'what': 'mine'}})")


def file_of_another_machine(folder: Path, age: float, name: str = "running.lock") -> Path:
    """A lease that a process of another machine left, renewed `age` seconds ago; no lock of it reaches here."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / name
    file.write_text(json.dumps({"process": 1, "machine": "another one", "what": "theirs"}))
    when = time.time() - age
    os.utime(file, (when, when))
    return file


@NO_LOCKS
def test_one_process_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locks: bool) -> None:
    if not locks:
        monkeypatch.setattr(file_lock, "fcntl", None)
    with leased(tmp_path, {"what": "mine"}):
        assert at_work(tmp_path)
        with pytest.raises(InputError, match="another process"), leased(tmp_path, {}):
            pass
        found = left_note(tmp_path)
        assert found is not None and found[1]["what"] == "mine" and found[1]["process"] == os.getpid()
    assert not at_work(tmp_path) and left_note(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_of_a_killed_process_of_this_machine_nothing_is_waited_for(tmp_path: Path) -> None:
    other = hold(tmp_path)
    assert at_work(tmp_path)
    other.kill()
    other.communicate()
    assert not at_work(tmp_path)
    found = left_note(tmp_path)
    assert found is not None and found[1]["what"] == "mine" and leased_folders(tmp_path) == [tmp_path]
    with leased(tmp_path, {"what": "again"}) as lease:
        lease.check()
        found = left_note(tmp_path)
        assert found is not None and found[1]["what"] == "again"
        assert len(list(tmp_path.iterdir())) == 1  # what the dead one left is gone
    assert list(tmp_path.iterdir()) == []


@NO_LOCKS
def test_another_machine_s_lease_holds_until_it_is_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locks: bool
) -> None:
    if not locks:
        monkeypatch.setattr(file_lock, "fcntl", None)
    file_of_another_machine(tmp_path, EXPIRES_AFTER - 20)
    assert at_work(tmp_path)
    with pytest.raises(InputError, match="another process"), leased(tmp_path, {}):
        pass
    file_of_another_machine(tmp_path, EXPIRES_AFTER + 5)
    assert not at_work(tmp_path)
    with leased(tmp_path, {}):
        assert [file.name for file in tmp_path.iterdir()] == ["running.2.lock"]


def test_without_locks_a_lease_of_this_machine_ages_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_lock, "fcntl", None)
    file = tmp_path / "running.lock"
    file.write_text(json.dumps({"machine": leases._machine()}))
    assert at_work(tmp_path)
    os.utime(file, (0, 0))
    assert not at_work(tmp_path)


def test_a_lock_that_a_dead_machine_left_on_the_network_s_disk_stops_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file_of_another_machine(tmp_path, EXPIRES_AFTER + 5)
    monkeypatch.setattr(leases, "ask", lambda handle, shared=False: Lock.THEIRS if shared else Lock.OURS)
    assert not at_work(tmp_path)
    with leased(tmp_path, {}):
        pass


def test_a_lease_of_before_there_were_machines_in_it(tmp_path: Path) -> None:
    (tmp_path / "running.lock").write_text(json.dumps({"process": 7, "started": "noon"}))
    assert not at_work(tmp_path)
    (tmp_path / "running.lock").write_text("")  # killed while it wrote
    assert not at_work(tmp_path)
    with leased(tmp_path, {}):
        assert at_work(tmp_path)


def test_it_is_renewed_as_long_as_it_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "RENEWED_EVERY", 0.01)
    with leased(tmp_path, {}):
        (file,) = tmp_path.iterdir()
        os.utime(file, (0, 0))
        limit = time.monotonic() + 20
        while file.stat().st_mtime == 0:
            assert time.monotonic() < limit
            time.sleep(0.01)


def test_who_was_silent_for_too_long_writes_nothing_any_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A laptop that slept, while another machine took its work over."""
    with leased(tmp_path, {}) as asleep:
        (file,) = tmp_path.iterdir()
        asleep.check()
        os.utime(file, (0, 0))
        monkeypatch.setattr(leases, "_machine", lambda: "another one")
        with leased(tmp_path, {}) as awake:
            with pytest.raises(InputError, match="took this work over"):
                asleep.check()
            awake.check()
            asleep.end()  # and takes nothing of the other's away
            awake.check()
    assert list(tmp_path.iterdir()) == []


def test_who_waits_gets_it_and_only_one_at_a_time(tmp_path: Path) -> None:
    inside, most, entered = 0, 0, []

    def other(number: int) -> None:
        nonlocal inside, most
        with leased(tmp_path, {"number": number}, wait=True):
            inside += 1
            most = max(most, inside)
            entered.append(number)
            time.sleep(0.02)
            inside -= 1

    threads = [threading.Thread(target=other, args=(number,)) for number in range(4)]
    with leased(tmp_path, {}):
        for thread in threads:
            thread.start()
        time.sleep(0.1)
        assert not entered
    for thread in threads:
        thread.join(60)
    assert sorted(entered) == [0, 1, 2, 3] and most == 1 and list(tmp_path.iterdir()) == []


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 10**6), min_size=2, max_size=4, unique=True), st.booleans())
def test_a_dead_lease_goes_to_one_of_all_that_want_it(
    tmp_path_factory: pytest.TempPathFactory, delays: list[int], old: bool
) -> None:
    """All judge the same dead lease at one moment; each has its own delay between judging and taking."""
    folder = tmp_path_factory.mktemp("dead")
    if old:
        file_of_another_machine(folder, EXPIRES_AFTER + 5, "running.3.lock")
    ready, holders, held = threading.Barrier(len(delays)), [], []
    found_once = threading.local()
    genuine = leases._files

    def files(place: Path) -> list[Path]:
        found = genuine(place)
        if not getattr(found_once, "done", False):
            found_once.done = True
            ready.wait(20)
            time.sleep(found_once.delay / 1e8)
        return found

    def take(delay: int) -> None:
        found_once.delay = delay
        lease = leases._taken(folder, b'{"machine": "here"}')
        if lease is not None:
            held.append(lease)
            holders.append(delay)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(leases, "_files", files)
        threads = [threading.Thread(target=take, args=(delay,)) for delay in delays]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
    assert len(holders) <= 1  # none, if two withdrew for one another: `leased` tries again
    for lease in held:
        lease.check()
        lease.end()
    assert not [file for file in folder.iterdir() if file.name.startswith(".lease")]


def test_what_processes_left_that_died_while_they_took_a_lease_is_cleared_away(tmp_path: Path) -> None:
    (tmp_path / ".dofbench-lease.empty").write_text("")
    (tmp_path / ".dofbench-lease.whole").write_text(json.dumps({"machine": leases._machine()}))
    theirs = file_of_another_machine(tmp_path, 5.0, ".dofbench-lease.theirs")
    with (tmp_path / ".dofbench-lease.living").open("w") as living:
        assert file_lock.ask(living.fileno()) is Lock.OURS
        with leased(tmp_path, {}):
            left = {".dofbench-lease.living", theirs.name, "running.lock"}
            assert {file.name for file in tmp_path.iterdir()} == left
    file_of_another_machine(tmp_path, EXPIRES_AFTER + 5, theirs.name)
    with leased(tmp_path, {}):
        assert {file.name for file in tmp_path.iterdir()} == {"running.lock"}


def test_who_is_taken_for_dead_while_it_takes_a_lease_tries_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine, cleared = os.link, []

    def link(temporary: Path, target: Path) -> None:
        if not cleared:
            cleared.append(temporary)
            Path(temporary).unlink()
        genuine(temporary, target)

    monkeypatch.setattr(os, "link", link)
    with leased(tmp_path, {}) as lease:
        lease.check()
    assert cleared and list(tmp_path.iterdir()) == []


def test_a_file_system_without_second_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_link(self: Path, target: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", lambda *given, **more: no_link(tmp_path, None))
    with leased(tmp_path, {"what": "mine"}) as lease:
        lease.check()
        assert at_work(tmp_path)
        found = left_note(tmp_path)
        assert found is not None and found[1]["what"] == "mine"
        with pytest.raises(InputError, match="another process"), leased(tmp_path, {}):
            pass
    assert list(tmp_path.iterdir()) == []
