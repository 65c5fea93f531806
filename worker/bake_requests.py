"""Bake requests: light of a chunk that clients wait for, its priority, and the state of its task.

Fair turns: of all that wait, the client that was served least is next (start-time fair queueing).
P. Goyal, H. M. Vin, H. Cheng: Start-time Fair Queuing, SIGCOMM 1996. Workers share their processor
seconds by it, and clients of the server the threads that render.
"""

import math
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Effort
from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.frame.demand import Demand, first_texels
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.prepared.prepared_scene import Index
from worker.tasks import BakeResult


@dataclass(frozen=True)
class Viewer:
    """One ``visit`` of a ``client``. When it leaves, the requests that it was the last to renew are
    dropped.

    Clients share the workers evenly. A ``single`` viewer shows one view at a time: its newest view
    replaces the requests of older ones; otherwise requests add up until they expire. A ``patient``
    viewer yields to all others. One that ``bakes`` not is shown what is there.
    """

    client: Hashable = ""
    visit: int = 0
    single: bool = False
    patient: bool = False
    bakes: bool = True


GUEST_VIEWER = Viewer()
"""A viewer without a name."""


Key = tuple[str, Index]
"""The name of a bake and the index of a chunk."""

MOST_FAILURES = 3
"""Failed tries after which a chunk is given up, until its request expires."""

LONG_TASK_PATHS = 1 << 14
"""Paths beyond which what is left of a chunk is not one task, but one level of samples more: about
a tenth of a second, for which others may have to wait.
"""

TASK_SECONDS = 0.25
SHORT_TASK_SECONDS = 0.05
"""Processor seconds that a task is filled up to, and that it is filled up to at least, where little
is left and all workers are to have some of it.
"""

PATH_SECONDS = 5e-6
"""Processor seconds that a path of a chunk is assumed to take before any has ended."""

NO_EFFORT = Effort(0, 0.0, 0.0)


@dataclass(eq=False)
class Interest:
    """The interest of a ``viewer`` in a chunk: texels ``offsets``, seen by their ``footprints``,
    until ``target``, or ``enough`` samples.

    ``priority`` is the squared visible error of the light, over the paths taken. ``view`` numbers
    the view that asked last, the newest being the highest, at the time ``asked``; the first request
    came at ``since``. ``ticket`` marks its current place in the client's queue.
    """

    viewer: Viewer
    offsets: np.ndarray
    footprints: np.ndarray
    target: float
    priority: float
    view: int
    asked: float
    since: float
    enough: int = MAX_SAMPLES
    ticket: int = 0

    def covers(self, offsets: np.ndarray, target: float, enough: int) -> bool:
        """Whether texels at ``offsets`` until a ``target``, or ``enough`` samples, are wanted
        already.
        """
        return self.target <= target and self.enough >= enough and contained(offsets, self.offsets)

    def joined(self, newer: "Interest") -> "Interest":
        """Merge with a ``newer`` interest; priority and age are those of the newer."""
        offsets, footprints, target, enough = merged((self, newer))
        both = (offsets, footprints, target)
        since = min(self.since, newer.since)
        return Interest(newer.viewer, *both, newer.priority, newer.view, newer.asked, since, enough)


class MergedInterest(NamedTuple):
    """Several interests as one: texels ``offsets``, the largest ``footprints`` of each, the
    strictest ``target``, and the most samples that are ``enough``."""

    offsets: np.ndarray
    footprints: np.ndarray
    target: float
    enough: int


NO_INTEREST = MergedInterest(np.empty(0, np.int32), np.empty(0, np.float32), np.inf, 0)


