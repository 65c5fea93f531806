"""Visitors: people who look at views, turn them, rest until they are final, and leave."""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field

from benchmarks.scaling.simulator.light import Light
from benchmarks.scaling.simulator.world import Pause, Pending, World
from isogi_core.bake.noise import Goal
from isogi_core.frame.demand import Demand
from isogi_server.api.service import HEARTBEAT, REFINING, SHORTEST_PAUSE
from isogi_server.api.stream import WANT_EVERY
from isogi_worker.bake_requests import Viewer
from isogi_worker.baker import Baker

GOAL = Goal(0.05)
"""The goal of the recordings."""


@dataclass(frozen=True)
class Habits:
    """What visitors do: so many ``views`` each, all of them come within ``arrive`` seconds.

    Before each view they turn for up to ``turns`` views, think for ``think`` seconds on average
    after it, and go on before it is final when their ``patience`` ends. A share ``together`` of
    them looks at one scene, the others at one of their own; a share ``fixed`` of the views is the
    same for all.
    """

    views: int = 3
    arrive: float = 10.0
    turns: int = 6
    think: float = 3.0
    patience: float = 60.0
    together: float = 0.8
    fixed: float = 0.3


@dataclass
class Looked:
    """What became of a view at rest: seconds until all of it had light, and until it was final;
    None: not seen.
    """

    visitor: int
    light: float | None = None
    final: float | None = None
    given_up: bool = False


@dataclass(eq=False)
class Desk:
    """The server's processor: it draws frames, one after the other on each of its ``cores``,
    ``frame`` seconds each.
    """

    world: World
    frame: float
    cores: int = 2
    resting: int = 0
    _free_at: list[float] = field(default_factory=list)

    def draw(self) -> float:
        """Seconds until a frame that is asked for now is drawn."""
        self._free_at = sorted(self._free_at or [0.0] * self.cores)
        begun = max(self._free_at[0], self.world.now)
        self._free_at[0] = begun + self.frame
        return self._free_at[0] - self.world.now

    @property
    def pause(self) -> float:
        """Seconds between two pictures of a view at rest."""
        return max((1.0 / REFINING - 1.0) * self.frame * self.resting, SHORTEST_PAUSE)


class Visitor:
    """One of those who come."""

    def __init__(
        self,
        number: int,
        baker: Baker,
        light: Light,
        desk: Desk,
        habits: Habits,
        chance: random.Random,
    ) -> None:
        """Know where to look, and have looked at nothing."""
        self.number = number
        self.looked = list[Looked]()
        self._viewer = Viewer(number, number, single=True)
        self._baker = baker
        self._light = light
        self._desk = desk
        self._habits = habits
        self._chance = chance
        own = chance.random() >= habits.together
        self.scene = f"own {number}" if own else "hall"

    def live(self) -> Iterator[Pause]:
        """All that a visitor does."""
        yield Pause(self._chance.uniform(0.0, self._habits.arrive))
        for _ in range(self._habits.views):
            view = self._choose()
            for turn in range(self._chance.randint(0, self._habits.turns), 0, -1):
                yield Pause(self._desk.draw())
                self._baker.make_way()
                self._want(view - turn)
                yield Pause(WANT_EVERY)
            yield from self._rest(view)
            yield Pause(self._chance.expovariate(1.0 / self._habits.think))
        self._baker.leave(self._viewer)

    def _choose(self) -> int:
        """A view: the one that all know, or any."""
        if self._chance.random() < self._habits.fixed:
            return 0
        return self._chance.randrange(self._views)

    @property
    def _views(self) -> int:
        return len(self._light.recording.views)

    def _want(self, view: int) -> tuple[list[Demand], Pending]:
        """Look at a view: what it lacks, and what of that is coming."""
        demands = self._light.demands(self.scene, view % self._views)
        return demands, Pending(
            self.scene, self._baker.request(self.scene, demands, GOAL, self._viewer)
        )

    def _rest(self, view: int) -> Iterator[Pause]:
        """Look at a view until it is final, or for as long as there is patience."""
        begun = self._desk.world.now
        looked = Looked(self.number)
        self.looked.append(looked)
        while self._desk.world.now - begun < self._habits.patience:
            yield Pause(self._desk.draw())
            demands, pending = self._want(view)
            seconds = self._desk.world.now - begun
            if looked.light is None and not any(demand.effort.unlit for demand in demands):
                looked.light = seconds
            if not pending.chunks:
                if demands:
                    looked.final = None
                    looked.given_up = True
                else:
                    looked.final = seconds
                    looked.given_up = False
                return
            yield from self._until_better(pending)

    def _until_better(self, pending: Pending) -> Iterator[Pause]:
        """Wait as a stream does: for news, and then for a while, unless all has come."""
        self._desk.resting += 1
        yield Pause(HEARTBEAT, Pending(pending.scene, pending.chunks, some=True))
        if pending.chunks:
            left = frozenset(
                want
                for want in pending.chunks
                if self._baker.open(self.scene, [want], self._viewer)
            )
            yield Pause(self._desk.pause if left else 0.0, Pending(pending.scene, left))
        self._desk.resting -= 1
