"""Growth of a reference: round after round of paths, until it is good enough or the time is spent."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.report.reference import REPLICAS, Reference, trace_reference

FIRST = 16
"""Paths per pixel of the first round; each further one doubles what there is."""

MOST = REPLICAS << 32
"""Paths per pixel for which there are random numbers."""

DECAY = 1.75
"""Samples that a noise takes grow as its inverse to this power: the points are stratified (demos under a sky)."""


@dataclass(frozen=True)
class Goal:
    """Where a reference stops to grow, by what comes first: so many ``samples``, a ``noise``, or ``seconds``."""

    samples: int | None = None
    noise: float | None = None
    seconds: float | None = None

    def met(self, reference: Reference) -> bool:
        """Whether a reference has the samples, or is as good as that."""
        enough = self.samples is not None and reference.samples >= self.samples
        return enough or (self.noise is not None and reference.noise <= self.noise)

    def foresee(self, reference: Reference) -> int | None:
        """The samples at which a reference is expected to stop, time aside; None where nobody can tell."""
        if self.samples is not None:
            return max(self.samples, reference.samples)
        if self.noise is None:
            return None
        wanted = reference.samples * max(reference.noise / self.noise, 1.0) ** DECAY
        return int(2 ** math.ceil(math.log2(wanted)))


def grow(
    renderer: Renderer,
    view: View,
    goal: Goal,
    former: Reference | None = None,
    cancelled: threading.Event | None = None,
    progress: Callable[[int], object] | None = None,
) -> Iterator[Reference]:
    """References of 16, 32, … paths per pixel, each grown from the one before or the ``former``, up to the ``goal``.

    The last one has what fits into the time, told from the rounds before; the first is made in any case. Raises
    what ``trace_reference`` does.
    """
    begun, reference, before = time.monotonic(), former, former.samples if former is not None else 0
    while reference is None or not goal.met(reference):
        taken = reference.samples if reference is not None else 0
        wanted = min(max(2 * taken, FIRST), goal.samples or MOST)
        if goal.seconds is not None and taken > before:
            spent = time.monotonic() - begun
            wanted = min(wanted, taken + fitting(goal.seconds - spent, spent / (taken - before)))
        if wanted <= taken:
            return
        reference = trace_reference(renderer, view, wanted, reference, cancelled, progress)
        yield reference


def fitting(seconds: float, each: float) -> int:
    """How many samples fit into ``seconds`` where ``each`` takes so long, a multiple of REPLICAS."""
    return int(max(seconds, 0.0) / max(each, 1e-9)) // REPLICAS * REPLICAS
