"""`dofbench view`: the viewer, until Ctrl-C."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.progress import Terminal, say
from dofbench.viewing.camera_paths import resized_to
from dofbench.viewing.gate import Gate
from dofbench.viewing.picture import Look, picture
from dofbench.viewing.subject import Subject, open_subjects
from dofbench.viewing.view_options import View
from dofbench.viewing.viewer import serve


def view(settings: View) -> bool:
    """Serve the viewer until the process is interrupted, which is how it ends well.

    Raises InputError for what can't be shown, and an address that isn't free.
    """
    # Who reads the address may interrupt at once, before the wait has begun.
    with viewing(settings) as address, suppress(KeyboardInterrupt):
        say(Console(), address)
        threading.Event().wait()
    return True


@contextmanager
def viewing(settings: View) -> Iterator[str]:
    """The viewer's address, during the block."""
    subjects = open_subjects(settings.what)
    with Terminal(Console(stderr=True)).uncounted("JIT compilation and warm-up"):
        _warm_up(subjects)
    behind = settings.token is not None
    server = serve(
        subjects,
        "127.0.0.1" if behind else settings.host,
        0 if behind else settings.port,
        settings.width,
        settings.keyframes,
    )
    gate = None
    try:
        if settings.token is None:
            yield f"http://{settings.host}:{server.get_port()}/"
            return
        try:
            gate = Gate(settings.host, settings.port, server.get_port(), settings.token)
        except OSError as error:
            raise InputError(
                f"{settings.host}:{settings.port}", str(error.strerror), "an address that is free"
            ) from None
        yield f"http://{settings.host}:{gate.port}/?token={settings.token}"
    finally:
        if gate is not None:
            gate.close()
        with redirect_stdout(io.StringIO()):
            server.stop()


def _warm_up(subjects: Sequence[Subject]) -> None:
    """Render each subject once by each path, so that the first picture in the browser needn't wait for compilers."""
    for subject in subjects:
        camera = resized_to(subject.photographs[0].camera, 64)
        look = Look(half_opening=subject.opening, focus_disparity=subject.bounds.q_min + 0.5 * subject.bounds.extent)
        for draft in (True, False):
            picture([subject], camera, look, draft=draft)
