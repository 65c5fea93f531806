"""A trial: what baking takes, told from a few texels of which nothing is kept."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.noise import relative_error
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.cache.chunk import Chunk
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texels import Demand
from isogi_core.report.bake import Bake

CHUNKS, TEXELS = 16, 16
"""Chunks that are tried, and texels of each, at most."""

SAMPLES = 256
"""Samples of each texel that are tried, at most; the rest is extrapolated."""


def seconds_each(renderer: Renderer, demands: Sequence[Demand], target: float) -> float:
    """Processor seconds that a demanded texel takes from darkness to a ``target``, a mean; zero where none is."""
    if not demands:
        return 0.0
    look = renderer.caches.look("gi")
    tried = [(demand.index, some(demand.offsets, TEXELS)) for demand in some(demands, CHUNKS)]
    texels = np.concatenate([Chunk.empty(index, look.plan).positions(offsets) for index, offsets in tried])
    Bake(renderer.tiles, look, look.plan.layers, texels[:1]).grow(FIRST_RUNG, target)  # kernels are had then
    bake = Bake(renderer.tiles, look, look.plan.layers, texels)
    bake.grow(FIRST_RUNG, target)
    first, before = bake.seconds, bake.samples
    bake.grow(SAMPLES, target)
    left = Effort.of(relative_error(bake.light, look), bake.light.samples, target).left
    more = (bake.samples - before) * (~bake.light.void).sum()
    return float(bake.seconds + (left * (bake.seconds - first) / more if more else 0.0)) / len(texels)


def some(these: Any, count: int) -> Any:
    """At most ``count`` of a sequence, spread evenly over it."""
    return these[:: -(-len(these) // count)]
