"""Glowing regions as the kernels take them, and what they give by brute force."""

import numpy as np

from isogi_core.kernels.tracing.glow import NO_BITS, Glows
from isogi_core.kernels.transport.glow_paths import glow_in_room
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.kernels.transport.room_paths import InRoom
from tests.kernels.fields import cells_of
from tests.kernels.rooms import starts_in


def ball(centre, radius, low=-np.inf, high=np.inf):
    """A glowing ball as ``glows_of`` takes it, with the rate that makes rays across it gather 1 in
    the mean.
    """
    return centre, [radius] * 3, 1.0, radius, low, high, 0.75 / radius


def block(centre, half, low=-np.inf, high=np.inf):
    """The same of a box with half edges ``half``."""
    x, y, z = half
    rate = 2.0 * (x * y + y * z + z * x) / (8.0 * x * y * z)
    return centre, half, 0.0, float(np.linalg.norm(half)), low, high, rate


def glows_of(*regions, bits=None):
    """Some regions as kernels take them; in the masks of ``bits``, all of them, where these are
    given.
    """
    centres, halves, *rest = zip(*regions, strict=True)
    rows = (np.ascontiguousarray(np.array(each, float).T) for each in (centres, halves))
    columns = [np.array(each, float) for each in rest]
    masked = np.full(len(regions), float(bits is not None))
    if bits is not None:
        columns[2] = np.maximum(columns[2], np.finfo(float).min)
    return Glows(*rows, *columns, masked, NO_BITS if bits is None else bits)


def gather_glow(field, room, starts, glows, samples, bounces=0, survival=1.0):
    """E/π (g, k, 3) at ``starts``: see ``starts_in``."""
    given = starts_in(field, *starts)
    g = len(starts[0])
    k = len(glows.rates)
    rules = PathRules(np.ones((bounces + 1, 3)), survival)
    sums = np.zeros((g, 3 * k))
    glow_in_room(
        InRoom(field, cells_of(field, 0.0), room),
        given,
        SampleRange(0, samples),
        rules,
        glows,
        sums,
    )
    return sums.reshape(g, k, 3) / samples


def brute_force(p, n, region, inside, count=120):
    """E/π of a region without anything before it, from ``count``³ points of it: Σ rate cosθ dV / (π
    r²).
    """
    centre, half, _, _, _, _, rate = region
    steps = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    places = (
        np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3) * half
        + centre
    )
    places = places[inside(places)]
    away = places - p
    square = (away**2).sum(axis=1)
    each = np.maximum(away @ n, 0.0) / square**1.5
    return rate * each.sum() * 8.0 * np.prod(half) / count**3 / np.pi