@dataclass(eq=False)
class BakeRequest:
    """A request for light of the chunk ``key``, with the ``interests`` of its clients.

    ``effort`` is the work that it takes, as far as is known, and ``priority`` the squared visible
    error in all views, over the paths taken. ``in_flight`` is whether it has a task, which was
    charged to ``payers``. ``ranked`` holds whether it lacked light, and its priority, when it was
    last ranked in the queues of all its clients. It is ``suspect`` when a worker died with its
    task: that task may be the cause, or one beside it. It is ``postponed`` while another baker is
    at the chunk, and has ``waited`` so many seconds for that. It has ``begun`` once a few texels
    have light; its chunk has 1 << ``bits`` texels a side, see ``Demand``.
    """

    key: Key
    interests: dict[Hashable, Interest] = field(default_factory=dict)
    effort: Effort = NO_EFFORT
    failures: int = 0
    trouble: str = ""
    suspect: bool = False
    in_flight: bool = False
    postponed: bool = False
    waited: float = 0.0
    payers: tuple[Hashable, ...] = ()
    charged: float = 0.0
    priority: float = 0.0
    ranked: tuple[bool, float] = (False, 0.0)
    begun: bool = False
    bits: int = 0
    _merged: MergedInterest = NO_INTEREST
    _stale: bool = False
    _known: bool = False

    @property
    def offsets(self) -> np.ndarray:
        """The texels that any client wants."""
        return self._merge().offsets

    @property
    def footprints(self) -> np.ndarray:
        """The largest footprint of each texel."""
        return self._merge().footprints

    @property
    def next(self) -> tuple[np.ndarray, np.ndarray]:
        """The offsets and footprints of the texels that its next task is for: all, or those that
        have light first.
        """
        wanted = self._merge()
        if not self.sparse:
            return wanted.offsets, wanted.footprints
        first = first_texels(wanted.offsets, self.bits)
        first = first if first.any() else ~first
        return wanted.offsets[first], wanted.footprints[first]

    @property
    def sparse(self) -> bool:
        """Whether its next task lights a few texels alone: where none has light yet, and anybody is
        impatient.
        """
        unlit = not self.begun and self.effort.unlit >= len(self.offsets)
        return (
            unlit
            and self.bits > 0
            and not all(each.viewer.patient for each in self.interests.values())
        )

    @property
    def stage(self) -> int:
        """How far its first light has come: 0 without any, 1 where some texels lack it, else 2."""
        if not self.effort.unlit:
            return 2
        return int(self.begun)

    @property
    def target(self) -> float:
        """The strictest target: known without merging the texels, which frames that ask for the
        time left need not.
        """
        return min(
            (interest.target for interest in self.interests.values()), default=self._merged.target
        )

    @property
    def enough(self) -> int:
        """The most samples that are enough for anybody."""
        return max(
            (interest.enough for interest in self.interests.values()), default=self._merged.enough
        )

    @property
    def asked(self) -> float:
        """The time of the last request."""
        return max(interest.asked for interest in self.interests.values())

    @property
    def since(self) -> float:
        """The time of the first request by a client that still waits."""
        return min(interest.since for interest in self.interests.values())

    @property
    def until(self) -> int:
        """The sample count beyond which no texel is taken next."""
        return min(next_until(self.effort), self.enough)

    @property
    def paths(self) -> float:
        """How many paths its next task takes, as far as is known."""
        unlit, taken, left, *_ = self.effort
        if unlit:
            return FIRST_LEVEL * (len(self.next[0]) if self.sparse else unlit)
        if left <= LONG_TASK_PATHS:
            return left
        return min(left, taken)

    @property
    def given_up(self) -> bool:
        """Whether its task failed so often that it is not tried again."""
        return self.failures >= MOST_FAILURES

    @property
    def ready(self) -> bool:
        """Whether a task for it may begin now."""
        return not (self.in_flight or self.postponed or self.given_up)

    def add_interest(
        self,
        demand: Demand,
        target: float,
        viewer: Viewer,
        view: int,
        now: float,
        enough: int = MAX_SAMPLES,
    ) -> None:
        """Add the demand of a ``viewer``'s newest ``view``.

        It may be of a frame that was drawn before the last task ended: that one knows better what
        its texels lack.
        """
        older = self.interests.get(viewer.client)
        known = self._known and older is not None and older.covers(demand.offsets, target, enough)
        since = now if older is None else older.since
        seen = demand.offsets, demand.footprints, target, priority_of(demand)
        interest = Interest(viewer, *seen, view, now, since, enough)
        if older is None or viewer.single:
            self.interests[viewer.client] = interest
        else:
            self.interests[viewer.client] = older.joined(interest)
        self._change_priority(interest.priority - (0.0 if older is None else older.priority))
        self.effort = self.effort if known else demand.effort
        self._stale = True
        self.bits = demand.bits

    def release(self, client: Hashable) -> None:
        """Drop the interest of a ``client``."""
        self._change_priority(-self.interests.pop(client).priority)
        self._stale = True

    def exceeds(self, offsets: np.ndarray, target: float, enough: int) -> bool:
        """Whether more is wanted than texels ``offsets`` until ``target``, or ``enough``
        samples.
        """
        return exceeds(self._merge(), offsets, target, enough)

    def advance(self, result: BakeResult, grown: bool) -> None:
        """Take over the result of a task.

        Where newer views made the request grow meanwhile (``grown``), their facts stand.
        """
        self.begun = self.begun or self.sparse
        self._known = not grown
        if grown:
            return
        for interest in self.interests.values():
            interest.priority = result.priority / len(self.interests)
        self.priority = result.priority
        self.effort = result.effort

    def _change_priority(self, change: float) -> None:
        """Add a change of one interest to the sum; summing all again would be slow with a thousand
        clients.
        """
        if self.interests:
            first = next(iter(self.interests.values())).priority
        else:
            first = 0.0
        if len(self.interests) < 2:
            self.priority = first
        else:
            self.priority = max(self.priority + change, 0.0)

    def _merge(self) -> MergedInterest:
        """All interests as one, merged on use: most of them change again before that.

        Of new texels, or a stricter target, the last result knows nothing.
        """
        if self._stale and self.interests:
            before = self._merged
            self._merged = merged(self.interests.values())
            self._stale = False
            if exceeds(self._merged, before.offsets, before.target, before.enough):
                self._known = False
        return self._merged


def next_until(effort: Effort) -> int:
    """The sample count beyond which a task takes no texel, of a chunk that wants this ``effort``.

    It is the first while some have no light, and then all that there are, or where that is
    LONG_TASK_PATHS, the next one.
    """
    if effort.unlit:
        return FIRST_LEVEL
    mean = max(effort.taken / max(effort.lit, 1.0), 1.0)
    if effort.left <= LONG_TASK_PATHS:
        return MAX_SAMPLES
    return next_level(2 ** int(math.log2(mean)))


