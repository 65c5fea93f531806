"""Balls and slabs that light passes, as the kernels take them, and what paths bring there."""

import numpy as np

from isogi_core.kernels.transport.matter.matter_paths import Through, light_through_matter
from isogi_core.kernels.transport.matter.passage import Matter, Passable
from isogi_core.kernels.transport.matter.sight import NO_SAMPLE, Chances, Leaves, see_through
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from tests.kernels.fields import cells_of, field_of, surface_of
from tests.kernels.rooms import room_of, sky


def ball(radius, side):
    """A ball in the middle of a box of so many voxels: solid where the field is above 0."""
    place = np.mgrid[:side, :side, :side] - (side - 1) / 2
    return field_of(radius - np.sqrt((place**2).sum(axis=0)))


def slab(low, high, side=8):
    """A slab between two heights."""
    z = np.mgrid[:side, :side, :side][0]
    return field_of((high - low) / 2.0 - np.abs(z - (low + high) / 2.0))


def passable(walls=(), index=1.5, absorption=0.0, extinction=0.0, albedo=1.0):
    """Some walls, and matter of one grey."""
    matter = Matter(
        float(index), np.full(3, float(absorption)), float(extinction), np.full(3, float(albedo))
    )
    return Passable(room_of(list(walls)), matter)


def gather(field, met, starts, samples, light=None, bounces=0, survival=1.0):
    """What paths bring (g, 3) to ``starts``: points and normals (g, 3), and what is in place of
    walls' numbers (g,).
    """
    points, normals, walls = (np.array(each, float) for each in starts)
    g = len(points)
    here = np.ascontiguousarray((points / field.spacing).T)
    around = np.ascontiguousarray(normals.T)
    starts = PathStarts(here, around, np.zeros(g), np.arange(1, g + 1, dtype=np.uint64), walls)
    rules = PathRules(np.ones((bounces + 1, 3)), survival)
    sums = np.zeros((g, 3))
    some = SampleRange(0, samples)
    around = light or sky(0.0)
    light_through_matter(
        Through(field, cells_of(field, 0.0), *met), starts, some, rules, around, sums
    )
    return sums / samples


LEAVES = 8
"""Places that a point sees."""


def look(field, met, eye, points, light=None, breadth=LEAVES, samples=(NO_SAMPLE,), deep=256):
    """What is seen from an ``eye`` through ``points`` (n, 3), by a tree of each for all
    ``samples``: the Leaves.
    """
    places = np.repeat(np.ascontiguousarray(points, np.float32), len(samples), axis=0)
    n = len(places)
    weights, ends = np.empty((2, n * breadth, 3), np.float32)
    kinds, sides = np.empty((2, n * breadth), np.int8)
    leaves = Leaves(
        np.empty((n, 3), np.float32), weights, ends, kinds, sides, np.empty(n, np.float32)
    )
    seeds = np.repeat(np.arange(1, len(points) + 1, dtype=np.uint64), len(samples))
    chances = Chances(seeds, np.tile(np.array(samples, np.int64), len(points)), deep)
    see_through(
        surface_of(field, 0.0),
        met,
        light or sky(0.0),
        tuple(map(float, eye)),
        places,
        chances,
        leaves,
    )
    return leaves
