"""COLMAP's Python binding, without the handler for SIGTERM that its import installs.

That handler prints a stack trace and aborts. A command that is asked to end must run its `finally` blocks instead.
"""

import signal
import threading

import pycolmap

if threading.current_thread() is threading.main_thread():  # no other thread may set a handler
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))

__all__ = ["pycolmap"]
