"""Long calls into COLMAP: beside the main thread, so that it can say how far they are and be interrupted."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

# Seconds between two looks at how far a call is.
_LOOK = 0.2

Wait = Callable[[Callable[[], Any]], Any]


def wait(call: Callable[[], Any], look: Callable[[], None] | None = None) -> Any:
    """Run `call` in a thread and return what it returns, raising what it raises. look: called now and then meanwhile.

    An interruption of the main thread is raised at once; the thread is left to end with the process, which is why
    whatever it writes must be fit to be cut off.
    """
    result: list[Any] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            result.append(call())
        except BaseException as error:  # raised again in the main thread
            failure.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(_LOOK)
        if look is not None:
            look()
    if failure:
        raise failure[0]
    return result[0]
