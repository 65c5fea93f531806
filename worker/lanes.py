"""Lanes: the wants of each client in the order in which they are worked on, the best at hand without looking at all.

A want stands in the lanes of all its clients. What has changed since is put there again, and the place that it had
before counts no more: that is noticed when it comes up, and swept out before such places are most of a lane.
"""

import heapq
import itertools
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field

from worker.wants import Want

Rank = tuple[bool, int, bool, float, float]
"""A place in the order of a client's work; the smallest comes first."""

Place = tuple[Rank, int, Want]
"""A want by its rank, and the ticket of the claim that stood for it."""

FEW = 64
"""Places that a lane may always have."""


@dataclass(eq=False)
class Lane:
    """What a client waits for, a heap of places; it is swept once there are ``most``."""

    places: list[Place] = field(default_factory=list)
    most: int = FEW

    def put(self, client: Hashable, place: Place) -> None:
        """Put one more in."""
        heapq.heappush(self.places, place)
        if len(self.places) > self.most:
            self.places = [each for each in self.places if counts(each, client)]
            heapq.heapify(self.places)
            self.most = 2 * len(self.places) + FEW

    def first(self, client: Hashable) -> Place | None:
        """The first that counts, taken out; None where none does."""
        while self.places:
            place = heapq.heappop(self.places)
            if counts(place, client):
                return place
        return None


class Lanes:
    """A lane for each client that waits for something, those of people and of the patient apart."""

    def __init__(self) -> None:
        """Know nobody yet."""
        self._lanes: dict[bool, dict[Hashable, Lane]] = {False: {}, True: {}}
        self._tickets = itertools.count(1)

    def clients(self, patient: bool) -> Collection[Hashable]:
        """Who may be waiting, of the patient or of the others."""
        return self._lanes[patient].keys()

    def put(self, want: Want, client: Hashable, rank: Rank) -> None:
        """Have a want stand in a client's lane, at this rank and at no other."""
        claim = want.claims[client]
        claim.ticket = next(self._tickets)
        lanes = self._lanes[claim.viewer.patient]
        lane = lanes.get(client) or lanes.setdefault(client, Lane())
        lane.put(client, (rank, claim.ticket, want))

    def first(self, patient: bool, client: Hashable) -> tuple[Rank, Want] | None:
        """The first want in a client's lane and its rank, taken out; None ends the lane."""
        place = self._lanes[patient][client].first(client)
        if place is None:
            del self._lanes[patient][client]
            return None
        return place[0], place[2]


def counts(place: Place, client: Hashable) -> bool:
    """Whether the want still stands at this place of the client's lane."""
    _, ticket, want = place
    claim = want.claims.get(client)
    return claim is not None and claim.ticket == ticket
