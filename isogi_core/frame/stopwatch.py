"""A stopwatch: how long each stage of a frame took."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(eq=False)
class Stopwatch:
    """Seconds of each stage of one frame, in order, since it has ``begun``. No second counts in two stages."""

    begun: float = field(default_factory=time.perf_counter)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block as stage ``name``, without the stages inside it."""
        begun, others = time.perf_counter(), sum(self.seconds.values())
        yield
        inside = sum(self.seconds.values()) - others
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun - inside

    @property
    def elapsed(self) -> float:
        """Seconds since it has begun."""
        return time.perf_counter() - self.begun
