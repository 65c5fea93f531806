"""Wants: light of a chunk that is waited for, and who claims it."""

from collections.abc import Collection, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import MOST
from worker.tasks import BakeResult
from worker.viewers import Viewer

Key = tuple[str, Index]
"""A chunk of a bake, by its name."""

MOST_FAILURES = 3
"""Tries after which a chunk whose task fails is given up, until it is forgotten."""

STEP = 1.0 / 8.0
"""What a task brings the worth of the next paths of a chunk's texels down to, as a share of their mean.

Small steps follow the error more closely, large ones waste less on tasks of few texels each: to the end of a view of
82 texels a chunk (the engine at 96 pixels a side) 1/8 took 1.35 times, and 1/32 1.25 times, what single tasks took.
"""

WHOLE = 0.5
"""Processor seconds of a task that people may have to wait for, though it is for who is patient."""

SHORT = 0.1
"""Processor seconds of a task that is not worth taking in steps: each costs up to 0.02 to hand out, read and write."""

NOTHING = Effort(0, 0.0, 0.0)


@dataclass(eq=False)
class Claim:
    """What a ``viewer`` wants of a chunk: texels ``offsets``, seen by their ``footprints``, until ``target``.

    ``worth`` is the squared visible error that waits for them, over the paths taken. ``view`` numbers what was asked
    for last, the newest being the highest, and ``asked`` is when; it was first asked for at ``since``. Its place in the
    client's lane has this ``ticket``.
    """

    viewer: Viewer
    offsets: np.ndarray
    footprints: np.ndarray
    target: float
    worth: float
    view: int
    asked: float
    since: float
    ticket: int = 0

    def joined(self, newer: "Claim") -> "Claim":
        """This and a ``newer`` claim as one; worth and age are those of the newer."""
        both, since = together((self, newer)), min(self.since, newer.since)
        return Claim(newer.viewer, *both, newer.worth, newer.view, newer.asked, since)


class Together(NamedTuple):
    """What several claims want as one: texels ``offsets``, with the largest ``footprints`` of each, to ``target``."""

    offsets: np.ndarray
    footprints: np.ndarray
    target: float


NONE = Together(np.empty(0, np.int32), np.empty(0, np.float32), np.inf)


