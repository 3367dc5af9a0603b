"""Where the installed program begins: from here on Ctrl-C is one line, also while modules are imported."""

from __future__ import annotations

import os
import signal


def stop_at_once(number: int, frame: object) -> None:
    """Handle a signal before there is anything to clean up."""
    os.write(2, b"dofbench: interrupted\n")
    os._exit(128 + number)


def run() -> None:
    """Run the command line and end the process. Its imports take most of the first half second."""
    signal.signal(signal.SIGINT, stop_at_once)
    from dofbench.cli.app import console

    console()
