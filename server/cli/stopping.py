"""Stopping a server that is still starting, at once and without a trace."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.util import _run_finalizers  # type: ignore[attr-defined]
from typing import Any

STOPPED = "isogi: stopped before it was ready"
"""What a server says that is stopped while it starts."""

SIGNALS = (signal.SIGTERM, signal.SIGINT)
"""What stops a server."""


def leave() -> None:
    """End the process now, and before it the processes that it started, which may themselves be
    starting; then their semaphores are given back, which Python would report as leaked.
    """
    import psutil  # noqa: PLC0415 (other commands start without it)

    tracker = getattr(resource_tracker._resource_tracker, "_pid", None)
    try:
        for each in psutil.Process().children(recursive=True):
            if each.pid != tracker:
                with suppress(psutil.Error):
                    each.kill()
        _run_finalizers(0)
    finally:
        os._exit(0)


@contextmanager
def stopped_at_once() -> Iterator[None]:
    """Have SIGTERM and SIGINT end the process at once, in one line and with the exit status 0, for
    the block, or until the server listens to them itself.
    """

    def stop(*_: Any) -> None:
        # Text streams may be at work where the signal comes: they cannot be written to twice.
        os.write(2, f"{STOPPED}\n".encode())
        leave()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [(number, signal.signal(number, stop)) for number in SIGNALS]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
