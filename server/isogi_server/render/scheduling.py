"""Scheduling: the order in which work renders, the number of works at a time, and the threads
that run them.
"""

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
from isogi_server.errors import BusyError
from isogi_worker.bake_requests import Account, FairClock

USUAL_WORK_SECONDS = 0.02
"""Seconds that a client's work is expected to take before any has ended."""

NEWEST_WORK_WEIGHT = 0.3
"""Weight of a client's newest work in the running mean of the time that its work takes."""

DEBT = 2.0
"""Seconds by which a client may be behind the others for work that it had before, at most:
nobody waits for long because of the past.
"""


@dataclass(eq=False)
class Client(Account):
    """A client of a queue. Its turn comes when it has used less time than all other clients that
    wait.

    Its work ``usual``-ly takes this many seconds, a running mean. ``open`` counts its works that
    wait or run. It has a ``claim`` while it waits, and keeps it if it leaves the queue before it
    gets a place: its next work then takes over the rank of the one that left.
    """

    usual: float = USUAL_WORK_SECONDS
    claim: bool = False
    open: int = 0


@dataclass(eq=False)
class Rank:
    """The rank of work in the queue: by its ``client``, then before what the same client has
    ``due`` later.

    It gives up at ``until``; both are seconds on the event loop's clock. All places that one
    request takes share its rank, and so the ``turn`` of the first place: a request that has begun
    ends before the next one begins.
    """

    due: float
    until: float = math.inf
    client: Client = field(default_factory=Client)
    turn: float | None = None

    @classmethod
    def within(
        cls, patience: float, longest: float = math.inf, client: Client | None = None
    ) -> "Rank":
        """Return the rank of work that can wait for ``patience`` seconds from now, and gives up
        after ``longest`` seconds.
        """
        now = asyncio.get_running_loop().time()
        return cls(now + patience, now + longest, client or Client())

    @property
    def begun(self) -> "Rank":
        """Return the rank of this work once it has begun: it does not give up any more."""
        return replace(self, until=math.inf)

    @property
    def order(self) -> tuple[float, float]:
        """Return the sort key of this rank: the lowest comes first."""
        return self.client.spent if self.turn is None else self.turn, self.due


FRAMES_WAIT = "The frames that were asked for before take too long: ask again in a while."


class FairSemaphore:
    """A semaphore with a number of ``places``, which clients share evenly by the time that their
    work takes: see ``FairClock``.

    While other work is ``pressed`` (it must run first), no place is granted if another one is
    taken. If turns are ``even``, each work counts the same, however long it takes.
    """

    def __init__(
        self,
        places: int,
        pressed: Callable[[], bool] = lambda: False,
        even: bool = False,
        late: str = FRAMES_WAIT,
    ) -> None:
        """Create a semaphore with all ``places`` free. ``late`` is the error message for work
        that waited in vain.
        """
        self._places = self._free = places
        self._pressed = pressed
        self._even = even
        self._late = late
        self._clock = FairClock(DEBT)
        self._waiting: list[tuple[Rank, asyncio.Future[None]]] = []

    @asynccontextmanager
    async def place(self, rank: Rank) -> AsyncIterator[None]:
        """Take a place for the block, as soon as it is this rank's turn. Raises BusyError if
        the rank gives up before.
        """
        client = rank.client
        # A client that comes from rest starts level with the one served now, as it has saved
        # nothing up. One that left the queue without a place still has its ``claim``, which only
        # ``_paid`` clears, and so the rank it had.
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
        """Return True if any work waits."""
        return any(not granted.done() for _, granted in self._waiting)

    def at_rest(self, client: Client) -> bool:
        """Return True if a client neither waits nor works, and is not ahead of the clock."""
        return not (client.open or self._clock.is_ahead(client))

    @contextmanager
    def _paid(self, rank: Rank) -> Iterator[None]:
        """Charge the client for the block: its usual time at the beginning, and the difference to
        the time that it took at the end.

        Charging ahead keeps a client from taking many places before the first of its works has
        ended.
        """
        client = rank.client
        loop = asyncio.get_running_loop()
        begun = loop.time()
        usual = client.usual
        client.claim = False
        # The first place of a request sets its turn; later places of the same request reuse it.
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
            # Correct the charge, and the running mean of the client's usual time.
            client.usual += NEWEST_WORK_WEIGHT * (took - usual)
            self._clock.charge(client, took - usual)

    async def _wait(self, rank: Rank) -> None:
        """Wait until this rank gets a place. Raises BusyError if it gives up before."""
        granted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((rank, granted))
        self._pass_on()
        try:
            async with asyncio.timeout_at(None if math.isinf(rank.until) else rank.until):
                await granted
        except asyncio.CancelledError:
            self._leave(granted)
            raise
        except TimeoutError:
            self._leave(granted)
            raise BusyError(self._late) from None

    def _leave(self, granted: "asyncio.Future[None]") -> None:
        """Give a place back if it was ``granted`` at the moment that its work gave up or was
        cancelled.
        """
        if granted.done() and not granted.cancelled():
            self._give_back()

    def _give_back(self) -> None:
        """Free a place, and grant it to the rank that is next."""
        self._free += 1
        self._pass_on()

    def _pass_on(self) -> None:
        """Grant free places to waiting work, the lowest ``Rank.order`` first."""
        # Drop work that was cancelled, or gave up, while it waited.
        self._waiting = [(rank, granted) for rank, granted in self._waiting if not granted.done()]
        # If other work must run first, grant a single place, and only if none is taken.
        while self._waiting and self._free and (self._free == self._places or not self._pressed()):
            first = min(self._waiting, key=lambda each: each[0].order)
            self._waiting.remove(first)
            self._free -= 1
            _, granted = first
            granted.set_result(None)


