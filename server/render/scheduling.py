"""Scheduling: which work renders next, how much at once, and the threads it renders on."""

import asyncio
import math
import threading
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from isogi_core.frame.tiles import Interruption
from server.errors import BusyError
from worker.bake_requests import Account, FairClock

USUAL_WORK_SECONDS = 0.02
"""Seconds that a client's work is taken to need before any has ended."""

NEWEST_WORK_WEIGHT = 0.3
"""How much the newest work of a client counts in what its work usually takes."""

DEBT = 2.0
"""Seconds by which a client may be behind the others for what it took before: nobody waits for long
for the past.
"""


@dataclass(eq=False)
class Client(Account):
    """One that has work done, and has its turn when it took less than all others that wait.

    Its work ``usual``-ly takes so many seconds. While it has a ``claim`` it waits, or left the
    queue before it had a place: what it brings next stands where that stood.
    """

    usual: float = USUAL_WORK_SECONDS
    claim: bool = False
    open: int = 0


@dataclass(eq=False)
class Rank:
    """Where work stands in the queue: by its ``client``, and before what else that client has
    ``due`` later.

    It gives up at ``until``. Both are seconds on the event loop's clock. All places of one request
    have its rank, and the turn of the first, so that what was begun is ended before the next
    begins.
    """

    due: float
    until: float = math.inf
    client: Client = field(default_factory=Client)
    turn: float | None = None

    @classmethod
    def within(
        cls, patience: float, longest: float = math.inf, client: Client | None = None
    ) -> "Rank":
        """The rank of work that can wait for ``patience`` seconds from now, and waits at most for
        ``longest``.
        """
        now = asyncio.get_running_loop().time()
        return cls(now + patience, now + longest, client or Client())

    @property
    def begun(self) -> "Rank":
        """The rank of this work once it has begun: it does not give up any more."""
        return replace(self, until=math.inf)

    @property
    def order(self) -> tuple[float, float]:
        """What is compared: the lowest comes first."""
        return self.client.spent if self.turn is None else self.turn, self.due


FRAMES_WAIT = "The frames that were asked for before take too long: ask again in a while."


class FairSemaphore:
    """So many ``places``, shared evenly among clients by the time that their work takes: see
    ``FairClock``.

    While others are ``pressed`` one place alone is given: that which ends passes on as many as may
    be by then. Where turns are ``even``, each counts alike however long it takes.
    """

    def __init__(
        self,
        places: int,
        pressed: Callable[[], bool] = lambda: False,
        even: bool = False,
        late: str = FRAMES_WAIT,
    ) -> None:
        """Give so many ``places``; ``late`` is the sentence for who waited for one in vain."""
        self._places = self._free = places
        self._pressed = pressed
        self._even = even
        self._late = late
        self._clock = FairClock(DEBT)
        self._waiting: list[tuple[Rank, asyncio.Future[None]]] = []

    @asynccontextmanager
    async def place(self, rank: Rank) -> AsyncIterator[None]:
        """A place for the block. Raises BusyError where there is none until the rank gives up."""
        client = rank.client
        if not client.claim and not client.open:
            self._clock.join(client)
        client.claim = True
        client.open += 1
        try:
            await self._wait(rank)
            try:
                with self._paid(rank):
                    yield
            finally:
                self._give_back()
        finally:
            client.open -= 1

    @property
    def crowded(self) -> bool:
        """Whether anybody waits."""
        return any(not place.done() for _, place in self._waiting)

    def at_rest(self, client: Client) -> bool:
        """Whether a client neither waits nor works, nor took more than the others."""
        return not (client.open or self._clock.is_ahead(client))

    @contextmanager
    def _paid(self, rank: Rank) -> Iterator[None]:
        """Have the client pay for the block: what is usual when it begins, and the rest at its
        end.
        """
        client = rank.client
        loop = asyncio.get_running_loop()
        begun = loop.time()
        usual = client.usual
        client.claim = False
        if rank.turn is None:
            rank.turn = client.spent
        self._clock.serve(rank.turn)
        self._clock.charge(client, usual)
        try:
            yield
        finally:
            if self._even:
                took = usual
            else:
                took = loop.time() - begun
            client.usual += NEWEST_WORK_WEIGHT * (took - usual)
            self._clock.charge(client, took - usual)

    async def _wait(self, rank: Rank) -> None:
        place: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((rank, place))
        self._pass_on()
        try:
            async with asyncio.timeout_at(None if math.isinf(rank.until) else rank.until):
                await place
        except asyncio.CancelledError:
            self._leave(place)
            raise
        except TimeoutError:
            self._leave(place)
            raise BusyError(self._late) from None

    def _leave(self, place: "asyncio.Future[None]") -> None:
        """Pass on the place of one that left when it was just given it."""
        if place.done() and not place.cancelled():
            self._give_back()

    def _give_back(self) -> None:
        self._free += 1
        self._pass_on()

    def _pass_on(self) -> None:
        """Give places to those whose turn it is; those that left meanwhile are passed over."""
        self._waiting = [each for each in self._waiting if not each[1].done()]
        while self._waiting and self._free and (self._free == self._places or not self._pressed()):
            first = min(self._waiting, key=lambda each: each[0].order)
            self._waiting.remove(first)
            self._free -= 1
            first[1].set_result(None)


