"""The two ways in which a call can go wrong that are not bugs."""

from __future__ import annotations

from enum import StrEnum


class InputError(ValueError):
    """The user's mistake: one line that names the file, what was found and what was expected.

    The command line prints it and exits with status 2; it never shows a traceback for it.
    """

    def __init__(self, subject: object, found: str, expected: str):
        self.subject, self.found, self.expected = str(subject), found, expected
        super().__init__(f"{subject}: found {found}, expected {expected}")


class Status(StrEnum):
    """How a run ended. Every value but `OK` is a typed failure that a table shows by name."""

    OK = "ok"
    DIVERGED = "diverged"
    OUT_OF_MEMORY = "out_of_memory"
    OUT_OF_TIME = "out_of_time"
    CRASHED = "crashed"
