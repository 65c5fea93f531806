"""One run of a simulation, and what is measured of it."""

import random
import statistics
import time
from collections.abc import Callable, Hashable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.scaling.simulator.cluster import Cluster, Conditions
from benchmarks.scaling.simulator.light import Light
from benchmarks.scaling.simulator.recording import Recording
from benchmarks.scaling.simulator.visitors import GOAL, Desk, Habits, Looked, Visitor
from benchmarks.scaling.simulator.world import World
from isogi_core.bake.noise import Goal
from isogi_core.cache.costs import Costs
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.demand import Demand
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_worker.bake_requests import Viewer
from isogi_worker.baker import Bake, Baker
from isogi_worker.pool import Done, WorkerPool
from isogi_worker.tasks import BakeTask

FRAME = 0.02
"""Seconds that the server draws a frame: 512 × 512 pixels, two cores."""

PLAN = ScenePlan("transfer", (Layer("direct", 5),), 5, 4, 1.0, 4096)
NOWHERE = StoreUrl("memory://")
JOB = Viewer("job", patient=True)


class Forgotten(Costs):
    """Costs that are known and not written anywhere."""

    def save(self, at_once: bool = True) -> None:
        """Keep nothing."""


class Timed(Baker):
    """The real baker, with the processor seconds that it takes of the server: they are measured,
    not simulated.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__(clock, None)
        self.calls = self.seconds = 0.0

    def want(
        self, scene: str, demands: Iterable[Demand], goal: Goal, viewer: Viewer = JOB
    ) -> frozenset[Index]:
        """As the baker does, timed."""
        begun = time.process_time()
        try:
            return super().request(scene, demands, goal, viewer)
        finally:
            self._took(begun)

    def leave(self, viewer: Viewer) -> None:
        """As the baker does, timed."""
        begun = time.process_time()
        super().leave(viewer)
        self._took(begun)

    def timed(self, done: Done) -> Done:
        """What is told of a task, timed."""

        def told(*ended: Any) -> None:
            begun = time.process_time()
            done(*ended)
            self._took(begun)

        return told

    def _took(self, begun: float) -> None:
        self.seconds = self.seconds + time.process_time() - begun
        self.calls = self.calls + 1


class Timing(Cluster):
    """A cluster whose tasks tell of their ends under the baker's stopwatch."""

    baker: Timed

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over."""
        super().submit(task, self.baker.timed(done))


@dataclass(eq=False)
class Site:
    """All of a simulation: its ``world``, ``light``, ``baker`` and ``cluster``."""

    world: World
    light: Light
    baker: Timed
    cluster: Timing
    chance: random.Random


def site(recording: Recording, conditions: Conditions, scenes: Iterable[str], seed: int) -> Site:
    """A site where nobody has looked at anything."""
    world = World()
    light = Light(recording)
    chance = random.Random(seed)
    baker = Timed(world)
    cluster = Timing(world, light, conditions, chance)
    cluster.baker = baker
    for scene in scenes:
        source = SceneSource(scene, {}, Path())
        costs = Forgotten(Store(NOWHERE), scene, world)
        baker.add(
            scene, Bake(source, PLAN, scene, frozenset({scene}), NOWHERE, lambda _: None, costs)
        )
    baker.listen(world.news)
    baker.use_pool(cast(WorkerPool, cluster))
    return Site(world, light, baker, cluster, chance)


@dataclass(frozen=True)
class Visits:
    """What a run with visitors came to.

    Views that were looked at, seconds to their first light and to final, medians and 95 %; the
    share that was final before patience ended; ``fairness``, the longest mean time to light of a
    visitor over the median one; tasks done, begun again after a death, and failed; processor
    seconds baked, and lost in tasks that failed; simulated seconds from the first who came to the
    last who left; whether a task was handed over after that; and the seconds that the baker itself
    took of the server's processor, which are real.
    """

    views: int
    light: float
    light_95: float
    final: float
    final_95: float
    done_share: float
    given_up: int
    fairness: float
    tasks: int
    again: int
    failed: int
    baked: float
    lost: float
    seconds: float
    late: bool
    calls: int
    baker: float

    def figures(self) -> dict[str, Any]:
        """By name."""
        return asdict(self)


def visit(
    recording: Recording, conditions: Conditions, visitors: int, habits: Habits, seed: int = 0
) -> tuple[Visits, Site]:
    """So many visitors come, look and leave; the figures, and the site as they left it."""
    place = site(
        recording, conditions, ("hall", *(f"own {number}" for number in range(visitors))), seed
    )
    desk = Desk(place.world, FRAME)
    people = [
        Visitor(n, place.baker, place.light, desk, habits, place.chance) for n in range(visitors)
    ]
    left = set(people)
    ended: list[float] = []

    def live(visitor: Visitor) -> Any:
        yield from visitor.live()
        left.discard(visitor)
        ended.append(place.world.now)

    for visitor in people:
        place.world.begin(live(visitor))
    place.world.run(lambda: not left and place.baker.tally().in_flight == 0)
    return figures(place, people, ended[-1]), place


def figures(place: Site, people: list[Visitor], end: float) -> Visits:
    """What is told of a run."""
    looked = [each for visitor in people for each in visitor.looked]
    light = known(each.light for each in looked)
    final = known(each.final for each in looked)
    cluster = place.cluster
    baker = place.baker
    return Visits(
        views=len(looked),
        light=quantile(light, 0.5),
        light_95=quantile(light, 0.95),
        final=quantile(final, 0.5),
        final_95=quantile(final, 0.95),
        done_share=len(final) / len(looked),
        given_up=sum(each.given_up for each in looked),
        fairness=fairness(looked),
        tasks=cluster.done,
        again=cluster.again,
        failed=cluster.failed,
        baked=cluster.busy,
        lost=cluster.lost,
        seconds=end,
        late=cluster.last_handed > end,
        calls=int(baker.calls),
        baker=baker.seconds,
    )


def fairness(looked: list[Looked]) -> float:
    """The longest mean time to light of a visitor over the median one; 1 where all were served
    alike.
    """
    own: dict[Hashable, list[float]] = {}
    for each in looked:
        own.setdefault(each.visitor, []).extend(known([each.light]))
    means = [statistics.fmean(seconds) for seconds in own.values() if seconds]
    if means:
        return max(means) / max(statistics.median(means), 1e-9)
    return 1.0


def known(seconds: Iterable[float | None]) -> list[float]:
    """Those that are."""
    return [each for each in seconds if each is not None]


def quantile(values: list[float], share: float) -> float:
    """A quantile; 0 of nothing."""
    if values:
        return float(np.quantile(values, share))
    return 0.0


@dataclass(frozen=True)
class Throughput:
    """What a batch came to: processor ``seconds`` baked, over those of all ``workers`` until its
    end (``efficiency``).

    ``makespan`` is simulated, ``decision`` the real processor seconds that the baker takes for a
    task.
    """

    workers: int
    tasks: int
    seconds: float
    makespan: float
    efficiency: float
    decision: float


def batch(recording: Recording, conditions: Conditions, scenes: int, seed: int = 0) -> Throughput:
    """Bake all views of so many scenes, as ``isogi prewarm`` asks for them: all at once, by one
    patient client.
    """
    names = [f"scene {number}" for number in range(scenes)]
    place = site(recording, conditions, names, seed)
    for name in names:
        for view in range(len(recording.views)):
            place.baker.request(name, place.light.demands(name, view), GOAL, JOB)
    place.world.run(lambda: place.baker.tally().waiting == 0)
    cluster = place.cluster
    makespan = place.world.now
    baker = place.baker
    efficiency = cluster.busy / (conditions.workers * makespan)
    return Throughput(
        conditions.workers,
        cluster.done,
        cluster.busy,
        makespan,
        efficiency,
        baker.seconds / max(cluster.done, 1),
    )
