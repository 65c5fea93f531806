"""A queue of bake requests for each client, in the order in which they are worked on."""

import heapq
import itertools
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field

from worker.bake_requests import BakeRequest

Rank = tuple[bool, int, int, float, float]
"""A request's rank among those of a client; the smallest comes first."""

Place = tuple[Rank, int, BakeRequest]
"""A request with its rank, and the ticket of its interest when it was put there."""

MIN_PLACES = 64
"""Places that a queue may always hold before outdated ones are removed."""


@dataclass(eq=False)
class ClientQueue:
    """The requests of one client: a heap of places, from which outdated ones are removed beyond ``most``."""

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
        """Put a request into a client's queue at this rank; its former place there becomes outdated."""
        interest = request.interests[client]
        interest.ticket = next(self._tickets)
        queues = self._queues[interest.viewer.patient]
        queue = queues.get(client) or queues.setdefault(client, ClientQueue())
        queue.push(client, (rank, interest.ticket, request))

    def pop(self, patient: bool, client: Hashable) -> tuple[Rank, BakeRequest] | None:
        """Take out the first request of a client's queue, with its rank; None where the queue is empty, and removed."""
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
