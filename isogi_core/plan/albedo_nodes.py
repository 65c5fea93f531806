"""Albedo nodes: the albedos that reflected light is kept for, and weights that mix light of any
other albedo from these.

Light that arrives at a texel after k bounces, Σ R^k τ_k, is a curve of the albedo R. It is kept at
a few nodes R_j, from the same paths, and mixed: Σ v_j(R) Σ R_j^k τ_k. If all hits were alike, each
with the chance f that the path leaves, then τ_k = f (1 - f)^k. The weights v are the least-squares
fit of such light for all chances f, and so fit all mixtures of them. At a node its weight is 1 and
all others are 0; at albedo 0 all weights are 0.

Nodes take fewer numbers than light after each bounce, and fewer than a polynomial through the
nodes. Measured on texels of the engine, the CT head, the MNI brain, the carp, the bonsai and the
casting, with paths of 43 bounces: three nodes up to albedo 0.9 have an error of 0.24 to 0.40 % of
all light (root mean square at the worst albedo), and 0.42 % was predicted; cubic polynomials
through 0 and three Chebyshev nodes have 0.6 to 2.9 %.
"""

from functools import cache

import numpy as np

MAX_NODES = 6
"""Most nodes of a layer: each takes a channel of every texel."""

ESCAPE_CHANCES = np.geomspace(1e-3, 0.98, 96)
"""Chances f to leave at each hit for which the weights are fitted: from deep cavities to nearly
open places.
"""

EVALUATED_ALBEDOS = 48
"""Number of even steps of the albedo at whose ends ``mixing_error`` is evaluated."""


@cache
def choose_nodes(most: float, bounces: int, allowed: float) -> tuple[float, ...]:
    """Choose the fewest nodes up to an albedo ``most`` with which light of ``bounces`` has at most
    the ``allowed`` error.

    The error is relative to all light of a texel. If MAX_NODES nodes do not reach it, they are
    returned.
    """
    # Try one node first, then one more at a time.
    tries = (spread_nodes(count, most, bounces) for count in range(1, MAX_NODES + 1))
    return next(
        (nodes for nodes in tries if mixing_error(nodes, bounces) <= allowed),
        spread_nodes(MAX_NODES, most, bounces),
    )


def spread_nodes(count: int, most: float, bounces: int) -> tuple[float, ...]:
    """Return ``count`` ascending albedos up to ``most``, evenly spaced in the logarithm of 1 - R,
    as light of deep cavities varies.

    With few ``bounces`` the light varies less near 1, and the last nodes are farther apart from it.
    """
    # Short paths do not resolve deep cavities: spread nodes as if the highest albedo were at most
    # 1 - 1 / (bounces + 1), then stretch them to ``most``.
    depth = min(most, 1.0 - 1.0 / (bounces + 1))
    steps = np.arange(1, count + 1) / count
    return tuple((most * (1.0 - (1.0 - depth) ** steps) / depth).tolist())


@cache
def mixing_error(nodes: tuple[float, ...], bounces: int) -> float:
    """Return the largest error of light mixed from ``nodes``, relative to all light of a texel,
    over all lower albedos and ESCAPE_CHANCES.
    """
    # Compare mixed with true light at even albedos, for cavities of every chance to leave; direct
    # light f is part of all light.
    kept = reflected_light(np.array(nodes), bounces)
    albedos = nodes[-1] * np.arange(1, EVALUATED_ALBEDOS) / EVALUATED_ALBEDOS
    light = reflected_light(albedos, bounces)
    mixed = kept @ np.array([mixing_weights(albedo, nodes, bounces) for albedo in albedos]).T
    return float((np.abs(mixed - light) / (ESCAPE_CHANCES[:, None] + light)).max())


@cache
def mixing_weights(albedo: float, nodes: tuple[float, ...], bounces: int) -> np.ndarray:
    """Return the weights v_j(R) of the light kept at each of the ``nodes`` for an ``albedo`` R;
    (nodes,) float64, read-only.
    """
    kept = reflected_light(np.array(nodes), bounces)
    light = reflected_light(np.array([albedo]), bounces)
    # Fit relative to all light, direct and reflected, so that the error is even over cavities and
    # open places.
    whole = ESCAPE_CHANCES[:, None] + light
    weights = np.linalg.lstsq(kept / whole, (light / whole)[:, 0], rcond=None)[0]
    weights.flags.writeable = False
    return np.asarray(weights)


def reflected_light(albedos: np.ndarray, bounces: int) -> np.ndarray:
    """Return Σ R^k f (1 - f)^k over k = 1 … ``bounces``, for each f of ESCAPE_CHANCES and each
    R of ``albedos``; (chances, albedos).
    """
    ratio = albedos * (1.0 - ESCAPE_CHANCES)[:, None]
    return np.asarray(ESCAPE_CHANCES[:, None] * ratio * (1.0 - ratio**bounces) / (1.0 - ratio))