class Room(FairSemaphore):
    """Places that work has until what it made is out of memory: its turn is paid for where it is
    done.
    """

    async def enter(self, rank: Rank) -> "Entered":
        """A place, until it is left. Raises BusyError where there is none until the rank gives
        up.
        """
        await self._wait(rank)
        return Entered(self._give_back)


@dataclass(eq=False)
class Entered:
    """A place in a room; leaving it twice is no error."""

    _give_back: Callable[[], None] | None = None

    def leave(self) -> None:
        """Give it back."""
        if self._give_back is not None:
            self._give_back()
            self._give_back = None


Result = TypeVar("Result")

DRAFT = 0.0
REST_PATIENCE = 0.1
REQUEST_PATIENCE = 0.4
REFINEMENT_PATIENCE = 0.8
"""Seconds that work may wait before it goes ahead of what else its client has: drafts of a view
that moves, the first picture of one at rest, pictures that were asked for once, and pictures that
are better than the one already shown."""


@dataclass(eq=False)
class Flight:
    """Work that ``waiting`` callers share; ``cancelled`` is set once none is left."""

    task: "asyncio.Task[Any]"
    cancelled: threading.Event
    waiting: int = 0


class Renders:
    """Runs blocking work, so much at once, and stops it when no caller waits for it any more."""

    def __init__(
        self,
        threads: int,
        pressed: Callable[[], bool] = lambda: False,
        even: bool = False,
        late: str = FRAMES_WAIT,
    ) -> None:
        """So many at once; one alone while other work is ``pressed``. Turns count by time, or if
        ``even`` alike; ``late`` is the sentence for work that waited in vain.
        """
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._places = FairSemaphore(threads, pressed, even, late)
        self._flights: dict[Hashable, Flight] = {}
        self._clients: dict[Hashable, Client] = {}

    @property
    def crowded(self) -> bool:
        """Whether any work waits for its turn."""
        return self._places.crowded

    def client(self, name: Hashable, weight: float) -> Client:
        """The client that goes by ``name``; those that are at rest are forgotten when another
        comes.
        """
        if name not in self._clients:
            self._clients = {
                each: kept for each, kept in self._clients.items() if not self._places.at_rest(kept)
            }
            self._clients[name] = Client(weight)
        return self._clients[name]

    async def run(self, work: Callable[[], Result], rank: Rank) -> Result:
        """The work's result, or what it raises; BusyError where its ``rank`` gives up before it has
        a place.

        Work that has begun is waited for though its caller was cancelled: it has the thread until
        then. What it logs has the id of the request that asked, for work that is shared of the
        first.
        """
        async with self._places.place(rank):
            working = asyncio.get_running_loop().run_in_executor(
                self._pool, copy_context().run, work
            )
            try:
                return await asyncio.shield(working)
            except asyncio.CancelledError:
                await asyncio.gather(working, return_exceptions=True)
                raise
            finally:
                # an error in it would hold itself, and all arrays on its way, until garbage is
                # looked for
                del working

    async def share(
        self, key: Hashable, work: Callable[[threading.Event], Result], rank: Rank
    ) -> Result:
        """The result of the work that goes by ``key``: done once for all that ask for it meanwhile.

        The event that the work is given is set once all of them have been cancelled. One that does
        not give up joins none that may.
        """
        key = key, rank.until == math.inf
        flight = self._flights.get(key) or self._begin(key, work, rank)
        flight.waiting += 1
        try:
            return await asyncio.shield(flight.task)
        finally:
            flight.waiting -= 1
            if not flight.waiting:
                self._end(key, flight)
            del flight  # see ``run``

    def close(self) -> None:
        """Take no more work; what still waits is dropped."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _begin(self, key: Hashable, work: Callable[[threading.Event], Any], rank: Rank) -> Flight:
        task, cancelled = self._start(work, rank)
        self._flights[key] = flight = Flight(task, cancelled)
        task.add_done_callback(lambda _: self._land(key, flight))
        return flight

    def _start(
        self, work: Callable[[threading.Event], Any], rank: Rank
    ) -> tuple["asyncio.Task[Any]", threading.Event]:
        """A task that does some ``work``, and what the work is cancelled by."""
        cancelled = threading.Event()
        return asyncio.create_task(self.run(lambda: work(cancelled), rank)), cancelled

    def _land(self, key: Hashable, flight: Flight) -> None:
        """Have nothing join work that is over."""
        if self._flights.get(key) is flight:
            del self._flights[key]

    def _end(self, key: Hashable, flight: Flight) -> None:
        """Stop a flight that no caller waits for."""
        self._land(key, flight)
        flight.cancelled.set()
        flight.task.cancel()


class Passes(Interruption):
    """The passes of some work on a thread: each begins when the event loop says so."""

    def __init__(self) -> None:
        """Before the first pass."""
        super().__init__()
        self.ended = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._begun = threading.Event()

    def begin(self) -> None:
        """Have the next pass begin; ``ended`` is set once it has ended."""
        self.ended.clear()
        self._begun.set()

    def give_way(self) -> None:
        """End a pass; return when the next one may begin, or the work is cancelled."""
        self._begun.clear()
        if not self.is_set():
            self._loop.call_soon_threadsafe(self.ended.set)
            self._begun.wait()

    def set(self) -> None:
        """Cancel the work, also between two passes."""
        super().set()
        self._begun.set()


MAX_LONG_WORKS = 4
"""Pieces of long work that are begun at once, each of another client."""

LONG_WORK_WAITS = (
    "Path-traced pictures that were asked for before take too long: ask again in a while, or for "
    "fewer pixels or samples."
)


class LongRenders(Renders):
    """Runs long work in passes, one pass at a time: clients that have some begun take turns, by
    time.

    A client has one piece of work begun at a time, and so many clients have any: what is begun
    keeps memory until it ends.
    """

    def __init__(self, most: int = MAX_LONG_WORKS) -> None:
        """None yet; ``most`` pieces of work may be begun."""
        super().__init__(most)
        self._places = FairSemaphore(1)
        self._most = most
        self._at_work: set[Client] = set()
        self._waiting: list[tuple[Client, asyncio.Future[None]]] = []

    def close(self) -> None:
        """Take no more work, and cancel all that is begun."""
        for flight in self._flights.values():
            flight.cancelled.set()
        super().close()

    def _start(
        self, work: Callable[[threading.Event], Any], rank: Rank
    ) -> tuple["asyncio.Task[Any]", threading.Event]:
        passes = Passes()
        return asyncio.create_task(self._run(work, passes, rank)), passes

    async def _run(
        self, work: Callable[[threading.Event], Result], passes: Passes, rank: Rank
    ) -> Result:
        """The result of some work, whose ``passes`` have a place each. Raises BusyError where it
        cannot begin until the rank gives up.
        """
        loop = asyncio.get_running_loop()
        turns = replace(rank.begun, client=Client(rank.client.weight), turn=None)
        async with self._begun(rank):
            working: asyncio.Future[Result] | None = None
            try:
                while working is None or not working.done():
                    async with self._places.place(replace(turns)):
                        passes.begin()
                        if working is None:
                            context = copy_context()
                            working = loop.run_in_executor(self._pool, context.run, work, passes)
                            working.add_done_callback(lambda _: passes.ended.set())
                        await passes.ended.wait()
                return await working
            except asyncio.CancelledError:
                passes.set()
                if working is not None:
                    await asyncio.gather(working, return_exceptions=True)
                raise
            finally:
                del working  # see ``run``

    @asynccontextmanager
    async def _begun(self, rank: Rank) -> AsyncIterator[None]:
        """Let the client's work begin, for the block: one of each client, first come, first
        served.
        """
        begun: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((rank.client, begun))
        self._let_in()
        try:
            try:
                async with asyncio.timeout_at(None if math.isinf(rank.until) else rank.until):
                    await begun
            except TimeoutError:
                raise BusyError(LONG_WORK_WAITS, "paths") from None
            yield
        finally:
            if begun.done() and not begun.cancelled():
                self._at_work.discard(rank.client)
            else:
                begun.cancel()
            self._let_in()

    def _let_in(self) -> None:
        """Let those begin that may."""
        self._waiting = [each for each in self._waiting if not each[1].done()]
        for client, begun in self._waiting:
            if len(self._at_work) < self._most and client not in self._at_work:
                self._at_work.add(client)
                begun.set_result(None)


PLACE_LOST = "Another client needed this place, and you have {places} more: ask again in a while."


@dataclass(eq=False)
class Place:
    """A place of an ``owner``, ``used`` last at this time of the event loop; ``lost`` once another
    client took it.

    The owner has ``others`` then.
    """

    owner: Hashable
    used: float
    lost: bool = False
    others: int = 0
    _task: "asyncio.Task[Any] | None" = None

    def use(self) -> None:
        """Note that its owner needs it now."""
        self.used = asyncio.get_running_loop().time()

    def lose(self, others: int) -> None:
        """Have it lost, and the work that needs it cancelled."""
        self.lost = True
        self.others = others
        if self._task:
            self._task.cancel()

    def check(self) -> None:
        """Raise BusyError where it was lost."""
        if self.lost:
            raise BusyError(PLACE_LOST.format(places=self.others), "crowd")

    async def keep(self, work: Coroutine[Any, Any, Result]) -> Result:
        """What some work comes to that needs the place. Raises BusyError once that is lost; the
        work has ended then.
        """
        if self.lost:
            work.close()
            self.check()
        self._task = task = asyncio.current_task()
        assert task
        before = task.cancelling()
        try:
            return await work
        except asyncio.CancelledError:
            if self.lost and task.uncancel() <= before:
                self.check()
            raise
        finally:
            self._task = None


class AdmissionLimit:
    """Lets ``most`` in at once; ``what`` names them in the sentence for one that is too many.

    Where all places are taken, a newcomer takes one of the owner that has most of them, if that
    leaves the owner no fewer than the newcomer has. The idlest place goes; where each is of some
    ``work``, the newest, in which least is lost. So one owner may have all places, until others
    ask.
    """

    def __init__(self, most: int, what: str, work: bool = False) -> None:
        self.most = most
        self.what = what
        self._work = work
        self._places: list[Place] = []

    @property
    def open(self) -> int:
        """How many are inside."""
        return len(self._places)

    @contextmanager
    def admitted(self, owner: Hashable) -> Iterator[Place]:
        """The place of one of them, for the block. Raises BusyError where there is none for this
        owner.
        """
        place = self.enter(owner)
        try:
            yield place
        finally:
            self.leave(place)

    def enter(self, owner: Hashable) -> Place:
        """A place, until ``leave``. Raises BusyError where there is none for this owner."""
        if len(self._places) >= self.most:
            self._make_room(owner)
        place = Place(owner, asyncio.get_running_loop().time())
        self._places.append(place)
        return place

    def leave(self, place: Place) -> None:
        """Give a place back, unless it was lost."""
        if place in self._places:
            self._places.remove(place)

    def _make_room(self, owner: Hashable) -> None:
        counts = Counter(each.owner for each in self._places)
        most = max(counts.values(), default=0)
        if most < counts[owner] + 2:
            sentence = f"{self.open} {self.what} already: ask again in a second."
            raise BusyError(sentence, self.what.split()[0])
        of_greediest = [each for each in self._places if counts[each.owner] == most]
        if self._work:
            given_up = of_greediest[-1]
        else:
            given_up = min(of_greediest, key=lambda each: each.used)
        self._places.remove(given_up)
        given_up.lose(most - 1)
