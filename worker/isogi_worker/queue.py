"""The queue: decides which chunk is baked next, and how far.

The requests of all live views are merged: a chunk that several views see is baked once, for all
texels that any of them wants. Clients take turns so that each gets as many processor seconds. In a
client's turn its newest view comes first. Within a view the order is:

1. chunks without light, of which a quarter of the texels is lit first;
2. chunks in which some texels have no light yet;
3. chunks in which a second of work removes most visible error from all pictures, weighted towards
   their centres, and among equals those nearest to final.

Patient clients come after all others. The queue has no threads and no clock of its own.
"""

import heapq
import itertools
import math
import operator
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.frame.demand import Demand
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.bake_requests import (
    GUEST_VIEWER,
    NO_INTEREST,
    PATH_SECONDS,
    SHORT_TASK_SECONDS,
    TASK_SECONDS,
    BakeRequest,
    Key,
    MergedInterest,
    Shares,
    Viewer,
    exceeds,
)
from isogi_worker.tasks import BakeResult

Rank = tuple[bool, int, int, float, float]
"""The rank of a request among those of a client: the smallest comes first.

Its members are: True if the request is suspect, the negative number of the client's view, the stage
of first light, the negative visible error that a second of work removes, and the paths left.
"""

Place = tuple[Rank, int, BakeRequest]
"""A request with its rank, and the ticket of its interest when it was put there."""

MIN_PLACES = 64
"""Number of places that a queue may always hold before outdated ones are removed."""


@dataclass(eq=False)
class ClientQueue:
    """The requests of one client: a heap of places.

    If there are more than ``most``, outdated ones are removed.
    """

    places: list[Place] = field(default_factory=list)
    most: int = MIN_PLACES

    def push(self, client: Hashable, place: Place) -> None:
        """Add a place."""
        heapq.heappush(self.places, place)
        # A place that is ranked again leaves its old place in the heap. Doubling the limit makes
        # the cost of removing these constant per place.
        if len(self.places) > self.most:
            self.places = [each for each in self.places if is_current(each, client)]
            heapq.heapify(self.places)
            self.most = 2 * len(self.places) + MIN_PLACES

    def pop(self, client: Hashable) -> Place | None:
        """Take out the first current place; None if there is none."""
        while self.places:
            place = heapq.heappop(self.places)
            if is_current(place, client):
                return place
        return None


class ClientQueues:
    """The queues of all clients that wait, those of patient clients apart."""

    def __init__(self) -> None:
        """Begin without clients."""
        self._queues: dict[bool, dict[Hashable, ClientQueue]] = {False: {}, True: {}}
        self._tickets = itertools.count(1)

    def clients(self, patient: bool) -> Collection[Hashable]:
        """Return the clients that may be waiting, patient ones or others."""
        return self._queues[patient].keys()

    def push(self, request: BakeRequest, client: Hashable, rank: Rank) -> None:
        """Put a request into a client's queue at this rank.

        Its former place there becomes outdated.
        """
        interest = request.interests[client]
        interest.ticket = next(self._tickets)
        queues = self._queues[interest.viewer.patient]
        queue = queues.get(client) or queues.setdefault(client, ClientQueue())
        queue.push(client, (rank, interest.ticket, request))

    def length(self, patient: bool, client: Hashable) -> int:
        """Return the number of places in a client's queue, outdated ones included: it serves a
        rough prediction of the work that waits, and to count current ones would take longer.
        """
        queue = self._queues[patient].get(client)
        if queue is None:
            return 0
        return len(queue.places)

    def pop(self, patient: bool, client: Hashable) -> tuple[Rank, BakeRequest] | None:
        """Take out the first request of a client's queue, with its rank.

        An empty queue is removed, and None returned.
        """
        place = self._queues[patient][client].pop(client)
        if place is None:
            del self._queues[patient][client]
            return None
        return place[0], place[2]


def is_current(place: Place, client: Hashable) -> bool:
    """Return True if this is the newest place of its request in the client's queue."""
    _, ticket, request = place
    interest = request.interests.get(client)
    return interest is not None and interest.ticket == ticket


STALE_SECONDS = 2.0
"""Seconds after a chunk was finished within which a view
that lacks its light is taken to have been drawn before that.
"""