@dataclass(eq=False)
class Want:
    """Light that somebody waits for: what the ``claims``, by their clients, want of the chunk ``key`` together.

    ``effort`` is what it takes, as far as is known, and ``worth`` the squared visible error that waits for it in all
    views, over the paths taken. A task that is ``flying`` was charged to ``payers``. ``told`` is whether it lacked
    light, and its worth, when all its clients' lanes last learnt of it. It is ``suspect`` when a worker died that had
    its task: it may have been that task, or one beside it. It stands ``aside`` while somebody else is at the chunk, and
    has ``waited`` so many seconds for that.
    """

    key: Key
    claims: dict[Hashable, Claim] = field(default_factory=dict)
    effort: Effort = NOTHING
    failures: int = 0
    trouble: str = ""
    suspect: bool = False
    flying: bool = False
    aside: bool = False
    waited: float = 0.0
    payers: tuple[Hashable, ...] = ()
    charged: float = 0.0
    worth: float = 0.0
    told: tuple[bool, float] = (False, 0.0)
    _together: Together = NONE
    _stale: bool = False
    _least: float | None = None

    @property
    def offsets(self) -> np.ndarray:
        """The texels that anybody wants."""
        return self._settled().offsets

    @property
    def footprints(self) -> np.ndarray:
        """How much of each texel is seen where most is."""
        return self._settled().footprints

    @property
    def target(self) -> float:
        """The strictest target."""
        return self._settled().target

    @property
    def least(self) -> float | None:
        """The worth that paths must have to be taken next; None until each texel has its first light."""
        self._settled()
        return self._least

    @property
    def asked(self) -> float:
        """When it was last asked for."""
        return max(claim.asked for claim in self.claims.values())

    @property
    def since(self) -> float:
        """When those who wait for it asked first."""
        return min(claim.since for claim in self.claims.values())

    @property
    def until(self) -> int:
        """The sample count beyond which no texel is taken next."""
        return FIRST_RUNG if self.least is None else MOST

    @property
    def given_up(self) -> bool:
        """Whether its task failed so often that it is not tried again."""
        return self.failures >= MOST_FAILURES

    @property
    def ready(self) -> bool:
        """Whether it can be worked on now."""
        return not (self.flying or self.aside or self.given_up)

    def claim(self, demand: Demand, target: float, viewer: Viewer, view: int, now: float) -> None:
        """Take in what a ``viewer`` demands of the chunk in its newest ``view``."""
        older = self.claims.get(viewer.client)
        since = now if older is None else older.since
        claim = Claim(viewer, demand.offsets, demand.footprints, target, worth_of(demand), view, now, since)
        self.claims[viewer.client] = claim if older is None or viewer.single else older.joined(claim)
        self._weigh(claim.worth - (0.0 if older is None else older.worth))
        self.effort, self._stale = demand.effort, True

    def release(self, client: Hashable) -> None:
        """Drop the claim of a ``client``."""
        self._weigh(-self.claims.pop(client).worth)
        self._stale = True

    def exceeds(self, offsets: np.ndarray, target: float) -> bool:
        """Whether more is wanted than texels ``offsets`` until ``target``."""
        return exceeds(self._settled(), offsets, target)

    def descend(self, result: BakeResult, grown: bool) -> None:
        """Take in what a task left: the next one goes further down.

        What a newer view has told meanwhile of a want that has ``grown`` stands, and its new texels are lit first.
        """
        if grown:
            self._least = None
            return
        for claim in self.claims.values():
            claim.worth = result.worth / len(self.claims)
        patient = all(claim.viewer.patient for claim in self.claims.values())
        self.worth, self.effort, self._least = result.worth, result.effort, next_least(result, patient)

    def _weigh(self, change: float) -> None:
        """Take in by how much the worth has changed; not all claims are looked at, for there may be a thousand."""
        first = next(iter(self.claims.values())).worth if self.claims else 0.0
        self.worth = first if len(self.claims) < 2 else max(self.worth + change, 0.0)

    def _settled(self) -> Together:
        """What all claims want, worked out when it is asked for: most of them change again before that.

        New texels, or a stricter target, begin with their first light.
        """
        if self._stale and self.claims:
            before, self._together, self._stale = self._together, together(self.claims.values()), False
            if exceeds(self._together, before.offsets, before.target):
                self._least = None
        return self._together


def next_least(result: BakeResult, patient: bool) -> float:
    """The worth that paths must have to be taken in the task after one that left a ``result``.

    The rest of a chunk is one task where that is a short one; a longer one where none but who is ``patient`` waits.
    """
    rest = result.effort.left * result.cost.seconds / max(result.cost.paths, 1)
    return 0.0 if rest <= (WHOLE if patient else SHORT) else STEP * result.worth


def together(claims: Collection[Claim]) -> Together:
    """The texels of all ``claims``, ascending, the largest footprint of each, and the strictest target."""
    wanted = np.concatenate([claim.offsets for claim in claims])
    seen = np.full(1 + int(wanted.max(initial=-1)), -1.0, np.float32)
    np.maximum.at(seen, wanted, np.concatenate([claim.footprints for claim in claims]))
    offsets = np.flatnonzero(seen >= 0.0).astype(np.int32)
    return Together(offsets, seen[offsets], min(claim.target for claim in claims))


def exceeds(wanted: Together, offsets: np.ndarray, target: float) -> bool:
    """Whether more is ``wanted`` than texels ``offsets`` until ``target``."""
    return wanted.target < target or not contained(wanted.offsets, offsets)


def contained(offsets: np.ndarray, others: np.ndarray) -> bool:
    """Whether all ``offsets`` are among ``others``; both ascend."""
    if len(offsets) > len(others):
        return False
    places = np.minimum(np.searchsorted(others, offsets), len(others) - 1)
    return bool((others[places] == offsets).all())


def worth_of(demand: Demand) -> float:
    """The squared visible error over the paths that the light is of, or those of its first.

    The squared error falls with a power of the samples: that is what the next path takes off, times that power.
    """
    return demand.weight / (demand.effort.taken + FIRST_RUNG * demand.effort.unlit or FIRST_RUNG)
