"""Turns: who works next where only so many may at once."""

import asyncio
import heapq
import itertools
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import NamedTuple

from server.errors import BusyError


class Rank(NamedTuple):
    """Where work stands in the queue: before all that is ``due`` later. It gives up at ``until``.

    Both are seconds on the event loop's clock. All turns of one request have its rank, so that what was begun is ended
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


class Turns:
    """So many ``places``. Who waits comes in the order of their ranks, so that nobody waits forever."""

    def __init__(self, places: int) -> None:
        self._free = places
        self._waiting: list[tuple[float, int, asyncio.Future[None]]] = []
        self._count = itertools.count()

    @asynccontextmanager
    async def turn(self, rank: Rank) -> AsyncIterator[None]:
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
        """Have the next come in the place of one that left when it was just given to it."""
        if place.done() and not place.cancelled():
            self._pass_on()

    def _pass_on(self) -> None:
        """Give a place to whoever is due first; those that left meanwhile are passed over."""
        while self._waiting:
            _, _, place = heapq.heappop(self._waiting)
            if not place.done():
                place.set_result(None)
                return
        self._free += 1