FORGET_AFTER = 60.0
EXPIRY_CHECK_SECONDS = 1.0
"""Seconds after which a request that was not renewed expires,
and seconds between two checks for these.
"""

RERANK_GROWTH = 1.5
RERANK_LOSS = 1.0 / 3.0
"""Growth of a request's priority, and share of its loss, from which it is ranked again in the
queues of all its clients.

Below these it keeps its places, as a thousand clients may see one chunk.
"""


@dataclass(eq=False)
class BakeQueue:
    """Bake requests by chunk. Several threads must use it under one lock.

    ``shared`` says if two bakes have a layer in common. Of such bakes only one at a time may work
    on a chunk, as the last writer would undo the work of the other. ``rate`` gives the seconds that
    a path of a chunk takes, None if unknown.
    """

    clock: Callable[[], float]
    shared: Callable[[str, str], bool] = operator.eq
    rate: Callable[[Key], float | None] = lambda _: None
    requests: dict[Key, BakeRequest] = field(default_factory=dict)
    views: int = 0
    looked: float = -math.inf
    shares: Shares = field(default_factory=Shares)
    _queues: ClientQueues = field(default_factory=ClientQueues)
    _interesting: dict[Hashable, dict[Key, BakeRequest]] = field(default_factory=dict)
    _in_flight: dict[Index, set[str]] = field(default_factory=dict)
    _held: dict[Index, list[BakeRequest]] = field(default_factory=dict)
    _postponed: list[tuple[float, BakeRequest]] = field(default_factory=list)
    _finished: dict[Key, tuple[float, MergedInterest]] = field(default_factory=dict)
    _alone: bool = False
    _turn: tuple[bool, Hashable] = (False, "")

    def request(
        self,
        demands: Iterable[tuple[Key, Demand]],
        goal: Goal,
        viewer: Viewer = GUEST_VIEWER,
    ) -> set[Key]:
        """Add the demands of the newest view of a ``viewer``, for the ``goal`` of its picture.

        Return the keys that are left out: their light came within the last STALE_SECONDS, so that
        the view is taken to have been drawn before.
        """
        self._forget()
        stale = set[Key]()
        self.views += 1
        now = self.clock()
        for key, demand in demands:
            if key not in self.requests and self._has_come(key, demand, goal):
                stale.add(key)
                continue
            request = self.requests.get(key) or self.requests.setdefault(key, BakeRequest(key))
            if not request.given_up:
                request.add_interest(demand, goal, viewer, self.views, now)
                self._add_for(request, viewer.client)
        # A single viewer has left its older views: drop the requests that this view does not renew.
        if viewer.single:
            self._release(viewer, self.views)
        return stale

    def _has_come(self, key: Key, demand: Demand, goal: Goal) -> bool:
        """Return True if the light that is demanded
        of a chunk was finished within the last STALE_SECONDS.
        """
        when, done = self._finished.get(key, (-math.inf, NO_INTEREST))
        wanted = MergedInterest(demand.offsets, demand.footprints, goal)
        return self.clock() - when < STALE_SECONDS and not exceeds(wanted, done.offsets, done.goal)

    def leave(self, viewer: Viewer) -> None:
        """Drop the interests that a ``viewer`` was the last of its client to renew."""
        self._release(viewer, self.views + 1)

    def drop(self, bake: str) -> list[Key]:
        """Drop all requests of a ``bake``; return their keys."""
        dropped = [key for key in self.requests if key[0] == bake]
        for key in dropped:
            self._drop_all(self.requests[key])
        return dropped

    def take(self) -> BakeRequest | None:
        """Take the next request, and mark it as in flight; None if no request can start now.

        A suspect request, which may have killed a worker, comes last among those of its client and
        runs alone: it starts only if no task is in flight, and no other starts until its task has
        ended. So it harms no other, and if a worker dies again, the cause is known. If it is the
        next one while tasks are in flight, it stays in the queue, and None is returned.
        """
        self._forget()
        self._bring_back()
        if self._alone:
            return None
        # Go through clients by their turns, patient ones last, until one has a request that can be
        # worked on.
        for patient in (False, True):
            for client in self.shares.turns(self._queues.clients(patient)):
                request = self._first(patient, client)
                if request is not None:
                    self._turn = patient, client
                    return self._take(request, client)
        return None

    def take_along(self, first: BakeRequest, most: int, tasks: int = 1) -> list[BakeRequest]:
        """Take further requests for the task of the request that was just taken: at most ``most``
        texels, and TASK_SECONDS.

        They are the next ones of the same client, as long as these are of the same bake, goal and
        sample level. If the work left would not fill ``tasks`` tasks, it is shared evenly among
        them, so that all workers end at the same time.
        """
        taken = [first]
        left = most - len(first.next[0])
        seconds = self.seconds(first)
        patient, client = self._turn
        # Predict the client's waiting work from the first request, and share it among the tasks.
        waiting = seconds * (1 + self._queues.length(patient, client))
        most_seconds = min(max(waiting / tasks, SHORT_TASK_SECONDS), TASK_SECONDS)
        while (
            left > 0
            and seconds < most_seconds
            and not first.suspect
            and (found := self._first(patient, client))
        ):
            left = left - len(found.next[0])
            seconds = seconds + self.seconds(found)
            # This one does not fit any more: put it back, and stop.
            if left < 0 or seconds > most_seconds or not alike(first, found):
                self._rank_for(found, client)
                break
            self._start(found, client)
            taken.append(found)
        return taken

    def seconds(self, request: BakeRequest) -> float:
        """Return the seconds that the next task of a request is predicted to take."""
        return request.paths * (self.rate(request.key) or PATH_SECONDS)

    def rank(self, request: BakeRequest, client: Hashable) -> Rank:
        """Return the rank of a request among those of a client; the smallest comes first."""
        return request.suspect, -request.interests[client].view, *self._merits(request)

    def _merits(self, request: BakeRequest) -> tuple[int, float, float]:
        """Return the rank of a request among those of a view:
        stage of first light, visible error removed per second, work left.
        """
        return (
            request.stage,
            -request.priority / (self.rate(request.key) or 1.0),
            request.effort.left,
        )

    def finish(self, key: Key, offsets: np.ndarray, goal: Goal, result: BakeResult) -> None:
        """Take over the ``result`` of a task with a ``goal`` for the texels at ``offsets`` of a
        chunk.

        The request stays if work is left.
        """
        request = self.requests[key]
        self._end_task(request, result.cost.seconds)
        request.failures = 0
        request.suspect = False
        request.waited = 0.0
        # Views may have asked for more while the task was in flight.
        grown = request.exceeds(offsets, goal)
        if not request.interests:
            del self.requests[key]
        elif result.unfinished == 0 and not grown:
            # Remember the finished light for a while, as views drawn before may still ask for it.
            done = MergedInterest(request.offsets, request.footprints, goal)
            self._finished[key] = self.clock(), done
            self._drop_all(request)
        else:
            request.advance(result, grown)
            self._rank_everywhere(request)

    def wanted(self, bake: str) -> set[Index]:
        """Return the chunks of a ``bake`` whose requests are open."""
        return {
            index
            for (name, index), request in self.requests.items()
            if name == bake and not request.given_up
        }

    def is_busy(self, bake: str, index: Index) -> bool:
        """Return True if a task of a ``bake`` is in flight for a chunk."""
        return bake in self._in_flight.get(index, ())

    def renew(self, keys: Iterable[Key], viewer: Viewer = GUEST_VIEWER) -> None:
        """Renew the interest of a ``viewer`` in ``keys``."""
        claimed = self._interesting.get(viewer.client, {})
        for request in self.open(keys):
            if viewer.client in request.interests:
                request.interests[viewer.client].asked = self.clock()
                # Move the request to the end, so that a client's requests are in the order of their
                # age.
                claimed[request.key] = claimed.pop(request.key)

    def fail(self, key: Key, trouble: str, suspect: bool = False) -> bool:
        """Note that a task failed, for the reason ``trouble``. Return True if its chunk is given
        up, else it is tried again.

        With ``suspect`` its worker died.
        """
        request = self.requests[key]
        self._end_task(request, request.charged)
        request.trouble = trouble
        request.suspect = suspect
        request.failures += 1
        if not request.interests:
            del self.requests[key]
        self._rank_everywhere(request)
        return request.given_up

    def put_off(self, key: Key, seconds: float = 0.0) -> None:
        """End a task that could not be done, for a reason that is no fault of its chunk; the
        request waits again after ``seconds``.
        """
        request = self.requests[key]
        self._end_task(request, 0.0)
        if not request.interests:
            del self.requests[key]
        request.postponed = seconds > 0.0
        request.waited = request.waited + seconds
        # A postponed request is ranked again when its time has come; see ``_bring_back``.
        if request.postponed:
            self._postponed.append((self.clock() + seconds, request))
        self._rank_everywhere(request)

    def open(self, keys: Iterable[Key]) -> list[BakeRequest]:
        """Return the requests of ``keys`` that are open, that is, neither done nor given up."""
        found = (self.requests[key] for key in keys if key in self.requests)
        return [request for request in found if not request.given_up]

    def failures(self, keys: Iterable[Key]) -> dict[Key, str]:
        """Return the reasons for which requests of ``keys`` were given up."""
        found = (self.requests[key] for key in keys if key in self.requests)
        return {request.key: request.trouble for request in found if request.given_up}

    def counts(self) -> tuple[int, int, float]:
        """Return the numbers of waiting and of given-up requests, and the age in seconds of the
        oldest waiting one.

        Tasks in flight that no client waits for any more are not counted.
        """
        self._forget()
        waiting = [
            request.since
            for request in self.requests.values()
            if request.interests and not request.given_up
        ]
        if waiting:
            age = self.clock() - min(waiting)
        else:
            age = 0.0
        return len(waiting), sum(request.given_up for request in self.requests.values()), age

    def trouble(self) -> str:
        """Return the reason why a request was given up,
        of several the one renewed last; empty if there is none.
        """
        self._forget()
        given_up = [request for request in self.requests.values() if request.given_up]
        if given_up:
            return max(given_up, key=lambda request: request.asked).trouble
        return ""

    def _add_for(self, request: BakeRequest, client: Hashable) -> None:
        """Note a client's new interest in a request, and rank the request.

        It is ranked for all clients if it is new or has changed much, else only for this one.
        """
        self._interesting.setdefault(client, {}).pop(request.key, None)
        # Put the request at the end of the client's order, which is by the time of asking.
        self._interesting[client][request.key] = request
        lacking, priority = request.ranked
        # It has got or lost first light, or gained much priority, as a new one always has: its
        # places in all queues are out of date.
        if bool(request.effort.unlit) != lacking or request.priority >= RERANK_GROWTH * priority:
            self._rank_everywhere(request)
        elif not request.in_flight:
            self._rank_for(request, client)

    def _rank_for(self, request: BakeRequest, client: Hashable) -> None:
        """Rank a request in one client's queue; its places in other queues stay until its priority
        has grown enough, see ``_add_for``.
        """
        # Remember the lowest priority that any queue ranks it by, so that growth is measured from
        # there.
        lacking, priority = request.ranked
        request.ranked = lacking, min(priority, request.priority)
        self._queues.push(request, client, self.rank(request, client))

    def _rank_everywhere(self, request: BakeRequest) -> None:
        """Rank a request in the queues of all its clients.

        One in flight is ranked when its task has ended.
        """
        request.ranked = bool(request.effort.unlit), request.priority
        if request.interests and request.ready:
            merits = self._merits(request)
            for client, interest in request.interests.items():
                self._queues.push(request, client, (request.suspect, -interest.view, *merits))

    def _first(self, patient: bool, client: Hashable) -> BakeRequest | None:
        """Take the first of a client's requests that can be worked on now out of its queue; None if
        there is none.

        A request that has sunk since it was ranked is ranked again: see ``sunk``.
        """
        while found := self._queues.pop(patient, client):
            rank, request = found
            # One that cannot begin leaves the queue. It is ranked again when its task ends or its
            # postponement is over; one that was given up is not.
            if not request.ready:
                continue
            # A task of a shared layer is in flight for this chunk: hold the request back until
            # ``_end_task`` ranks it again.
            if self._is_busy(request.key):
                self._held.setdefault(request.key[1], []).append(request)
            elif sunk(rank, self.rank(request, client)):
                self._rank_for(request, client)
            else:
                return request
        return None

    def _take(self, request: BakeRequest, client: Hashable) -> BakeRequest | None:
        """Mark the request as in flight and return it;
        None if it must run alone and others are in flight.
        """
        if request.suspect and self._in_flight:
            self._rank_for(request, client)
            return None
        self._start(request, client)
        return request

    def _is_busy(self, key: Key) -> bool:
        """Return True if a task is in flight for a layer of this chunk."""
        return any(self.shared(bake, key[0]) for bake in self._in_flight.get(key[1], ()))

    def _start(self, request: BakeRequest, client: Hashable) -> None:
        """Begin the task of a request in the turn of a client."""
        bake, index = request.key
        self._in_flight.setdefault(index, set()).add(bake)
        # All clients that want the chunk share its cost.
        request.payers = tuple(request.interests)
        request.in_flight = True
        self._alone = request.suspect
        request.charged = self.shares.begin(client, request.payers)

    def _end_task(self, request: BakeRequest, seconds: float) -> None:
        """End the task of a request, which took ``seconds`` of a processor,
        and release requests that were held back by it.
        """
        bake, index = request.key
        self._in_flight[index].remove(bake)
        if not self._in_flight[index]:
            del self._in_flight[index]
        request.in_flight = self._alone = False
        self.shares.end(request.payers, request.charged, seconds)
        for held in self._held.pop(index, ()):
            self._rank_everywhere(held)

    def _bring_back(self) -> None:
        """Rank the requests that were postponed until now."""
        due = [request for time, request in self._postponed if time <= self.clock()]
        self._postponed = [each for each in self._postponed if each[1] not in due]
        for request in due:
            request.postponed = False
            self._rank_everywhere(request)

    def _forget(self) -> None:
        """Drop expired interests. They are checked every EXPIRY_CHECK_SECONDS."""
        if self.clock() - self.looked < EXPIRY_CHECK_SECONDS:
            return
        self.looked, horizon = self.clock(), self.clock() - FORGET_AFTER
        # Forget finished light that no view drawn before it can still ask for.
        self._finished = {
            key: each
            for key, each in self._finished.items()
            if self.clock() - each[0] < STALE_SECONDS
        }
        # Drop the interests that no view or page has renewed.
        for client in tuple(self._interesting):
            for request in self._older_than(client, horizon):
                self._drop(request, client)

    def _older_than(self, client: Hashable, horizon: float) -> list[BakeRequest]:
        """Return the requests that a client has not renewed since ``horizon``.

        They come first in its order.
        """
        requests = self._interesting[client].values()
        return list(
            itertools.takewhile(lambda request: request.interests[client].asked < horizon, requests)
        )

    def _release(self, viewer: Viewer, view: int) -> None:
        """Drop the interests of a ``viewer`` in views before ``view``,
        except given-up requests, which expire.
        """
        for request in list(self._interesting.get(viewer.client, {}).values()):
            interest = request.interests[viewer.client]
            if interest.viewer == viewer and interest.view < view and not request.given_up:
                self._drop(request, viewer.client)

    def _drop_all(self, request: BakeRequest) -> None:
        """Drop all interests in a request."""
        for client in tuple(request.interests):
            self._drop(request, client)

    def _drop(self, request: BakeRequest, client: Hashable) -> None:
        """Drop a client's interest, and the request if it was the last.

        A request in flight stays until its task has ended.
        """
        request.release(client)
        del self._interesting[client][request.key]
        if not self._interesting[client]:
            del self._interesting[client]
        if not request.interests and not request.in_flight:
            del self.requests[request.key]


def alike(one: BakeRequest, other: BakeRequest) -> bool:
    """Return True if one task can bake both requests."""
    same = (one.key[0], one.goal, one.until) == (other.key[0], other.goal, other.until)
    return same and not other.suspect


def sunk(rank: Rank, now: Rank) -> bool:
    """Return True if a request comes later by its present rank ``now`` than by the ``rank`` that it
    was queued with, for one of these reasons: it has become suspect, its stage of first light is
    further on, or the error that a second of work removes has fallen by the share RERANK_LOSS.
    """
    # The fourth number is negative, and grows towards 0 as that error falls.
    return now[:3] > rank[:3] or now[3] - rank[3] > RERANK_LOSS * abs(rank[3])
