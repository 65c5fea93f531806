"""Light of what glows, by paths from points of their own: see ``kernels.transport.glow_paths``."""

import numpy as np

from isogi_core.bake.path_light import add_glow_paths
from isogi_core.frame.lighting import RotatedLight
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange


def add_glow(
    sums: np.ndarray,
    light: RotatedLight,
    traced: TracedSurface,
    starts: PathStarts,
    rules: PathRules,
    samples: SampleRange,
) -> None:
    """Add a ``SampleRange`` of E/π of what glows at ``starts`` about a surface to ``sums`` (g, 3), where there is any.

    Bounces count as in ``light_in_room``, the first weight of the ``rules`` all.
    """
    prepared = light.spec.prepared
    if not prepared.scene.lighting.glowing.any:
        return
    radiances = light.glow * prepared.scene.lighting.glowing.radiances
    own = np.zeros((len(sums), radiances.size))
    add_glow_paths(prepared, traced.cells, light.seen.albedo, starts, samples, rules, own)
    sums += np.einsum("gkc,kc->gc", own.reshape(-1, *radiances.shape), radiances)