def merged(interests: Collection[Interest]) -> MergedInterest:
    """The texels of all ``interests``, ascending, the largest footprint of each, and the strictest
    target.
    """
    if len(interests) == 1:
        (alone,) = interests
        return MergedInterest(alone.offsets, alone.footprints, alone.target, alone.enough)
    wanted = np.concatenate([interest.offsets for interest in interests])
    seen = np.full(1 + int(wanted.max(initial=-1)), -1.0, np.float32)
    np.maximum.at(seen, wanted, np.concatenate([interest.footprints for interest in interests]))
    offsets = np.flatnonzero(seen >= 0.0).astype(np.int32)
    target = min(each.target for each in interests)
    enough = max(each.enough for each in interests)
    return MergedInterest(offsets, seen[offsets], target, enough)


def exceeds(wanted: MergedInterest, offsets: np.ndarray, target: float, enough: int) -> bool:
    """Whether more is ``wanted`` than texels ``offsets`` until ``target``, or ``enough``
    samples.
    """
    return (
        wanted.target < target or wanted.enough > enough or not contained(wanted.offsets, offsets)
    )


def contained(offsets: np.ndarray, others: np.ndarray) -> bool:
    """Whether all ``offsets`` are among ``others``; both ascend."""
    if offsets is others or len(offsets) > len(others):
        return offsets is others
    places = np.minimum(np.searchsorted(others, offsets), len(others) - 1)
    return bool((others[places] == offsets).all())


def priority_of(demand: Demand) -> float:
    """The squared visible error over the paths that the light is of, or the paths of its first
    level.

    The squared error falls with a power of the samples, so that the next path reduces it in
    proportion to this.
    """
    return demand.weight / (demand.effort.taken + FIRST_LEVEL * demand.effort.unlit or FIRST_LEVEL)


FIRST_TASK_SECONDS = 0.1
"""Processor seconds that a task is assumed to need before any has ended."""

PAST_TASKS_WEIGHT = 0.9
"""Weight of the past in the running mean of a task's length."""


@dataclass(eq=False)
class Account:
    """The seconds ``spent`` on one client, over its ``weight``, on a queue's own clock."""

    weight: float = 1.0
    spent: float = 0.0


@dataclass(eq=False)
class FairClock:
    """The clock of a queue: it is at the turn of the client that was served last.

    A client saves nothing up while it asks for nothing, and is at most ``debt`` seconds ahead of
    the clock for the work that it had done: nobody waits longer than this for the past.
    """

    debt: float = math.inf
    now: float = 0.0

    def join(self, account: Account) -> None:
        """Let a client that begins to wait start level with the one that is served now."""
        account.spent = max(account.spent, self.now)

    def serve(self, turn: float) -> None:
        """Begin work whose client had spent so much (``turn``) when it was chosen."""
        self.now = max(self.now, turn)

    def charge(self, account: Account, seconds: float) -> None:
        """Charge a client with seconds of work, or give some back."""
        account.spent = min(account.spent + seconds / account.weight, self.now + self.debt)

    def is_ahead(self, account: Account) -> bool:
        """Whether a client was served more than the one that is served now."""
        return account.spent > self.now


@dataclass(eq=False)
class Shares:
    """Fair shares of the workers: the ``accounts`` of clients, and processor seconds that a task
    ``usual``-ly takes.
    """

    accounts: dict[Hashable, Account] = field(default_factory=dict)
    clock: FairClock = field(default_factory=FairClock)
    usual: float = FIRST_TASK_SECONDS

    def turns(self, waiting: Collection[Hashable]) -> list[Hashable]:
        """Sort waiting clients by the processor seconds they were served; ties keep their order."""
        self.accounts = {
            client: each for client, each in self.accounts.items() if self.clock.is_ahead(each)
        }
        return sorted(waiting, key=lambda client: self._account(client).spent)

    def begin(self, first: Hashable, clients: Collection[Hashable]) -> float:
        """Begin a task for these clients, in the turn of the ``first``; returns the seconds charged
        in advance.
        """
        self.clock.serve(self._account(first).spent)
        self._charge(clients, self.usual)
        return self.usual

    def end(self, clients: Collection[Hashable], charged: float, seconds: float) -> None:
        """End a task that took so many ``seconds``: correct what the clients were ``charged`` when
        it began.
        """
        self._charge(clients, seconds - charged)
        self.usual = PAST_TASKS_WEIGHT * self.usual + (1.0 - PAST_TASKS_WEIGHT) * seconds

    def _account(self, client: Hashable) -> Account:
        """The account of a client; one without an account begins level with the client that is
        served now.
        """
        if client not in self.accounts:
            self.accounts[client] = Account(spent=self.clock.now)
        return self.accounts[client]

    def _charge(self, clients: Collection[Hashable], seconds: float) -> None:
        """Charge each of the clients an even part."""
        for client in clients:
            self.clock.charge(self._account(client), seconds / len(clients))
