"""Converged light: a view's texels with so many samples that hardly any noise is left, as kept and unrounded."""

from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.frame.frame import Frame
from isogi_core.model.plan import Layer
from isogi_core.report.bake import Bake, ViewBake
from isogi_core.report.bench import Bench

TIMES = 4
"""How many times the samples that a texel of the frame has make converged light of it, at most."""

FEWEST, MOST = 256, 16384
"""Bounds of these samples."""


@dataclass(frozen=True, eq=False)
class Converged:
    """The frames of a view's converged light, rounded as the plan keeps it, and in single floats.

    ``samples`` is the mean of what its texels have.
    """

    kept: Frame
    exact: Frame
    samples: float


def converged(bench: Bench) -> Converged:
    """The view's converged light by the scene's plan; rounded and not, it is of the same paths."""
    return bench.once("converged", lambda: converge(bench))


def converge(bench: Bench) -> Converged:
    """Bake it. Raises Cancelled."""
    layers = bench.scene.plan.layers
    twins = tuple(map(unrounded, layers))
    both = ViewBake(bench.renderer(bench.scene), bench.view, layers + (() if twins == layers else twins))
    taken = np.max([part.samples for part in bench.planned.light.parts], axis=0)
    for samples in np.unique(taken[taken != 0]).tolist():
        grow_some(both, np.flatnonzero(taken == samples), rung_below(TIMES * samples), bench)
    kept, exact = (both.frame(Light(both.light.parts[a:][: len(layers)])) for a in (0, -len(layers)))
    return Converged(kept, exact, both.samples)


def grow_some(whole: Bake, rows: np.ndarray, samples: int, bench: Bench) -> None:
    """Bring some texels of a bake to so many samples."""
    some = Bake(whole.tiles, whole.look, whole.layers, whole.texels[rows], whole.levels[rows])
    some.grow(samples, cancelled=bench.cancelled)
    whole.light.put(rows, some.light)


def unrounded(layer: Layer) -> Layer:
    """The layer in single floats."""
    return replace(layer, half=False, coarse=None)


def rung_below(samples: float) -> int:
    """The last rung of the ladder of samples, of those that count as converged, that is not above ``samples``."""
    rung = FEWEST
    while 2 * rung <= min(samples, MOST):
        rung *= 2
    return rung
