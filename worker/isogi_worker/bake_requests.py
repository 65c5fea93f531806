"""Bake requests: light of a chunk that clients wait for, its priority, and the state of its task.

``Shares`` gives clients fair turns by start-time fair queueing: of all that wait, the client that
was served least is next. Workers share their processor seconds by it, and clients of the server the
threads that render.

Source: P. Goyal, H. M. Vin, H. Cheng: Start-time Fair Queuing, SIGCOMM 1996.
"""

import math
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Effort, Goal
from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.frame.demand import Demand, first_texels
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.tasks import BakeResult


@dataclass(frozen=True)
class Viewer:
    """One ``visit`` of a ``client``: a page or a script with views. Clients share the workers
    evenly.

    A ``single`` viewer shows one view at a time, and its newest view replaces the requests of older
    ones; otherwise requests add up until they expire. A ``patient`` viewer yields to all others.
    Unless it ``bakes``, a viewer is shown the light that is there, and requests none. When it
    leaves, the requests that it was the last to renew are dropped.
    """

    client: Hashable = ""
    visit: int = 0
    single: bool = False
    patient: bool = False
    bakes: bool = True


GUEST_VIEWER = Viewer()
"""A viewer without a name."""


Key = tuple[str, Index]
"""The name of a bake, and the index of a chunk."""

MOST_FAILURES = 3
"""Failed tries after which a chunk is given up, until its request expires."""

LONG_TASK_PATHS = 1 << 14
"""If a chunk needs more paths than this, about a tenth of a second,
its next task only takes its texels one level of samples up, as others may have to wait for it.
"""

TASK_SECONDS = 0.25
SHORT_TASK_SECONDS = 0.05
"""Processor seconds that a task is filled up to;
and the least that it is filled up to when little work is left, which is shared among all workers.
"""

PATH_SECONDS = 5e-6
"""Processor seconds that a path of a chunk is assumed to take before any was measured."""

NO_EFFORT = Effort(0, 0.0, 0.0)


@dataclass(eq=False)
class Interest:
    """The interest of a ``viewer`` in a chunk.

    - ``offsets``, ``footprints``: the texels, and how much of each is seen.
    - ``goal``: of the client's picture.
    - ``priority``: squared visible error of the light, over the paths taken.
    - ``view``, ``asked``: the number of the view that asked last, the newest being the highest, and
      the time, in seconds of the queue's clock.
    - ``since``: time of the first request, by the same clock.
    - ``ticket``: marks the current place in the client's queue.
    """

    viewer: Viewer
    offsets: np.ndarray
    footprints: np.ndarray
    goal: Goal
    priority: float
    view: int
    asked: float
    since: float
    ticket: int = 0

    def covers(self, offsets: np.ndarray, goal: Goal) -> bool:
        """Return True if this interest includes the texels at ``offsets`` (m,) int32, ascending,
        for a ``goal``.
        """
        return self.goal.covers(goal) and contained(offsets, self.offsets)

    def joined(self, newer: "Interest") -> "Interest":
        """Return this interest merged with a ``newer`` one of the same client.

        It has the texels of both, and the priority, view and time of the newer one, which knows
        better how far the light is.
        """
        wanted = merged((self, newer))
        since = min(self.since, newer.since)
        return Interest(newer.viewer, *wanted, newer.priority, newer.view, newer.asked, since)


class MergedInterest(NamedTuple):
    """Several interests as one: the texels ``offsets`` of all, the largest ``footprints`` of each,
    and the strictest ``goal``.
    """

    offsets: np.ndarray
    footprints: np.ndarray
    goal: Goal


NO_INTEREST = MergedInterest(np.empty(0, np.int32), np.empty(0, np.float32), Goal(math.inf, 0))


