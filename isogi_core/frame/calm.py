"""How calm light is at another albedo than the one that errors are held against: less is reflected, and less noise."""

import numpy as np

from isogi_core.bake.look import Look
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.albedos import mixing_weights

MOST = 100.0
"""How much the mean square of paths may fall at most: where next to nothing arrives unreflected."""


def scatter_at(seen: Look, judged: Look, scatter: np.ndarray, reflected: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """The ``scatter`` (m,) of texels, which is of the ``judged`` look, at the albedo of the look that is ``seen``.

    ``reflected`` (m,) is the share of their variance that is reflected light's, ``kept`` (m, terms) band 0 of each
    term. A path that left after k bounces brings R^k, so that its square falls as light of the albedo R²; of colours
    R_c that are mixed with weights w_c it is Σ w_c w_d (R_c R_d)^k. What scatter is divided by, the deviation of single
    paths, falls too.
    """
    fall = squares_at(seen, kept) / np.maximum(squares_at(judged, kept), 1e-30)
    variance = 1.0 - reflected + reflected * np.clip(fall, 0.0, 1.0)
    paths = path_square(judged, kept) / np.maximum(path_square(seen, kept), 1e-30)
    return np.asarray(scatter * np.sqrt(variance * np.clip(paths, 1.0, MOST)), np.float32)


def squares_at(look: Look, kept: np.ndarray) -> np.ndarray:
    """Mean squares of what reflected paths of texels bring, but for the light that they meet; (m,) float64."""
    mix = LUMINANCE * np.array(look.albedo)
    mix = mix / max(float(mix.sum()), 1e-30)
    pairs = ((c, d) for c in range(3) for d in range(3))
    nodes, bounces = look.plan.nodes, look.plan.bounces
    weights = (mix[c] * mix[d] * mixing_weights(look.albedo[c] * look.albedo[d], nodes, bounces) for c, d in pairs)
    return np.asarray(kept[:, 1:] @ sum(weights))


def path_square(look: Look, kept: np.ndarray) -> np.ndarray:
    """Mean squares of what all paths of texels bring over turns of the light, but for the surface; (m,) float64."""
    squares = np.array([term.square[0] for term in look.terms])
    return np.asarray(kept @ squares / max(float(LUMINANCE @ look.albedo) ** 2, 1e-30))
