"""A program that runs in a child process, so that the parent can record what ended it in native code."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import resource
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NoReturn

from dofbench.runtime.memory_evidence import SAMPLE_EVERY, MemoryWatch

# Called by the parent with (why memory ran out, peak resident memory in MB); returns one line about what was recorded.
OnDeath = Callable[[str, float], str]
FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR2)
_PR_SET_PDEATHSIG = 1
_TERMINAL = 0x80  # si_code of a signal that the kernel sent, as Ctrl-C: the child has it too

_send: Callable[[bytes | None], object] | None = None


def supervised() -> bool:
    """Whether a parent process listens to `on_death`."""
    return _send is not None


def on_death(action: OnDeath | None) -> None:
    """What the parent is to do if this process dies for lack of memory; None: nothing any more."""
    if _send is not None:
        _send(None if action is None else pickle.dumps(action))


def report_deaths(send: Callable[[bytes | None], object]) -> None:
    """From now on `on_death` sends to the parent process by `send`."""
    global _send
    _send = send


def recorded(action: bytes | None, watch: MemoryWatch, number: int) -> tuple[str, bool]:
    """(one line about a lack of memory that ended the process, whether `action` recorded it); "" without evidence.

    number: the signal that ended the process.
    """
    why = watch.evidence(number)
    if not why or action is None:
        return (f"out of memory: {why}; finished work is kept" if why else ""), False
    try:
        return pickle.loads(action)(why, watch.peak_mb), True
    except Exception as error:  # another process has taken the work over, the disk is full, or no memory here either
        return f"out of memory: {why}, which couldn't be recorded: {error}", False


def in_child(failed: int) -> None:
    """Go on in a child process. The parent waits for it, ends as it does, and never returns from here.

    failed: exit status where the child died for lack of memory. To be called while there are no threads but those of
    libraries that are made for a fork. Without Linux, this process itself goes on.
    """
    if sys.platform != "linux":
        return
    sys.stdout.flush()
    sys.stderr.flush()
    ours, theirs = multiprocessing.Pipe(duplex=False)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    waited = {*FORWARDED, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, waited)
    parent = os.getpid()
    if child := os.fork():
        theirs.close()
        _end_as(child, ours, waited, failed)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it died meanwhile
        os._exit(128 + signal.SIGKILL)
    ours.close()
    report_deaths(theirs.send)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_as(child: int, pipe: Connection, waited: set[signal.Signals], failed: int) -> NoReturn:
    watch, action = MemoryWatch(child), None
    status: int | None = None
    while status is None:
        caught = signal.sigtimedwait(waited, SAMPLE_EVERY)
        if caught is not None and caught.si_signo in FORWARDED and caught.si_code != _TERMINAL:
            os.kill(child, caught.si_signo)
        watch.sample()
        ended, code = os.waitpid(child, os.WNOHANG)
        status = os.waitstatus_to_exitcode(code) if ended else None
        try:
            while pipe.poll():
                action = pipe.recv()
        except EOFError:
            pass
    if status >= 0:
        sys.exit(status)
    line, _ = recorded(action, watch, -status)
    if line:
        print(f"dofbench: {line}", file=sys.stderr, flush=True)
        sys.exit(failed)
    # The caller is shown the signal itself, as if there were no process in between; one core file is enough.
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    if -status not in (signal.SIGKILL, signal.SIGSTOP):
        signal.signal(-status, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    os.kill(os.getpid(), -status)
    sys.exit(128 - status)