class Room(FairSemaphore):
    """Places that works hold until their results are out of memory. Time in them does not count as
    time of the client: it counts on the threads.
    """

    async def enter(self, rank: Rank) -> "Entered":
        """Wait for a place, to be left by the caller. Raises BusyError if the rank gives up
        before.
        """
        await self._wait(rank)
        return Entered(self._give_back)


@dataclass(eq=False)
class Entered:
    """A place in a ``Room``; leaving it twice is no error."""

    _give_back: Callable[[], None] | None = None

    def leave(self) -> None:
        """Give the place back."""
        if self._give_back is not None:
            self._give_back()
            self._give_back = None


Result = TypeVar("Result")

DRAFT = 0.0
REST_PATIENCE = 0.1
REQUEST_PATIENCE = 0.4
REFINEMENT_PATIENCE = 0.8
"""Seconds for which work may wait before it goes ahead of the rest of its client's work: drafts
of a view that moves, the first picture of a view at rest, pictures of single requests, and
pictures that refine one already shown.
"""


@dataclass(eq=False)
class Flight:
    """Work that ``waiting`` callers share. ``cancelled`` is set once no caller is left."""

    task: "asyncio.Task[Any]"
    cancelled: threading.Event
    waiting: int = 0


class Renders:
    """Runs blocking work on a thread pool, in fair order, and stops work that no caller waits
    for any more.
    """

    def __init__(
        self,
        threads: int,
        pressed: Callable[[], bool] = lambda: False,
        even: bool = False,
        late: str = FRAMES_WAIT,
    ) -> None:
        """Run up to ``threads`` works at a time, but one while other work is ``pressed``. Turns
        count by time, or the same each if ``even``. ``late`` is the error message for work that
        waited in vain.
        """
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._places = FairSemaphore(threads, pressed, even, late)
        self._flights: dict[Hashable, Flight] = {}
        self._clients: dict[Hashable, Client] = {}

    @property
    def crowded(self) -> bool:
        """Return True if any work waits for its turn."""
        return self._places.crowded

    def client(self, name: Hashable, weight: float) -> Client:
        """Return the client of this ``name``, created with a ``weight`` if it is new; clients
        at rest are then forgotten.
        """
        if name not in self._clients:
            # Forget clients at rest now, so that the table does not grow with every address.
            self._clients = {
                each: kept for each, kept in self._clients.items() if not self._places.at_rest(kept)
            }
            self._clients[name] = Client(weight)
        return self._clients[name]

    async def run(self, work: Callable[[], Result], rank: Rank) -> Result:
        """Run blocking work on a thread when its ``rank`` gets a place; return its result, or raise
        its error. Raises BusyError if the rank gives up before.

        If the caller is cancelled, work that has begun is awaited all the same, as it holds its
        thread until it ends. Log records of the work have the id of the request that asked for it;
        work that is shared has that of the first request.
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
                # An error in the future would hold itself, and all arrays in its traceback, until
                # garbage is collected.
                del working

    async def share(
        self, key: Hashable, work: Callable[[threading.Event], Result], rank: Rank
    ) -> Result:
        """Return the result of the work with this ``key``, done once for all callers that ask for
        it meanwhile.

        ``work`` gets an event that is set once all callers were cancelled. A caller whose rank
        never gives up does not join work that may give up.
        """
        # Join a flight, or start one.
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
        """Accept no more work, and drop work that still waits."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _begin(self, key: Hashable, work: Callable[[threading.Event], Any], rank: Rank) -> Flight:
        """Start shared work as a flight that further callers of its key join."""
        task, cancelled = self._start(work, rank)
        self._flights[key] = flight = Flight(task, cancelled)
        task.add_done_callback(lambda _: self._land(key, flight))
        return flight

    def _start(
        self, work: Callable[[threading.Event], Any], rank: Rank
    ) -> tuple["asyncio.Task[Any]", threading.Event]:
        """Return a task that runs some ``work``, and the event that cancels the work."""
        cancelled = threading.Event()
        return asyncio.create_task(self.run(lambda: work(cancelled), rank)), cancelled

    def _land(self, key: Hashable, flight: Flight) -> None:
        """Remove a flight that is over, so that no caller joins it."""
        if self._flights.get(key) is flight:
            del self._flights[key]

    def _end(self, key: Hashable, flight: Flight) -> None:
        """Cancel a flight that no caller waits for."""
        self._land(key, flight)
        flight.cancelled.set()
        flight.task.cancel()


