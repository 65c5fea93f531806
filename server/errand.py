"""Errands: light that is to be baked though no frame waits for it."""

from collections.abc import Iterable

from isogi_core.frame.texels import Demand
from worker.baker import Baker
from worker.outlook import TimeLeft


class Errand:
    """Light that was asked of a ``baker``: what the ``demands`` want of a ``bake``, by its name, at a ``target``."""

    def __init__(self, baker: Baker, bake: str, demands: Iterable[Demand], target: float) -> None:
        """Ask for it."""
        wanted = tuple(demands)
        self._baker, self._bake, self.chunks = baker, bake, [demand.index for demand in wanted]
        baker.want(bake, wanted, target)

    def waiting(self) -> int:
        """How many of its ``chunks`` are neither baked nor given up. Who looks now and then is not forgotten."""
        return self._baker.open(self._bake, self.chunks)

    def wait(self, seconds: float) -> None:
        """Block until all of it is baked or given up, at most ``seconds``."""
        self._baker.wait(self._bake, self.chunks, seconds)

    def time_left(self) -> TimeLeft | None:
        """Seconds until all of it is baked; None where that is unknown."""
        return self._baker.time_left(self._bake, "errand", self.chunks)