@dataclass(eq=False)
class BakeRequest:
    """A request for light of the chunk ``key``, with the ``interests`` of its clients, and the
    state of its task.

    - ``effort``: the work that it takes, as far as is known.
    - ``priority``: squared visible error in all views, over the paths taken.
    - ``in_flight``: True if it has a task, which was charged to ``payers``.
    - ``ranked``: two facts that show if its places in the queues are out of date: True if texels
      lacked first light when it was last ranked in all queues; the lowest priority by which any
      queue has ranked it since, 0 at first.
    - ``suspect``: True if a worker died with its task. This task may be the cause, or one next to
      it.
    - ``postponed``, ``waited``: True while another baker is at the chunk, and seconds waited for
      that.
    - ``begun``: True once a first few texels have light; see ``first_texels``.
    - ``bits``: the chunk has 1 << ``bits`` texels a side; see ``Demand``.
    - ``_merged``, ``_stale``: the interests as one when they were last merged, and True if they
      have changed since.
    - ``_known``: True if ``effort`` is the result of the last task, and counts all texels that are
      wanted.
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
        """The offsets and footprints of the texels of its next task: all, or a first few."""
        wanted = self._merge()
        if not self.sparse:
            return wanted.offsets, wanted.footprints
        # Light a quarter of the texels first, evenly spread, and the rest with the next task.
        first = first_texels(wanted.offsets, self.bits)
        first = first if first.any() else ~first
        return wanted.offsets[first], wanted.footprints[first]

    @property
    def sparse(self) -> bool:
        """True if its next task lights only a first quarter of the texels:
        none has light yet, and some client is not patient.
        """
        unlit = not self.begun and self.effort.unlit >= len(self.offsets)
        return (
            unlit
            and self.bits > 0
            and not all(each.viewer.patient for each in self.interests.values())
        )

    @property
    def stage(self) -> int:
        """Progress of first light: 0 without any, 1 if some texels lack it, else 2."""
        if not self.effort.unlit:
            return 2
        return int(self.begun)

    @property
    def goal(self) -> Goal:
        """The strictest goal of all clients that are interested.

        It is taken from each of them, as merging their texels would slow down estimates of the time
        left. If none is left, it is the last merged one.
        """
        if not self.interests:
            return self._merged.goal
        return Goal.strictest(interest.goal for interest in self.interests.values())

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
        """The number of samples beyond which its next task takes no texel."""
        return min(next_until(self.effort), self.goal.samples)

    @property
    def paths(self) -> float:
        """The number of paths of its next task, as far as is known."""
        unlit, taken, left, *_ = self.effort
        if unlit:
            return FIRST_LEVEL * (len(self.next[0]) if self.sparse else unlit)
        # Work that is not too long is done to the end. Else texels go one level up, which doubles
        # their samples.
        if left <= LONG_TASK_PATHS:
            return left
        return min(left, taken)

    @property
    def given_up(self) -> bool:
        """True if its task failed so often that it is not tried again."""
        return self.failures >= MOST_FAILURES

    @property
    def ready(self) -> bool:
        """True if a task for it may begin now."""
        return not (self.in_flight or self.postponed or self.given_up)

    def add_interest(
        self, demand: Demand, goal: Goal, viewer: Viewer, view: int, now: float
    ) -> None:
        """Add the ``demand`` of the newest view of a ``viewer``, for the ``goal`` of its picture.

        ``view`` is the number of the view, higher than that of any view before, and ``now`` the
        time of the request, in seconds of the queue's clock.

        A client has one interest in a chunk: the demand is merged into it, or replaces it if the
        viewer is single.
        """
        older = self.interests.get(viewer.client)
        # The demand's effort may be out of date, as its frame may have been drawn before the last
        # task ended. If the frame asks for nothing that the older one did not, keep the effort that
        # the task has returned.
        known = self._known and older is not None and older.covers(demand.offsets, goal)
        since = now if older is None else older.since
        seen = demand.offsets, demand.footprints, goal, priority_of(demand)
        interest = Interest(viewer, *seen, view, now, since)
        # A single viewer no longer wants the texels of its older view.
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

    def exceeds(self, offsets: np.ndarray, goal: Goal) -> bool:
        """Return True if the clients want any texel that is not at ``offsets``, or more than the
        ``goal``.

        ``offsets`` (m,) int32 must be ascending.
        """
        return exceeds(self._merge(), offsets, goal)

    def advance(self, result: BakeResult, grown: bool) -> None:
        """Take over priority and effort from the ``result`` of the task that has just ended.

        If clients want more than the task was asked for (``grown``), the request keeps its own, as
        the result does not count the rest. That is so after a task of a first few texels, and if
        views have asked for more since the task began.
        """
        # The effort is still the one before the result, so ``sparse`` tells of the ended task.
        self.begun = self.begun or self.sparse
        self._known = not grown
        if grown:
            return
        # The result has one priority for all texels: share it evenly among the clients.
        for interest in self.interests.values():
            interest.priority = result.priority / len(self.interests)
        self.priority = result.priority
        self.effort = result.effort

    def _change_priority(self, change: float) -> None:
        """Add a change of one interest to the sum.

        To add up all of them would be slow with a thousand clients.
        """
        if self.interests:
            first = next(iter(self.interests.values())).priority
        else:
            first = 0.0
        # The priority of a single interest is exact: rounding errors do not add up.
        if len(self.interests) < 2:
            self.priority = first
        else:
            self.priority = max(self.priority + change, 0.0)

    def _merge(self) -> MergedInterest:
        """Return all interests as one.

        They are merged when needed, as most of them change again before that.
        """
        if self._stale and self.interests:
            before = self._merged
            self._merged = merged(self.interests.values())
            self._stale = False
            # The last result did not count new texels, or a stricter goal.
            if exceeds(self._merged, before.offsets, before.goal):
                self._known = False
        return self._merged


def next_until(effort: Effort) -> int:
    """Return the number of samples beyond which the next task of a chunk with this ``effort`` takes
    no texel.

    It is the first level while some texels have no light. Then it is no limit if the work is one
    task of at most LONG_TASK_PATHS paths, and else the level after the mean of the texels.
    """
    if effort.unlit:
        return FIRST_LEVEL
    # The level above the mean of the texels that have light.
    mean = max(effort.taken / max(effort.lit, 1.0), 1.0)
    if effort.left <= LONG_TASK_PATHS:
        return MAX_SAMPLES
    return next_level(2 ** int(math.log2(mean)))


def merged(interests: Collection[Interest]) -> MergedInterest:
    """Return all ``interests`` as one: the texels in ascending order,
    the largest footprint of each, and the strictest goal.
    """
    if len(interests) == 1:
        (alone,) = interests
        return MergedInterest(alone.offsets, alone.footprints, alone.goal)
    wanted = np.concatenate([interest.offsets for interest in interests])
    # Scatter the footprints into an array over the chunk; texels that nobody wants keep -1.
    seen = np.full(1 + int(wanted.max(initial=-1)), -1.0, np.float32)
    np.maximum.at(seen, wanted, np.concatenate([interest.footprints for interest in interests]))
    offsets = np.flatnonzero(seen >= 0.0).astype(np.int32)
    goal = Goal.strictest(each.goal for each in interests)
    return MergedInterest(offsets, seen[offsets], goal)


def exceeds(wanted: MergedInterest, offsets: np.ndarray, goal: Goal) -> bool:
    """Return True if any texel is ``wanted`` that is not at ``offsets``, or more than the ``goal``.

    ``offsets`` (m,) int32 must be ascending.
    """
    return not (goal.covers(wanted.goal) and contained(wanted.offsets, offsets))


def contained(offsets: np.ndarray, others: np.ndarray) -> bool:
    """Return True if all ``offsets`` are among ``others``. Both must be ascending."""
    if offsets is others or len(offsets) > len(others):
        return offsets is others
    # Look up each offset among the others by bisection.
    places = np.minimum(np.searchsorted(others, offsets), len(others) - 1)
    return bool((others[places] == offsets).all())


def priority_of(demand: Demand) -> float:
    """Return the squared visible error of a demand, over the paths that its light is of, or those
    of its first level.

    The squared error falls with a power of the number of paths, so the next path reduces it in
    proportion to this ratio.
    """
    return demand.weight / (demand.effort.taken + FIRST_LEVEL * demand.effort.unlit or FIRST_LEVEL)


FIRST_TASK_SECONDS = 0.1
"""Processor seconds that a task is assumed to need before any has ended."""

PAST_TASKS_WEIGHT = 0.9
"""Weight of the past in the running mean of a task's length."""


