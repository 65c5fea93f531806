"""The queue: decides which chunk is baked next, and how far.

The requests of all live views are merged: a chunk that several views see is baked once, for all
texels that any of them wants. Clients take turns, so that each is served as long. In a client's
turn its newest view comes first; within a view, chunks without light come first, of which a quarter
of the texels is lit, then those where some texels have none yet, then those where a second of work
removes most visible error from all pictures, weighted towards their centres, and among equals those
nearest to final. Patient clients come after all others. Pure data: no threads, no clock of its own.
"""

import heapq
import itertools
import math
import operator
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.frame.demand import Demand
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.prepared.prepared_scene import Index
from worker.bake_requests import (
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
from worker.tasks import BakeResult

Rank = tuple[bool, int, int, float, float]
"""A request's rank among those of a client; the smallest comes first."""

Place = tuple[Rank, int, BakeRequest]
"""A request with its rank, and the ticket of its interest when it was put there."""

MIN_PLACES = 64
"""Places that a queue may always hold before outdated ones are removed."""


@dataclass(eq=False)
class ClientQueue:
    """The requests of one client: a heap of places, from which outdated ones are removed beyond
    ``most``.
    """

    places: list[Place] = field(default_factory=list)
    most: int = MIN_PLACES

    def push(self, client: Hashable, place: Place) -> None:
        """Add a place."""
        heapq.heappush(self.places, place)
        if len(self.places) > self.most:
            self.places = [each for each in self.places if is_current(each, client)]
            heapq.heapify(self.places)
            self.most = 2 * len(self.places) + MIN_PLACES

    def pop(self, client: Hashable) -> Place | None:
        """Take out the first current place; None where there is none."""
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
        """The clients that may be waiting, patient ones or others."""
        return self._queues[patient].keys()

    def push(self, request: BakeRequest, client: Hashable, rank: Rank) -> None:
        """Put a request into a client's queue at this rank; its former place there becomes
        outdated.
        """
        interest = request.interests[client]
        interest.ticket = next(self._tickets)
        queues = self._queues[interest.viewer.patient]
        queue = queues.get(client) or queues.setdefault(client, ClientQueue())
        queue.push(client, (rank, interest.ticket, request))

    def length(self, patient: bool, client: Hashable) -> int:
        """How many places a client's queue has, outdated ones among them."""
        queue = self._queues[patient].get(client)
        if queue is None:
            return 0
        return len(queue.places)

    def pop(self, patient: bool, client: Hashable) -> tuple[Rank, BakeRequest] | None:
        """Take out the first request of a client's queue, with its rank; None where the queue is
        empty, and removed.
        """
        place = self._queues[patient][client].pop(client)
        if place is None:
            del self._queues[patient][client]
            return None
        return place[0], place[2]


def is_current(place: Place, client: Hashable) -> bool:
    """Whether this is the newest place of the request in the client's queue."""
    _, ticket, request = place
    interest = request.interests.get(client)
    return interest is not None and interest.ticket == ticket


STALE_SECONDS = 2.0
"""Seconds within which a view that lacks what was just finished is taken to have been drawn before
that.
"""

FORGET_AFTER = 60.0
EXPIRY_CHECK_SECONDS = 1.0
"""Seconds after which a request that was not renewed expires, and between two checks for these."""

RERANK_GROWTH = 1.5
RERANK_LOSS = 1.0 / 3.0
"""Growth of a request's priority, and share of its loss, from which on it is ranked again in all
its clients' queues.

Below these it keeps its places, as a thousand clients may see one chunk.
"""


@dataclass(eq=False)
class BakeQueue:
    """Bake requests by chunk. Call under one lock when several threads use it.

    ``shared`` says whether two bakes have a layer in common: of these, one at a time works on a
    chunk, as the last writer would undo what the other has added. ``rate`` gives the seconds that a
    path of a chunk takes.
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
        target: float,
        viewer: Viewer = GUEST_VIEWER,
        enough: int = MAX_SAMPLES,
    ) -> set[Key]:
        """Add the demands of a ``viewer``'s newest view.

        Returns those that are left out: their light has come since the view was drawn.
        """
        self._forget()
        stale = set[Key]()
        self.views += 1
        now = self.clock()
        for key, demand in demands:
            if key not in self.requests and self._has_come(key, demand, target, enough):
                stale.add(key)
                continue
            request = self.requests.get(key) or self.requests.setdefault(key, BakeRequest(key))
            if not request.given_up:
                request.add_interest(demand, target, viewer, self.views, now, enough)
                self._add_for(request, viewer.client)
        if viewer.single:
            self._release(viewer, self.views)
        return stale

    def _has_come(self, key: Key, demand: Demand, target: float, enough: int) -> bool:
        """Whether what is demanded of a chunk was finished within the last STALE_SECONDS."""
        when, done = self._finished.get(key, (-math.inf, NO_INTEREST))
        return self.clock() - when < STALE_SECONDS and not exceeds(
            MergedInterest(demand.offsets, demand.footprints, target, enough),
            done.offsets,
            done.target,
            done.enough,
        )

    def leave(self, viewer: Viewer) -> None:
        """Drop the interests that a ``viewer`` was the last of its client to renew."""
        self._release(viewer, self.views + 1)

    def drop(self, bake: str) -> list[Key]:
        """Drop all requests of a ``bake``; returns their keys."""
        dropped = [key for key in self.requests if key[0] == bake]
        for key in dropped:
            self._drop_all(self.requests[key])
        return dropped

    def take(self) -> BakeRequest | None:
        """Take the next request, marked as in flight; None where there is nothing to do until a
        task has ended.

        A request that may have killed a worker comes last and runs alone: it harms no other, and is
        then known for it.
        """
        self._forget()
        self._bring_back()
        if self._alone:
            return None
        for patient in (False, True):
            for client in self.shares.turns(self._queues.clients(patient)):
                request = self._first(patient, client)
                if request is not None:
                    self._turn = patient, client
                    return self._take(request, client)
        return None

    def take_along(self, first: BakeRequest, most: int, tasks: int = 1) -> list[BakeRequest]:
        """Take what goes with the request that was just taken: ``most`` texels of the same turn,
        and TASK_SECONDS.

        They are the next of that client, as long as these are of the same bake, target and sample
        level. Where what is left would not fill so many ``tasks``, it is shared evenly among them,
        so that all workers come to the end of it together.
        """
        taken = [first]
        left = most - len(first.next[0])
        seconds = self.seconds(first)
        patient, client = self._turn
        waiting = seconds * (1 + self._queues.length(patient, client))
        enough = min(max(waiting / tasks, SHORT_TASK_SECONDS), TASK_SECONDS)
        while (
            left > 0
            and seconds < enough
            and not first.suspect
            and (found := self._first(patient, client))
        ):
            left = left - len(found.next[0])
            seconds = seconds + self.seconds(found)
            if left < 0 or seconds > enough or not alike(first, found):
                self._rank_for(found, client)
                break
            self._start(found, client)
            taken.append(found)
        return taken

    def seconds(self, request: BakeRequest) -> float:
        """The seconds that the next task of a request is predicted to take."""
        return request.paths * (self.rate(request.key) or PATH_SECONDS)

    def rank(self, request: BakeRequest, client: Hashable) -> Rank:
        """The rank of a request among those of a client; the smallest comes first."""
        return request.suspect, -request.interests[client].view, *self._merits(request)

    def _merits(self, request: BakeRequest) -> tuple[int, float, float]:
        """The rank of a request among those of a view."""
        return (
            request.stage,
            -request.priority / (self.rate(request.key) or 1.0),
            request.effort.left,
        )

    def finish(
        self,
        key: Key,
        offsets: np.ndarray,
        target: float,
        result: BakeResult,
        enough: int = MAX_SAMPLES,
    ) -> None:
        """Take over the result of a task for ``offsets`` of a chunk; the request stays where work
        is left.
        """
        request = self.requests[key]
        self._end_task(request, result.cost.seconds)
        request.failures = 0
        request.suspect = False
        request.waited = 0.0
        grown = request.exceeds(offsets, target, enough)
        if not request.interests:
            del self.requests[key]
        elif result.unfinished == 0 and not grown:
            done = MergedInterest(request.offsets, request.footprints, target, enough)
            self._finished[key] = self.clock(), done
            self._drop_all(request)
        else:
            request.advance(result, grown)
            self._rank_everywhere(request)

    def wanted(self, bake: str) -> set[Index]:
        """The chunks of a ``bake`` whose requests are open."""
        return {
            index
            for (name, index), request in self.requests.items()
            if name == bake and not request.given_up
        }

    def is_busy(self, bake: str, index: Index) -> bool:
        """Whether a task of a ``bake`` is in flight for a chunk."""
        return bake in self._in_flight.get(index, ())

    def renew(self, keys: Iterable[Key], viewer: Viewer = GUEST_VIEWER) -> None:
        """Renew a ``viewer``'s interest in ``keys``."""
        claimed = self._interesting.get(viewer.client, {})
        for request in self.open(keys):
            if viewer.client in request.interests:
                request.interests[viewer.client].asked = self.clock()
                claimed[request.key] = claimed.pop(request.key)

    def fail(self, key: Key, trouble: str, suspect: bool = False) -> bool:
        """Note that a task failed, and why: it is tried again, or given up. Returns whether it was
        given up.

        It is ``suspect`` where its worker died.
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
        """Note that a task could not be done, through no fault of the chunk; it waits again after
        ``seconds``.
        """
        request = self.requests[key]
        self._end_task(request, 0.0)
        if not request.interests:
            del self.requests[key]
        request.postponed = seconds > 0.0
        request.waited = request.waited + seconds
        if request.postponed:
            self._postponed.append((self.clock() + seconds, request))
        self._rank_everywhere(request)

    def open(self, keys: Iterable[Key]) -> list[BakeRequest]:
        """The requests of ``keys`` that are open: neither done nor given up."""
        found = (self.requests[key] for key in keys if key in self.requests)
        return [request for request in found if not request.given_up]

    def failures(self, keys: Iterable[Key]) -> dict[Key, str]:
        """The reasons for which requests of ``keys`` were given up."""
        found = (self.requests[key] for key in keys if key in self.requests)
        return {request.key: request.trouble for request in found if request.given_up}

    def counts(self) -> tuple[int, int, float]:
        """Numbers of waiting and of given-up requests, and the age in seconds of the oldest waiting
        one.

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
        """Why the given-up request that was renewed last was given up; empty where there is
        none.
        """
        self._forget()
        given_up = [request for request in self.requests.values() if request.given_up]
        if given_up:
            return max(given_up, key=lambda request: request.asked).trouble
        return ""

    def _add_for(self, request: BakeRequest, client: Hashable) -> None:
        """Note a client's new interest, and rank the request again for all clients where it has
        changed much.
        """
        self._interesting.setdefault(client, {}).pop(request.key, None)
        self._interesting[client][request.key] = request
        lacking, priority = request.ranked
        if bool(request.effort.unlit) != lacking or request.priority >= RERANK_GROWTH * priority:
            self._rank_everywhere(request)
        elif not request.in_flight:
            self._rank_for(request, client)

    def _rank_for(self, request: BakeRequest, client: Hashable) -> None:
        """Rank a request in one client's queue; the others follow when it has grown beyond this."""
        lacking, priority = request.ranked
        request.ranked = lacking, min(priority, request.priority)
        self._queues.push(request, client, self.rank(request, client))

    def _rank_everywhere(self, request: BakeRequest) -> None:
        """Rank a request in the queues of all its clients; one in flight is ranked when its task
        has ended.
        """
        request.ranked = bool(request.effort.unlit), request.priority
        if request.interests and request.ready:
            merits = self._merits(request)
            for client, interest in request.interests.items():
                self._queues.push(request, client, (request.suspect, -interest.view, *merits))

    def _first(self, patient: bool, client: Hashable) -> BakeRequest | None:
        """The first of a client's requests that can be worked on now; None where there is none.

        One whose priority has sunk since it was ranked is ranked again.
        """
        while found := self._queues.pop(patient, client):
            rank, request = found
            if not request.ready:
                continue
            if self._is_busy(request.key):
                self._held.setdefault(request.key[1], []).append(request)
            elif sunk(rank, self.rank(request, client)):
                self._rank_for(request, client)
            else:
                return request
        return None

    def _take(self, request: BakeRequest, client: Hashable) -> BakeRequest | None:
        """Mark the request as in flight and return it; None where it must run alone and others are
        in flight.
        """
        if request.suspect and self._in_flight:
            self._rank_for(request, client)
            return None
        self._start(request, client)
        return request

    def _is_busy(self, key: Key) -> bool:
        """Whether a task is in flight for a layer of this chunk."""
        return any(self.shared(bake, key[0]) for bake in self._in_flight.get(key[1], ()))

    def _start(self, request: BakeRequest, client: Hashable) -> None:
        """Begin the task of a request, in the turn of a client."""
        bake, index = request.key
        self._in_flight.setdefault(index, set()).add(bake)
        request.payers = tuple(request.interests)
        request.in_flight = True
        self._alone = request.suspect
        request.charged = self.shares.begin(client, request.payers)

    def _end_task(self, request: BakeRequest, seconds: float) -> None:
        """End the task of a request after so many processor seconds; requests held up by it go
        on.
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
        """Drop expired interests; checked every EXPIRY_CHECK_SECONDS."""
        if self.clock() - self.looked < EXPIRY_CHECK_SECONDS:
            return
        self.looked, horizon = self.clock(), self.clock() - FORGET_AFTER
        self._finished = {
            key: each
            for key, each in self._finished.items()
            if self.clock() - each[0] < STALE_SECONDS
        }
        for client in tuple(self._interesting):
            for request in self._older_than(client, horizon):
                self._drop(request, client)

    def _older_than(self, client: Hashable, horizon: float) -> list[BakeRequest]:
        """The requests that a client has not renewed since; they come first in its order."""
        requests = self._interesting[client].values()
        return list(
            itertools.takewhile(lambda request: request.interests[client].asked < horizon, requests)
        )

    def _release(self, viewer: Viewer, view: int) -> None:
        """Drop the interests of a ``viewer`` in views before this one, but for given-up requests,
        which expire.
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
        """Drop a client's interest, and a request without interests; one in flight stays until its
        task has ended.
        """
        request.release(client)
        del self._interesting[client][request.key]
        if not self._interesting[client]:
            del self._interesting[client]
        if not request.interests and not request.in_flight:
            del self.requests[request.key]


def alike(one: BakeRequest, other: BakeRequest) -> bool:
    """Whether one task can bake both."""
    same = (one.key[0], one.target, one.enough, one.until) == (
        other.key[0],
        other.target,
        other.enough,
        other.until,
    )
    return same and not other.suspect


def sunk(rank: Rank, now: Rank) -> bool:
    """Whether a request's rank has become much lower, or it has the first light that it lacked."""
    return now[:3] > rank[:3] or now[3] - rank[3] > RERANK_LOSS * abs(rank[3])
