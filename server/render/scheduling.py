"""Scheduling: which work renders next, how much at once, and the threads it renders on."""

import asyncio
import heapq
import itertools
import math
import threading
from collections.abc import AsyncIterator, Callable, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from contextvars import copy_context
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from server.errors import BusyError


class Rank(NamedTuple):
    """Where work stands in the queue: before all that is ``due`` later. It gives up at ``until``.

    Both are seconds on the event loop's clock. All places of one request have its rank, so that what was begun is ended
    before the next begins.
    """

    due: float
    until: float = math.inf

    @classmethod
    def within(cls, patience: float, longest: float = math.inf) -> "Rank":
        """That of work which can wait for ``patience`` seconds from now, and waits for ``longest`` at most."""
        now = asyncio.get_running_loop().time()
        return cls(now + patience, now + longest)

    @property
    def begun(self) -> "Rank":
        """The same for work that was begun: it does not give up any more."""
        return Rank(self.due)


class PrioritySemaphore:
    """So many ``places``; the lowest rank comes first, so that nothing waits forever."""

    def __init__(self, places: int) -> None:
        self._free = places
        self._waiting: list[tuple[float, int, asyncio.Future[None]]] = []
        self._count = itertools.count()

    @asynccontextmanager
    async def place(self, rank: Rank) -> AsyncIterator[None]:
        """A place for the block. Raises BusyError where there is none until the rank gives up."""
        if self._free:
            self._free -= 1
        else:
            await self._wait(rank)
        try:
            yield
        finally:
            self._pass_on()

    async def _wait(self, rank: Rank) -> None:
        place: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (rank.due, next(self._count), place))
        try:
            async with asyncio.timeout_at(None if math.isinf(rank.until) else rank.until):
                await place
        except asyncio.CancelledError:
            self._leave(place)
            raise
        except TimeoutError:
            self._leave(place)
            raise BusyError("The frames that were asked for before take too long: ask again in a while.") from None

    def _leave(self, place: "asyncio.Future[None]") -> None:
        """Pass on the place of one that left when it was just given it."""
        if place.done() and not place.cancelled():
            self._pass_on()

    def _pass_on(self) -> None:
        """Give a place to the one that is due first; those that left meanwhile are passed over."""
        while self._waiting:
            _, _, place = heapq.heappop(self._waiting)
            if not place.done():
                place.set_result(None)
                return
        self._free += 1


class AdmissionLimit:
    """Lets ``most`` through at once; ``what`` names them in the sentence for those that are too many."""

    def __init__(self, most: int, what: str) -> None:
        self.most, self.what = most, what
        self.open = 0

    @contextmanager
    def admitted(self) -> Iterator[None]:
        """Around one of them. Raises BusyError where as many are inside as may be."""
        if self.open >= self.most:
            raise BusyError(f"{self.open} {self.what} already: ask again in a second.")
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1


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
    """Runs blocking work, so much at once, and stops it when no caller waits for it any more."""

    def __init__(self, threads: int) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._places = PrioritySemaphore(threads)
        self._flights: dict[Hashable, Flight] = {}

    async def run(self, work: Callable[[], Result], rank: Rank) -> Result:
        """The work's result, or what it raises; BusyError where its ``rank`` gives up before it has a place.

        Work that has begun is waited for though its caller was cancelled: it has the thread until then.
        What it logs has the id of the request that asked, for work that is shared of the first.
        """
        async with self._places.place(rank):
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
        """Have nothing join work that is over."""
        if self._flights.get(key) is flight:
            del self._flights[key]

    def _end(self, key: Hashable, flight: Flight) -> None:
        """Stop a flight that no caller waits for."""
        self._land(key, flight)
        flight.cancelled.set()
        flight.task.cancel()