@dataclass(eq=False)
class Account:
    """The seconds ``spent`` on one client,
    divided by its ``weight``, on the queue's virtual clock.
    """

    weight: float = 1.0
    spent: float = 0.0


@dataclass(eq=False)
class FairClock:
    """The virtual clock of a fair queue: it shows the account of the client that was served last.

    A client that asks for nothing saves nothing up. For work done earlier it is at most ``debt``
    seconds ahead of the clock, so no client waits longer than this for its past.
    """

    debt: float = math.inf
    now: float = 0.0

    def join(self, account: Account) -> None:
        """Let a client that begins to wait start level with the one that is served now."""
        account.spent = max(account.spent, self.now)

    def serve(self, turn: float) -> None:
        """Begin work of a client whose account stood at ``turn`` when it was chosen."""
        self.now = max(self.now, turn)

    def charge(self, account: Account, seconds: float) -> None:
        """Charge a client for seconds of work; negative ones are given back."""
        account.spent = min(account.spent + seconds / account.weight, self.now + self.debt)

    def is_ahead(self, account: Account) -> bool:
        """Return True if a client was served more than the one that is served now."""
        return account.spent > self.now


@dataclass(eq=False)
class Shares:
    """Fair shares of the workers: the ``accounts`` of clients,
    and the ``usual`` processor seconds of a task.
    """

    accounts: dict[Hashable, Account] = field(default_factory=dict)
    clock: FairClock = field(default_factory=FairClock)
    usual: float = FIRST_TASK_SECONDS

    def turns(self, waiting: Collection[Hashable]) -> list[Hashable]:
        """Return the ``waiting`` clients, those first
        that were served least; ties keep their order.
        """
        # Accounts that the clock has passed are level with new ones, and need not be kept.
        self.accounts = {
            client: each for client, each in self.accounts.items() if self.clock.is_ahead(each)
        }
        return sorted(waiting, key=lambda client: self._account(client).spent)

    def begin(self, first: Hashable, clients: Collection[Hashable]) -> float:
        """Begin a task for ``clients`` in the turn of the ``first`` one;
        return the seconds charged in advance.
        """
        self.clock.serve(self._account(first).spent)
        self._charge(clients, self.usual)
        return self.usual

    def end(self, clients: Collection[Hashable], charged: float, seconds: float) -> None:
        """End a task that took ``seconds``:
        correct the amount that its clients were ``charged`` when it began.
        """
        self._charge(clients, seconds - charged)
        # A running mean of the lengths of tasks is charged in advance.
        self.usual = PAST_TASKS_WEIGHT * self.usual + (1.0 - PAST_TASKS_WEIGHT) * seconds

    def _account(self, client: Hashable) -> Account:
        """Return the account of a client;
        a new one starts level with the client that is served now.
        """
        if client not in self.accounts:
            self.accounts[client] = Account(spent=self.clock.now)
        return self.accounts[client]

    def _charge(self, clients: Collection[Hashable], seconds: float) -> None:
        """Charge each of the clients an even part."""
        for client in clients:
            self.clock.charge(self._account(client), seconds / len(clients))
