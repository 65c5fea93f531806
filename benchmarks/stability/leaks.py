"""Cases of closed surfaces: rays that are followed through all crossings leave on the side that they must."""

from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.closed import CLOSED, SIDE
from benchmarks.stability.surface import Surface, surface_of
from isogi_core.kernels.intersect import OUTSIDE, SKIN, SOLID, UNKNOWN

GROUP = "rays"
EXPECTED = "through closed surfaces rays go in and out by turns: none leaks, hits twice, has a wrong side or never ends"

MOST_CROSSINGS = 500
BATCH = 1 << 18
"""Rays that are followed together."""

TOUCH = 1e-5
"""Voxels within which crossings are one place: there may be two, of a surface that is touched, and not three."""

SHALLOW = 1e-4
"""Heights at which rays start in the skin of a surface, where they may be taken for outside."""

AXES = np.concatenate([np.eye(3), -np.eye(3)])
ZEROS = (0.0, -0.0, 5e-324, -1e-310, 1e-200)


@dataclass
class Faults:
    """What is wrong with rays: how many leak, how many crossings are double or left on the wrong side, endless rays."""

    leaks: int = 0
    doubles: int = 0
    wrong: int = 0
    endless: int = 0

    def __add__(self, other: "Faults") -> "Faults":
        return Faults(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __str__(self) -> str:
        return f"{self.leaks} leaks, {self.doubles} doubles, {self.wrong} wrong sides, {self.endless} endless"


@case(GROUP, "closed surfaces, float32", EXPECTED, 0, "faults")
def closed_by_scouts(size: Size) -> Outcome:
    """What frames and bakes cast with."""
    return closed("float32", size.pick(30_000, 1_000_000, 100_000_000))


@case(GROUP, "closed surfaces, float64", EXPECTED, 0, "faults")
def closed_one_by_one(size: Size) -> Outcome:
    """The scalar caster."""
    return closed("float64", size.pick(30_000, 1_000_000, 100_000_000))


def closed(by: str, count: int) -> Outcome:
    """Follow ``count`` rays, shared between all closed surfaces."""
    surfaces = [surface_of(make(), isovalue) for make, isovalues in CLOSED.values() for isovalue in isovalues]
    rng, faults, share = np.random.default_rng(7), Faults(), -(-count // len(surfaces))
    for surface in surfaces:
        for batch in batches(share):
            faults = faults + follow(surface, *rays(rng, batch), by)
    return Outcome(sum(astuple(faults)), f"of {share * len(surfaces):,} rays at {len(surfaces)} surfaces: {faults}")


def batches(count: int) -> Iterator[int]:
    """Sizes of batches that make ``count``."""
    for first in range(0, count, BATCH):
        yield min(BATCH, count - first)


def rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from anywhere in the box, many from lattice points and middles, some from as far behind these.

    Directions are any, of integers, to lattice points, along axes, and all but along axes.
    """
    origins, directions = rng.uniform(0.0, SIDE - 1.0, (count, 3)), rng.normal(size=(count, 3))
    origins[::2], origins[::8] = np.rint(origins[::2]), np.rint(2.0 * origins[::8]) / 2.0
    kind = rng.integers(0, 5, count)
    whole, towards, along, nearly = (kind == n for n in range(1, 5))
    directions[whole] = rng.integers(-3, 4, (whole.sum(), 3))
    directions[towards] = rng.integers(0, SIDE, (towards.sum(), 3)) - origins[towards]
    directions[along | nearly] = AXES[rng.integers(0, 6, (along | nearly).sum())]
    directions[nearly] += rng.choice(ZEROS, (nearly.sum(), 3))
    directions[~directions.any(axis=1)] = (0.0, -0.0, 1.0)
    origins[1::8] -= 4.0 * SIDE * directions[1::8] / abs(directions[1::8]).max(axis=1, keepdims=True)
    return origins, directions


def follow(surface: Surface, origins: np.ndarray, directions: np.ndarray, by: str) -> Faults:
    """Cast rays, from each crossing on again with the side told, until none is left.

    Those that start in the skin are not judged by where they end.
    """
    heights = surface.height(origins)
    starts = np.where(heights > 0.0, SOLID, OUTSIDE)
    judged, ends = (heights == 0.0) | (abs(heights) > SHALLOW), starts.copy()
    faults, alive, sides, short = Faults(), np.arange(len(origins)), np.int8(UNKNOWN), np.zeros(len(origins), bool)
    for _ in range(MOST_CROSSINGS):
        t, came = surface.cast(origins, directions, sides, by)
        hit = np.isfinite(t)
        ways = t * abs(directions).max(axis=1)
        sure = hit & (ways > np.where(sides == UNKNOWN, SKIN, TOUCH))
        faults.wrong += strays(surface, origins, t, directions, came, sure)
        hop = hit & (ways < TOUCH) & (sides != UNKNOWN)
        faults.doubles += int((hop & short).sum())
        if not hit.any():
            break
        alive, short, sides = alive[hit], hop[hit], -came[hit]
        ends[alive] = sides
        origins, directions = origins[hit] + t[hit, None] * directions[hit], directions[hit]
    else:
        faults.endless = len(alive)
    faults.leaks = int((judged & (ends != OUTSIDE)).sum())
    return faults


def strays(
    surface: Surface, origins: np.ndarray, t: np.ndarray, directions: np.ndarray, came: np.ndarray, judged: np.ndarray
) -> int:
    """How many of the ``judged`` ways to a crossing are, in their middles, clearly on the other side than is said."""
    heights = surface.height(origins[judged] + 0.5 * t[judged, None] * directions[judged])
    return int((heights * came[judged] > 1e-9).sum())
