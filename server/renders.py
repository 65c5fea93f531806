"""The bounded pool of threads that frames are rendered on, off the event loop. What is asked for twice is done once."""

import asyncio
import threading
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from server.turns import Rank, Turns

Result = TypeVar("Result")

DRAFT, REST, ASKED, REFINED = 0.0, 0.1, 0.4, 0.8
"""Seconds that work may wait for a thread before it goes first: drafts of a view that moves, the first picture of one
at rest, pictures that were asked for once, and pictures that are better than the one already shown."""


@dataclass(eq=False)
class Flight:
    """Work that ``waiting`` callers share; ``cancelled`` is set once none is left."""

    task: "asyncio.Task[Any]"
    cancelled: threading.Event = field(default_factory=threading.Event)
    waiting: int = 0


class Renders:
    """Runs blocking work, so much at once, and stops it when nobody waits for it any more."""

    def __init__(self, threads: int) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._turns = Turns(threads)
        self._flights: dict[Hashable, Flight] = {}

    async def run(self, work: Callable[[], Result], rank: Rank) -> Result:
        """The work's result, or what it raises; BusyError where its ``rank`` gives up before it has its turn.

        Work that has begun is waited for though nobody asks for its result any more: it has the thread until then.
        What it logs has the id of the request that asked, for work that is shared of the first.
        """
        async with self._turns.turn(rank):
            working = asyncio.get_running_loop().run_in_executor(self._pool, copy_context().run, work)
            try:
                return await asyncio.shield(working)
            except asyncio.CancelledError:
                await asyncio.gather(working, return_exceptions=True)
                raise

    async def share(self, key: Hashable, work: Callable[[threading.Event], Result], rank: Rank) -> Result:
        """The result of the work that goes by ``key``: done once for all that ask for it meanwhile.

        The event that the work is given is set once all of them have been cancelled.
        """
        flight = self._flights.get(key) or self._begin(key, work, rank)
        flight.waiting += 1
        try:
            return await asyncio.shield(flight.task)
        finally:
            flight.waiting -= 1
            if not flight.waiting:
                self._end(key, flight)

    def close(self) -> None:
        """Take no more work; what still waits is dropped."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _begin(self, key: Hashable, work: Callable[[threading.Event], Any], rank: Rank) -> Flight:
        cancelled = threading.Event()
        task = asyncio.create_task(self.run(lambda: work(cancelled), rank))
        self._flights[key] = flight = Flight(task, cancelled)
        task.add_done_callback(lambda _: self._land(key, flight))
        return flight

    def _land(self, key: Hashable, flight: Flight) -> None:
        """Nobody joins what is over."""
        if self._flights.get(key) is flight:
            del self._flights[key]

    def _end(self, key: Hashable, flight: Flight) -> None:
        """Stop a flight that nobody waits for."""
        self._land(key, flight)
        flight.cancelled.set()
        flight.task.cancel()
