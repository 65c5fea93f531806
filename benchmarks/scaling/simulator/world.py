"""The world of a simulation: what happens, in the order of its time. Nothing sleeps, and nothing is
left to chance.
"""

import heapq
import itertools
from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from isogi_core.prepared.prepared_scene import Index

Deed = Callable[[], None]


@dataclass(eq=False)
class Pending:
    """Chunks of a ``scene`` that somebody waits for: until ``some`` have news, or until none is
    coming any more.
    """

    scene: str
    chunks: frozenset[Index]
    some: bool = False

    def __post_init__(self) -> None:
        self.left = set(self.chunks)


@dataclass(frozen=True)
class Pause:
    """So many seconds, or less where what is ``pending`` ends them."""

    seconds: float
    pending: Pending | None = None


Life = Generator[Pause, None, None]
"""What somebody does: the pauses in it are yielded."""


@dataclass(eq=False)
class Alarm:
    """Somebody's life, and the number of the pause that it is in."""

    life: Life
    pause: int = 0


@dataclass(eq=False)
class World:
    """A clock, and deeds that are due. Those of one moment are done in the order in which they were
    put off.
    """

    now: float = 0.0
    _due: list[tuple[float, int, Deed]] = field(default_factory=list)
    _numbers: "itertools.count[int]" = field(default_factory=itertools.count)
    _waiting: dict[tuple[str, Index], dict[Pending, Alarm]] = field(default_factory=dict)

    def __call__(self) -> float:
        """Seconds since the beginning."""
        return self.now

    def after(self, seconds: float, deed: Deed) -> None:
        """Do this so much later."""
        heapq.heappush(self._due, (self.now + seconds, next(self._numbers), deed))

    def begin(self, life: Life) -> None:
        """Have somebody live from now on."""
        self._go_on(Alarm(life))

    def run(self, over: Callable[[], bool] = lambda: False) -> None:
        """Do all that is due, until there is nothing or it is ``over``."""
        while self._due and not over():
            self.now, _, deed = heapq.heappop(self._due)
            deed()

    def news(self, scene: str, index: Index, more: bool) -> None:
        """There is light of a chunk, and whether ``more`` is coming: wake whom that concerns."""
        for pending, alarm in list(self._waiting.get((scene, index), {}).items()):
            if not more:
                pending.left.discard(index)
            if pending.some or not pending.left:
                self._wake(alarm, alarm.pause, pending)

    def _go_on(self, alarm: Alarm) -> None:
        pause = next(alarm.life, None)
        if pause is None:
            return
        alarm.pause += 1
        number = alarm.pause
        pending = pause.pending
        for key in keys_of(pending):
            self._waiting.setdefault(key, {})[pending] = alarm  # type: ignore[index]
        self.after(pause.seconds, lambda: self._wake(alarm, number, pending))

    def _wake(self, alarm: Alarm, number: int, pending: Pending | None) -> None:
        """End a pause, unless it has ended before."""
        if alarm.pause != number:
            return
        alarm.pause += 1
        for key in keys_of(pending):
            del self._waiting[key][pending]  # type: ignore[arg-type]
        self.after(0.0, lambda: self._go_on(alarm))


def keys_of(pending: Pending | None) -> list[tuple[str, Index]]:
    """The chunks that are pending, by scene and place."""
    if pending:
        return [(pending.scene, index) for index in pending.chunks]
    return []
