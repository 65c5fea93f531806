"""How calm light is at another albedo than the one that errors are held against: less is reflected, and less noise."""

import numpy as np

from isogi_core.bake.look import Look
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.albedos import mixing_weights

MOST = 100.0
"""How much the mean square of paths may fall at most: where next to nothing arrives unreflected."""


def scatter_at(weights: np.ndarray, scatter: np.ndarray, reflected: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """The ``scatter`` (m,) of texels at another albedo than that it is told of; float32, as all of these.

    ``weights`` (terms, 4) are those of ``weights_between``; ``reflected`` (m,) is the share of the variance that is
    reflected light's, ``kept`` (m, terms) band 0 of each term. What scatter is divided by, the deviation of single
    paths, falls with the albedo too.
    """
    now, then, paths_now, paths_then = np.maximum(kept @ weights, np.float32(1e-30)).T
    variance = 1.0 - reflected * (1.0 - np.minimum(now / then, 1.0))
    return np.asarray(scatter * np.sqrt(variance * np.clip(paths_then / paths_now, 1.0, MOST)), np.float32)


def weights_between(seen: Look, judged: Look) -> np.ndarray:
    """What ``scatter_at`` weighs terms with: squares of reflected paths, and of all, seen and judged; (terms, 4)."""
    squares = [reflected_weights(seen), reflected_weights(judged), all_weights(seen), all_weights(judged)]
    return np.ascontiguousarray(np.array(squares).T, np.float32)


def reflected_weights(look: Look) -> np.ndarray:
    """Of band 0 of each term, in the mean square of what reflected paths bring but for their light; (terms,) float64.

    A path that left after k bounces brings R^k, and its square is light of the albedo R². Of colours R_c that luminance
    mixes with w_c it is Σ w_c w_d (R_c R_d)^k.
    """
    mix, nodes = LUMINANCE * np.array(look.albedo), look.plan.nodes
    mix = mix / max(float(mix.sum()), 1e-30)
    pairs = [(c, d) for c in range(3) for d in range(3)]
    products = [mixing_weights(look.albedo[c] * look.albedo[d], nodes, look.plan.bounces) for c, d in pairs]
    return np.array([0.0, *np.array([mix[c] * mix[d] for c, d in pairs]) @ products])


def all_weights(look: Look) -> np.ndarray:
    """The same of all paths, over turns of the light that they meet, but for the surface itself; (terms,) float64."""
    squares = np.array([term.square[0] for term in look.terms])
    return np.asarray(squares / max(float(LUMINANCE @ look.albedo) ** 2, 1e-30))
