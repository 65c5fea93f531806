"""Errands: light that is to be baked though no frame waits for it."""

from collections.abc import Iterable

from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand
from worker.baker import Baker
from worker.outlook import TimeLeft
from worker.viewers import Viewer

ERRAND = Viewer("errand", patient=True)
"""Errands yield to people who wait for a frame."""


class Errand:
    """Light that was asked of a ``baker``: what the ``demands`` want of a ``bake``, by its name, at a ``target``."""

    def __init__(
        self, baker: Baker, bake: str, demands: Iterable[Demand], target: float, viewer: Viewer = ERRAND
    ) -> None:
        """Ask for it, for a ``viewer``; ``coming`` are the chunks that were not given up before."""
        wanted = tuple(demands)
        self._baker, self._viewer = baker, viewer
        self.bake, self.chunks = bake, [demand.index for demand in wanted]
        self.coming = baker.want(bake, wanted, target, viewer)

    def waiting(self) -> int:
        """How many of its ``chunks`` are neither baked nor given up. Who looks now and then is not forgotten."""
        return self._baker.open(self.bake, self.chunks, self._viewer)

    def failures(self) -> dict[Index, str]:
        """Why those of its chunks that were given up were."""
        return self._baker.failures(self.bake, self.chunks)

    def wait(self, seconds: float) -> None:
        """Block until all of it is baked or given up, at most ``seconds``."""
        self._baker.wait(self.bake, self.chunks, seconds)

    def time_left(self) -> TimeLeft | None:
        """Seconds until all of it is baked; None where that is unknown."""
        return self._baker.time_left(self.bake, self._viewer, self.chunks)
