"""Rescale the noise of texels from the albedo at which it was estimated to that of a view."""

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.albedo_nodes import mixing_weights

MAX_SQUARES_RATIO = 100.0
"""Limit of the ratio of mean squares of paths: next to no light may arrive unreflected."""


def scatter_at(
    weights: np.ndarray, scatter: np.ndarray, reflected: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """Return the ``scatter`` (m,) of texels rescaled from the albedo at which it was estimated to
    another; all float32.

    ``weights`` (terms, 4) are from ``weights_between``, ``reflected`` (m,) is the share of the
    variance that reflected light has, and ``kept`` (m, terms) is band 0 of each term. Scatter is
    relative to the deviation of single paths, which falls with the albedo, too.

    Noise was estimated at the highest albedo that views may ask for. So at the other one reflected
    light has no more variance, and paths no larger squares; the limits below keep to that.
    """
    now, then, paths_now, paths_then = np.maximum(kept @ weights, np.float32(1e-30)).T
    # The part of the variance that reflected light has falls as the mean square of its paths.
    variance = 1.0 - reflected * (1.0 - np.minimum(now / then, 1.0))
    # Scatter is relative to the root of the mean square of all paths.
    ratio = np.clip(paths_then / paths_now, 1.0, MAX_SQUARES_RATIO)
    return np.asarray(scatter * np.sqrt(variance * ratio), np.float32)


def weights_between(seen: BakeSpec, judged: BakeSpec) -> np.ndarray:
    """Return the weights of terms that ``scatter_at`` needs: of the mean square of reflected
    paths, and of all paths, at the albedos of two specs; (terms, 4).
    """
    squares = [
        reflected_weights(seen),
        reflected_weights(judged),
        all_weights(seen),
        all_weights(judged),
    ]
    return np.ascontiguousarray(np.array(squares).T, np.float32)


def reflected_weights(spec: BakeSpec) -> np.ndarray:
    """Return the weight of band 0 of each term in the mean square of reflected paths, without the
    light that they meet, which is the same for any albedo; (terms,) float64.

    A path that leaves after k bounces brings R^k; the square of that is light of the albedo R². Of
    colours R_c that luminance mixes with w_c, it is Σ w_c w_d (R_c R_d)^k.
    """
    mix = LUMINANCE_WEIGHTS * np.array(spec.albedo)
    mix = mix / max(float(mix.sum()), 1e-30)
    pairs = [(c, d) for c in range(3) for d in range(3)]
    weights = np.array([mix[c] * mix[d] for c, d in pairs])
    # The light of each product of albedos, as mixed of the albedos that texels keep it for.
    nodes = spec.plan.nodes
    products = [
        mixing_weights(spec.albedo[c] * spec.albedo[d], nodes, spec.plan.bounces) for c, d in pairs
    ]
    # Direct light is the first term, and reflects nothing.
    return np.array([0.0, *weights @ products])


def all_weights(spec: BakeSpec) -> np.ndarray:
    """Return the weight of band 0 of each term in the mean square over all paths and all rotations
    of the light; (terms,) float64.

    The albedo of the surface that paths start on is taken out.
    """
    squares = np.array([term.square[0] for term in spec.terms])
    return np.asarray(squares / max(float(LUMINANCE_WEIGHTS @ spec.albedo) ** 2, 1e-30))
