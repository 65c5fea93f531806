"""The queue: which chunk is baked next, and how far.

The demand of all live views is one: a chunk that several see is baked once, for all of its texels that any wants.
Clients take turns so that each is served as long; in its turn a client's newest view comes first, and within it what
has no light yet, then where a second of work takes most visible error off all pictures, those near the centre
counting most, and of equals what is nearest to final. People go before who is patient.
Pure data: no threads, no clock of its own.
"""

import itertools
import math
import operator
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand
from worker.lanes import Lanes, Rank
from worker.tasks import BakeResult
from worker.viewers import GUEST, Shares, Viewer
from worker.wants import Key, Want

FORGET_AFTER, LOOK = 60.0, 1.0
"""Seconds after which light that nobody has asked for again is no longer baked, and between two looks for such."""

GROWN, SUNK = 1.5, 1.0 / 3.0
"""How many times as much a want is worth, or by which share less, when it is moved in lanes of those who did not ask.

For less it keeps its places: a thousand clients may look at one chunk.
"""


@dataclass(eq=False)
class BakeQueue:
    """Wants by chunk. Call under one lock when several threads use it.

    ``shared`` says whether two bakes have a layer in common: of those, one at a time works on a chunk, for the
    one that wrote last would undo what the other has added. ``rate`` tells the seconds that a chunk's path takes.
    """

    clock: Callable[[], float]
    shared: Callable[[str, str], bool] = operator.eq
    rate: Callable[[Key], float | None] = lambda _: None
    wants: dict[Key, Want] = field(default_factory=dict)
    views: int = 0
    looked: float = -math.inf
    shares: Shares = field(default_factory=Shares)
    _lanes: Lanes = field(default_factory=Lanes)
    _claimed: dict[Hashable, dict[Key, Want]] = field(default_factory=dict)
    _flying: dict[Index, set[str]] = field(default_factory=dict)
    _held: dict[Index, list[Want]] = field(default_factory=dict)
    _aside: list[tuple[float, Want]] = field(default_factory=list)
    _alone: bool = False

    def want(self, demands: Iterable[tuple[Key, Demand]], target: float, viewer: Viewer = GUEST) -> None:
        """Take in what the newest view of a ``viewer`` demands."""
        self._forget()
        self.views += 1
        now = self.clock()
        for key, demand in demands:
            want = self.wants.get(key) or self.wants.setdefault(key, Want(key))
            if not want.given_up:
                want.claim(demand, target, viewer, self.views, now)
                self._note(want, viewer.client)
        if viewer.single:
            self._release(viewer, self.views)

    def leave(self, viewer: Viewer) -> None:
        """Drop what a ``viewer`` was the last of its client to ask for."""
        self._release(viewer, self.views + 1)

    def drop(self, bake: str) -> list[Key]:
        """Have nothing more baked of a ``bake``; the chunks that were wanted of it."""
        dropped = [key for key in self.wants if key[0] == bake]
        for key in dropped:
            self._end(self.wants[key])
        return dropped

    def take(self) -> Want | None:
        """The next chunk to work on, marked as flying; None where there is nothing to do until a task has ended.

        What may have killed a worker comes last, and flies alone: it cannot pull down others, and is known for it.
        """
        self._forget()
        self._bring_back()
        if self._alone:
            return None
        for patient in (False, True):
            for client in self.shares.turns(self._lanes.clients(patient)):
                want = self._first(patient, client)
                if want is not None:
                    return self._take(want, client)
        return None

    def rank(self, want: Want, client: Hashable) -> Rank:
        """Order of a client's work; the smallest comes first."""
        return want.suspect, -want.claims[client].view, *self._merits(want)

    def _merits(self, want: Want) -> tuple[bool, float, float]:
        """What a want's rank is among those of a view."""
        return not want.effort.unlit, -want.worth / (self.rate(want.key) or 1.0), want.effort.left

    def finish(self, key: Key, offsets: np.ndarray, target: float, result: BakeResult) -> None:
        """A task for ``offsets`` of a chunk is done: drop the want, or keep what is still open of it."""
        want = self.wants[key]
        self._land(want, result.cost.seconds)
        want.failures, want.suspect, want.waited = 0, False, 0.0
        grown = want.exceeds(offsets, target)
        if not want.claims:
            del self.wants[key]
        elif result.unfinished == 0 and not grown:
            self._end(want)
        else:
            want.descend(result, grown)
            self._line_up(want)

    def renew(self, keys: Iterable[Key], viewer: Viewer = GUEST) -> None:
        """Say that a ``viewer`` waits for light of ``keys`` as before."""
        claimed = self._claimed.get(viewer.client, {})
        for want in self.open(keys):
            if viewer.client in want.claims:
                want.claims[viewer.client].asked = self.clock()
                claimed[want.key] = claimed.pop(want.key)

    def fail(self, key: Key, trouble: str, suspect: bool = False) -> bool:
        """A task failed, and why: try again later, or give the chunk up. Returns whether it was given up.

        It is ``suspect`` where its worker died.
        """
        want = self.wants[key]
        self._land(want, want.charged)
        want.trouble, want.suspect = trouble, suspect
        want.failures += 1
        if not want.claims:
            del self.wants[key]
        self._line_up(want)
        return want.given_up

    def put_off(self, key: Key, seconds: float = 0.0) -> None:
        """A task could not be done, through no fault of the chunk: it waits as before, after so many seconds."""
        want = self.wants[key]
        self._land(want, 0.0)
        if not want.claims:
            del self.wants[key]
        want.aside, want.waited = seconds > 0.0, want.waited + seconds
        if want.aside:
            self._aside.append((self.clock() + seconds, want))
        self._line_up(want)

    def open(self, keys: Iterable[Key]) -> list[Want]:
        """What of ``keys`` is still wanted, and not given up."""
        found = (self.wants[key] for key in keys if key in self.wants)
        return [want for want in found if not want.given_up]

    def failures(self, keys: Iterable[Key]) -> dict[Key, str]:
        """Why those of ``keys`` that were given up were."""
        found = (self.wants[key] for key in keys if key in self.wants)
        return {want.key: want.trouble for want in found if want.given_up}

    def counts(self) -> tuple[int, int, float]:
        """Chunks that somebody waits for, chunks that were given up, and seconds since the oldest of those was wanted.

        What flies though nobody wants it any more is none of them.
        """
        self._forget()
        waiting = [want.since for want in self.wants.values() if want.claims and not want.given_up]
        age = self.clock() - min(waiting) if waiting else 0.0
        return len(waiting), sum(want.given_up for want in self.wants.values()), age

    def trouble(self) -> str:
        """Why a chunk was given up, the one asked for last; empty when none is."""
        self._forget()
        given_up = [want for want in self.wants.values() if want.given_up]
        return max(given_up, key=lambda want: want.asked).trouble if given_up else ""

    def _note(self, want: Want, client: Hashable) -> None:
        """A client has claimed a want: its claim is its newest, and others' lanes learn of what has changed much."""
        self._claimed.setdefault(client, {}).pop(want.key, None)
        self._claimed[client][want.key] = want
        lacking, worth = want.told
        if bool(want.effort.unlit) != lacking or want.worth >= GROWN * worth:
            self._line_up(want)
        elif not want.flying:
            self._put(want, client)

    def _put(self, want: Want, client: Hashable) -> None:
        """Have a want stand where it belongs in one client's lane: the others learn when it has grown beyond that."""
        lacking, worth = want.told
        want.told = lacking, min(worth, want.worth)
        self._lanes.put(want, client, self.rank(want, client))

    def _line_up(self, want: Want) -> None:
        """Have a want stand where it belongs in the lanes of all its clients; what flies does when it has landed."""
        want.told = bool(want.effort.unlit), want.worth
        if want.claims and want.ready:
            merits = self._merits(want)
            for client, claim in want.claims.items():
                self._lanes.put(want, client, (want.suspect, -claim.view, *merits))

    def _first(self, patient: bool, client: Hashable) -> Want | None:
        """The first of a client's wants that can be worked on now; None where there is none.

        One that has sunk since it was put there is put where it belongs.
        """
        while found := self._lanes.first(patient, client):
            rank, want = found
            if not want.ready:
                continue
            if self._busy(want.key):
                self._held.setdefault(want.key[1], []).append(want)
            elif sunk(rank, self.rank(want, client)):
                self._put(want, client)
            else:
                return want
        return None

    def _take(self, want: Want, client: Hashable) -> Want | None:
        """The want, flying from now on; None where it has to fly alone and others do."""
        if want.suspect and self._flying:
            self._put(want, client)
            return None
        self._fly(want, client)
        return want

    def _busy(self, key: Key) -> bool:
        """Whether a task is at the light of this chunk."""
        return any(self.shared(bake, key[0]) for bake in self._flying.get(key[1], ()))

    def _fly(self, want: Want, client: Hashable) -> None:
        """A task of a want begins, in the turn of a client."""
        bake, index = want.key
        self._flying.setdefault(index, set()).add(bake)
        want.flying, want.payers, self._alone = True, tuple(want.claims), want.suspect
        want.charged = self.shares.begin(client, want.payers)

    def _land(self, want: Want, seconds: float) -> None:
        """The task of a want has ended after so many processor seconds; what was held up by it may go on."""
        bake, index = want.key
        self._flying[index].remove(bake)
        if not self._flying[index]:
            del self._flying[index]
        want.flying = self._alone = False
        self.shares.end(want.payers, want.charged, seconds)
        for held in self._held.pop(index, ()):
            self._line_up(held)

    def _bring_back(self) -> None:
        """Line up what was put off until now."""
        due = [want for time, want in self._aside if time <= self.clock()]
        self._aside = [each for each in self._aside if each[1] not in due]
        for want in due:
            want.aside = False
            self._line_up(want)

    def _forget(self) -> None:
        """Drop what nobody has asked for again; not each time."""
        if self.clock() - self.looked < LOOK:
            return
        self.looked, horizon = self.clock(), self.clock() - FORGET_AFTER
        for client in tuple(self._claimed):
            for want in self._older(client, horizon):
                self._drop(want, client)

    def _older(self, client: Hashable, horizon: float) -> list[Want]:
        """What a client has not asked for since; these come first of all that it claims."""
        wants = self._claimed[client].values()
        return list(itertools.takewhile(lambda want: want.claims[client].asked < horizon, wants))

    def _release(self, viewer: Viewer, view: int) -> None:
        """Drop what a ``viewer`` claims for views before this one; not what was given up: that is tried again later."""
        for want in list(self._claimed.get(viewer.client, {}).values()):
            claim = want.claims[viewer.client]
            if claim.viewer == viewer and claim.view < view and not want.given_up:
                self._drop(want, viewer.client)

    def _end(self, want: Want) -> None:
        """Drop all that is claimed of a want."""
        for client in tuple(want.claims):
            self._drop(want, client)

    def _drop(self, want: Want, client: Hashable) -> None:
        """Drop a client's claim, and the want where nobody else claims it; what flies stays until it lands."""
        want.release(client)
        del self._claimed[client][want.key]
        if not self._claimed[client]:
            del self._claimed[client]
        if not want.claims and not want.flying:
            del self.wants[want.key]


def sunk(rank: Rank, now: Rank) -> bool:
    """Whether what had a ``rank`` is worth much less ``now``, or has the light that it lacked."""
    return now[:3] > rank[:3] or now[3] - rank[3] > SUNK * abs(rank[3])