class Passes(Interruption):
    """The passes of long work on a thread, and the event that cancels it.

    The event loop begins each pass, and the thread ends it by ``give_way``.
    """

    def __init__(self) -> None:
        """Create the state before the first pass, within a running event loop."""
        super().__init__()
        self.ended = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._begun = threading.Event()

    def begin(self) -> None:
        """Begin the next pass. ``ended`` is set at its end. For the event loop."""
        self.ended.clear()
        self._begun.set()

    def give_way(self) -> None:
        """End a pass; return when the next pass begins, or the work is cancelled. For the
        thread of the work.
        """
        self._begun.clear()
        if not self.is_set():
            self._loop.call_soon_threadsafe(self.ended.set)
            self._begun.wait()

    def set(self) -> None:
        """Cancel the work, also if it waits between two passes."""
        super().set()
        self._begun.set()


MAX_LONG_WORKS = 4
"""Long works that are begun at a time, each of another client."""

LONG_WORK_WAITS = (
    "Path-traced pictures that were asked for before take too long: ask again in a while, or for "
    "fewer pixels or samples."
)


class LongRenders(Renders):
    """Runs long work, such as path-traced pictures, in passes: one pass at a time, in turns by time
    among the works that have begun.

    Work that has begun keeps its memory until it ends. So each client has one work begun at a time,
    and a limited number of clients have any.
    """

    def __init__(self, most: int = MAX_LONG_WORKS) -> None:
        """Begin ``most`` works at a time."""
        super().__init__(most)
        self._places = FairSemaphore(1)
        self._most = most
        self._at_work: set[Client] = set()
        self._waiting: list[tuple[Client, asyncio.Future[None]]] = []

    def close(self) -> None:
        """Accept no more work, and cancel all that has begun."""
        for flight in self._flights.values():
            flight.cancelled.set()
        super().close()

    def _start(
        self, work: Callable[[threading.Event], Any], rank: Rank
    ) -> tuple["asyncio.Task[Any]", threading.Event]:
        """Return a task that runs some ``work`` in passes, and the passes, whose ``set``
        cancels it.
        """
        passes = Passes()
        return asyncio.create_task(self._run(work, passes, rank)), passes

    async def _run(
        self, work: Callable[[threading.Event], Result], passes: Passes, rank: Rank
    ) -> Result:
        """Run work pass by pass: each pass takes a separate place. Return its result. Raises
        BusyError if the rank gives up before the work begins.
        """
        loop = asyncio.get_running_loop()
        # Each work takes its turns as a separate client. A fresh rank for each pass has the pass
        # charged by its time.
        turns = replace(rank.begun, client=Client(rank.client.weight), turn=None)
        # The thread of the work lives through all passes, and waits between them in ``give_way``.
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
        """Wait until the client's work may begin, first come, first served; for the block it
        counts as the one begun work of its client. Raises BusyError if the rank gives up
        before.
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
            # Free the slot of a work that had begun, or leave the queue, and let the next one in.
            if begun.done() and not begun.cancelled():
                self._at_work.discard(rank.client)
            else:
                begun.cancel()
            self._let_in()

    def _let_in(self) -> None:
        """Let waiting works begin: each if fewer than the limit are at work, and none of its
        client.
        """
        self._waiting = [each for each in self._waiting if not each[1].done()]
        for client, begun in self._waiting:
            if len(self._at_work) < self._most and client not in self._at_work:
                self._at_work.add(client)
                begun.set_result(None)


PLACE_LOST = "Another client needed this place, and you have {places} more: ask again in a while."


@dataclass(eq=False)
class Place:
    """A place of an ``owner`` below an ``AdmissionLimit``, ``used`` last at this time of the event
    loop.

    It is ``lost`` if another client took it; ``others`` is then the number of places that the owner
    still has.
    """

    owner: Hashable
    used: float
    lost: bool = False
    others: int = 0
    _task: "asyncio.Task[Any] | None" = None

    def use(self) -> None:
        """Note that its owner uses it now: idle places are lost first."""
        self.used = asyncio.get_running_loop().time()

    def lose(self, others: int) -> None:
        """Mark the place as lost, and cancel the work that needs it."""
        self.lost = True
        self.others = others
        if self._task:
            self._task.cancel()

    def check(self) -> None:
        """Raise BusyError if the place is lost."""
        if self.lost:
            raise BusyError(PLACE_LOST.format(places=self.others), "crowd")

    async def keep(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Return the result of some work that needs the place. Raises BusyError if the place is
        lost, once the work has been cancelled.
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
            # A cancellation that came from the loss of the place is an error of this request; any
            # other one goes on to the caller.
            if self.lost and task.uncancel() <= before:
                self.check()
            raise
        finally:
            self._task = None


class AdmissionLimit:
    """Admits ``most`` places at a time, shared fairly among their owners. ``what`` names them in
    the error message of BusyError.

    If all places are taken, a newcomer takes one from the owner that has most, provided that this
    owner still has at least as many as the newcomer then. So one owner may have all places until
    others ask. The place that was idle longest is taken; if places hold ``work``, the newest, whose
    loss costs least.
    """

    def __init__(self, most: int, what: str, work: bool = False) -> None:
        self.most = most
        self.what = what
        self._work = work
        self._places: list[Place] = []

    @property
    def open(self) -> int:
        """Return the number of places that are taken."""
        return len(self._places)

    @contextmanager
    def admitted(self, owner: Hashable) -> Iterator[Place]:
        """Hold a place for the block. Raises BusyError if there is none for this owner."""
        place = self.enter(owner)
        try:
            yield place
        finally:
            self.leave(place)

    def enter(self, owner: Hashable) -> Place:
        """Take a place, until ``leave``. Raises BusyError if there is none for this owner."""
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
        """Take a place from the owner that has most. Raises BusyError if the ``owner`` that
        asks would then have more.
        """
        counts = Counter(each.owner for each in self._places)
        # After the exchange the two owners have most - 1 and count + 1 places; the former must not
        # be less.
        most = max(counts.values(), default=0)
        if most < counts[owner] + 2:
            sentence = f"{self.open} {self.what} already: ask again in a second."
            raise BusyError(sentence, self.what.split()[0])
        of_greediest = [each for each in self._places if counts[each.owner] == most]
        # Places are listed in the order of their admission: the last is the newest.
        if self._work:
            given_up = of_greediest[-1]
        else:
            given_up = min(of_greediest, key=lambda each: each.used)
        self._places.remove(given_up)
        given_up.lose(most - 1)
