"""The two ways in which a call can go wrong that are not bugs."""

from __future__ import annotations

import difflib
import errno
import resource
from collections.abc import Callable, Iterable
from enum import StrEnum

# Characters of a part of a message: a file with a thousand mistakes has its first ones named.
_LONGEST = 1500


class InputError(ValueError):
    """The user's mistake: one line that names the file, what was found and what was expected.

    The command line prints it and exits with status 2; it never shows a traceback for it. The message is printable
    and of bounded length, whatever the file holds: a terminal obeys some control characters.
    """

    def __init__(self, subject: object, found: str, expected: str):
        self.subject, self.found, self.expected = str(subject), found, expected
        super().__init__(f"{printable(subject)}: found {printable(found)}, expected {printable(expected)}")


def unknown(subject: object, value: str, known: Iterable[str]) -> InputError:
    """The error for a name that isn't one of `known`: it says which are, and which one was probably meant."""
    names = sorted(known)
    near = difflib.get_close_matches(value, names, n=1)
    asked = f"; did you mean {near[0]}?" if near else ""
    return InputError(subject, repr(value) if value else "nothing", f"one of {', '.join(names) or 'none'}{asked}")


def first_line(message: Callable[[], str]) -> str:
    """The first line of a library's message, which may repeat itself over several, or quote bytes of the file."""
    try:
        lines = message().strip().splitlines()
    except UnicodeDecodeError:
        return "damaged header"
    return lines[0] if lines else "unknown format"


def printable(text: object) -> str:
    """`text` in one line of at most 1500 characters, of which a terminal obeys none and UTF-8 holds all."""
    line = " ".join(str(text).split())
    line = line if len(line) <= _LONGEST else f"{line[:_LONGEST]}…"
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in line)


_NO_MEMORY = (
    "defaultcpuallocator",
    "bad_alloc",
    "out of memory",
    "insufficient memory",
    "allocate memory",
    "allocate section memory",
    "not enough memory",
    "failed to map segment",
)
# What the machine refuses, as opposed to what a bug asks for: named in one line, without a traceback.
_REFUSALS = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
_REFUSALS |= {errno.ENAMETOOLONG, errno.ELOOP}


def one_line(error: BaseException) -> str:
    """What to tell the user of an error in one line: a wrong input, or what the machine refused; "" for a bug."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.errno in _REFUSALS:
        return f"{error.filename or 'a file'}: {error.strerror}; finished work is kept"
    return ""


def out_of_memory(error: BaseException) -> bool:
    """Whether a lack of memory is what failed, or lies behind it: numpy's, torch's, OpenCV's, LLVM's, the system's."""
    behind: BaseException | None = error
    while behind is not None:
        if isinstance(behind, InputError):
            return False
        # torch's OutOfMemoryError, of a GPU, is no MemoryError.
        if isinstance(behind, MemoryError) or type(behind).__name__ == "OutOfMemoryError":
            return True
        if isinstance(behind, OSError) and behind.errno == errno.ENOMEM:
            return True
        if says_no_memory(str(behind)):
            return True
        limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        if limited and "can't start new thread" in str(behind):  # there is no room for its stack
            return True
        behind = behind.__cause__ or behind.__context__
    return False


def says_no_memory(message: str) -> bool:
    """Whether a library's message says that memory ran out."""
    return any(words in message.lower() for words in _NO_MEMORY)


def interruption(error: BaseException) -> KeyboardInterrupt | None:
    """The interruption that `error` is, or that lies behind it; None where there is none.

    A signal that arrives within a compiled function comes out of it as a SystemError.
    """
    behind: BaseException | None = error
    while behind is not None and not isinstance(behind, KeyboardInterrupt):
        behind = behind.__cause__ or behind.__context__
    return behind


class Interrupted(KeyboardInterrupt):
    """A signal asked the process to end; `number` is the signal's."""

    def __init__(self, number: int):
        self.number = number
        super().__init__(number)


class Status(StrEnum):
    """How a run ended. Every value but `OK` is a typed failure that a table shows by name."""

    OK = "ok"
    DIVERGED = "diverged"
    OUT_OF_MEMORY = "out_of_memory"
    OUT_OF_TIME = "out_of_time"
    CRASHED = "crashed"
    INTERRUPTED = "interrupted"


class Ended(Exception):
    """A method couldn't go on: a numerical or practical outcome of a run, as opposed to a bug. status: not `ok`."""

    def __init__(self, status: Status, message: str):
        self.status = status
        super().__init__(message)
