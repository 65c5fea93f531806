"""Light that is pretended to be baked: how far each texel is up its chunk's ladder, and what a task
does to it.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np

from benchmarks.scaling.simulator.recording import TEXELS, Ladder, Recording, Sight
from isogi_core.bake.noise import Effort
from isogi_core.cache.costs import Cost
from isogi_core.frame.demand import Demand
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.tasks import BakeResult


@dataclass(eq=False)
class Light:
    """The store of all scenes, each a copy of the ``recording``."""

    recording: Recording
    _levels: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)

    def price(self, scene: str, chunk: int, offsets: np.ndarray) -> float:
        """Processor seconds that ``bake`` would take."""
        ladder = self.recording.ladders[chunk]
        own = self._of(scene, chunk)[offsets]
        level = int(own.min(initial=len(ladder.steps)))
        if level == len(ladder.steps):
            return 0.0
        return cost_of(ladder, level, int((own == level).sum())).seconds

    def bake(self, scene: str, chunk: int, offsets: np.ndarray) -> BakeResult:
        """Take the texels that are furthest behind one step on, as a task does; what it took, and
        what it left.
        """
        ladder = self.recording.ladders[chunk]
        levels = self._of(scene, chunk)
        own = levels[offsets]
        if own.min(initial=len(ladder.steps)) == len(ladder.steps):
            return BakeResult(0, 0.0, Effort(0, 0.0, 0.0), Cost(), duplicate=True)
        behind = offsets[own == own.min()]
        cost = cost_of(ladder, int(own.min()), len(behind))
        levels[behind] += 1
        counts = np.bincount(levels[offsets], minlength=len(ladder.steps) + 1)
        unfinished = sum(
            n * step.unfinished for n, step in zip(counts[1:], ladder.steps, strict=True)
        )
        return BakeResult(
            round(unfinished) + int(counts[0]),
            worth_of(ladder, counts),
            effort_of(ladder, counts),
            cost,
        )

    def demands(self, scene: str, view: int) -> list[Demand]:
        """What a view lacks: the chunks with texels that are not final."""
        found = (self._demand(scene, sight) for sight in self.recording.views[view])
        return [demand for demand in found if demand is not None]

    def _demand(self, scene: str, sight: Sight) -> Demand | None:
        ladder = self.recording.ladders[sight.chunk]
        counts = np.bincount(
            self._of(scene, sight.chunk)[sight.offsets], minlength=len(ladder.steps) + 1
        )
        if counts[-1] == len(sight.offsets):
            return None
        visible = [1.0, *(step.worth * max(step.taken, 1.0) for step in ladder.steps)]
        share = [1.0, *(each / max(visible[1], 1e-30) for each in visible[1:])]
        weight = sight.weight * float(counts @ share) / len(sight.offsets)
        seen = np.ones(len(sight.offsets), np.float32)
        return Demand(place_of(sight.chunk), sight.offsets, weight, effort_of(ladder, counts), seen)

    def _of(self, scene: str, chunk: int) -> np.ndarray:
        """How many steps each texel of a chunk has behind it, (TEXELS,) int8; none at first."""
        return self._levels.setdefault((scene, chunk), np.zeros(TEXELS, np.int8))


def place_of(chunk: int) -> Index:
    """A chunk's place, made of its number."""
    return 0, 0, chunk


def cost_of(ladder: Ladder, level: int, texels: int) -> Cost:
    """What it takes to bring so many texels from a level to the next."""
    share = texels / ladder.texels
    step = ladder.steps[level]
    if level == 0:
        lit = texels
        seconds = share * step.seconds
    else:
        lit = 0
        seconds = 0.0
    return Cost(share * step.seconds, round(share * step.paths), lit, seconds)


def worth_of(ladder: Ladder, counts: np.ndarray) -> float:
    """What the next path of texels is worth, a mean; so many are at each level."""
    open_steps = [
        (n, step.worth) for n, step in zip(counts[1:-1].tolist(), ladder.steps, strict=False)
    ]
    texels = sum(n for n, _ in open_steps)
    if texels:
        return sum(n * worth for n, worth in open_steps) / texels
    return 0.0


def effort_of(ladder: Ladder, counts: np.ndarray) -> Effort:
    """What texels have taken and will, so many of them at each level."""
    at = list(itertools.zip_longest(counts[1:].tolist(), ladder.steps))
    taken = sum(n * step.taken for n, step in at if step) / ladder.texels
    left = sum(n * step.left for n, step in at if step) / ladder.texels
    return Effort(int(counts[0]), taken, left)
