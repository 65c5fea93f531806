"""The bounded pool of threads that frames are rendered on, off the event loop."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from fastapi import Request

from server.errors import BusyError

Result = TypeVar("Result")


class Renders:
    """Runs blocking work for requests, so many at once, and stops it when its client leaves."""

    def __init__(self, threads: int, queue: int) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._limit = threads + queue
        self._open = 0

    async def run(self, request: Request, work: Callable[[threading.Event], Result]) -> Result:
        """The work's result. The event that the work is given is set once the client is gone.

        Raises BusyError where too many wait already, and what the work raises.
        """
        if self._open >= self._limit:
            raise BusyError(f"{self._open} frames wait already: ask again in a second.")
        self._open += 1
        cancelled = threading.Event()
        future = asyncio.get_running_loop().run_in_executor(self._pool, work, cancelled)
        watcher = asyncio.create_task(gone(request))
        try:
            both: set[asyncio.Future[Any]] = {future, watcher}
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            cancelled.set()
            return await future
        finally:
            cancelled.set()
            watcher.cancel()
            self._open -= 1

    def close(self) -> None:
        """Take no more work; what still waits is dropped."""
        self._pool.shutdown(wait=False, cancel_futures=True)


async def gone(request: Request) -> None:
    """Returns when the client has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
