"""Stopping a server that is still starting: at once, and without a traceback."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.util import _run_finalizers  # type: ignore[attr-defined]
from typing import Any

STOPPED = "isogi: stopped before it was ready"
"""Message of a server that is stopped while it starts."""

SIGNALS = (signal.SIGTERM, signal.SIGINT)
"""Signals that stop a server."""


def leave() -> None:
    """Kill all child processes, which may still be starting, release semaphores that Python
    would report as leaked, remove the folder of the fork server's socket, and exit.
    """
    import psutil  # noqa: PLC0415 (other commands start without it)

    # Spare the resource tracker of Python, which cleans up shared memory after this process.
    tracker = getattr(resource_tracker._resource_tracker, "_pid", None)
    try:
        for each in psutil.Process().children(recursive=True):
            if each.pid != tracker:
                with suppress(psutil.Error):
                    each.kill()
        _run_finalizers()
    finally:
        os._exit(0)


@contextmanager
def stopped_at_once() -> Iterator[None]:
    """Have SIGTERM and SIGINT end the process at once, with one line and the exit status 0: in the
    block, or until the server handles them itself.
    """

    def stop(*_: Any) -> None:
        # A text stream may be in use when the signal comes: it cannot be entered twice.
        os.write(2, f"{STOPPED}\n".encode())
        leave()

    # Only the main thread may set handlers; others, as in tests, leave them.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [(number, signal.signal(number, stop)) for number in SIGNALS]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
