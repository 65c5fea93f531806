"""Cases of rays that start on a surface or far away, and of leaping over empty space."""

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.closed import CLOSED, MIDDLE, SIDE
from benchmarks.stability.leaks import GROUP, rays
from benchmarks.stability.shapes import grid
from benchmarks.stability.surface import ARITHMETICS, Surface, surface_of
from isogi_core.kernels.bounces import bounce_rays
from isogi_core.kernels.field import OFFSET

EXACT = ((0, 0, 1), (1, 0, 0), (1, 2, 2), (-2, 3, 6))
"""Normals of planes that float32 voxels hold exactly."""

TILTED = ((0.31, -0.77, 0.52), (0.02, 0.01, 1.0))

EPSILON = float(np.finfo(np.float64).eps)
"""What the last bit of a double is worth, of its value, at most."""


def plane(normal: tuple[float, ...], offset: float) -> np.ndarray:
    """Solid below a plane through the middle of the volume, on values that are ``offset`` off, float64."""
    x, y, z = grid(SIDE, SIDE, SIDE)
    return offset - (normal[0] * x + normal[1] * y + normal[2] * z)


@case(GROUP, "self-hits on planes", "rays that leave a plane, however flat, never meet it again", 0, "self-hits")
def self_hits(size: Size) -> Outcome:
    """Planes that voxels hold exactly, without an offset; any tilt, with the offset of a path; both also off centre."""
    count, hits, planes = size.pick(2_500, 30_000, 3_000_000), 0, 0
    for lift, normals in ((0.0, EXACT), (OFFSET, EXACT + TILTED)):
        for normal in normals:
            for offset in (0.0, 1000.0):
                hits += self_hits_of(surface_of(plane(normal, offset), offset, offset=lift), normal, count)
                planes += 1
    return Outcome(hits, f"of {planes * count:,} rays from {planes} planes")


def self_hits_of(surface: Surface, normal: tuple[float, ...], count: int) -> int:
    """Meet the plane from above, leave it by cosine rays, many of which graze, and count what meets it again."""
    rng, up = np.random.default_rng(9), np.array(normal) / np.linalg.norm(normal)
    origins = MIDDLE + rng.uniform(-5.0, 5.0, (count, 3)) + 9.0 * up
    directions = np.broadcast_to(-up, origins.shape)
    t, came = surface.cast(origins, directions)
    columns = [np.ascontiguousarray(v.T) for v in (origins, directions)]
    numbers = rng.random((2, count))
    numbers[0, ::3] = 10.0 ** rng.uniform(-12.0, -2.0, numbers[0, ::3].shape)
    bounce_rays(surface.field, np.full(count, surface.level), *columns, t, came, numbers)
    starts, ways = (v.T for v in columns)
    return sum(int(np.isfinite(surface.cast(starts, ways, came, by)[0]).sum()) for by in ARITHMETICS)


LAST_BIT = """\
A ray that meets the surface right at the corner of a macrocell comes into the hit's cell by another way than one that \
walks there, and the last bit of where it enters may differ: 1 of 1,008,000 rays was seen to, and none by more. \
Pictures are the same, bit for bit (see sameness)."""


@case(GROUP, "empty space", "leaping over empty space, by macrocells and by maps, changes no hit", 10, "rays", LAST_BIT)
def empty_space(size: Size) -> Outcome:
    """Scouts with maps, and macrocells, against a walk through every cell: more than the last bit is not forgiven."""
    surfaces = [surface_of(make(), isovalue) for make, isovalues in CLOSED.values() for isovalue in isovalues]
    rng, share, differ, beyond = np.random.default_rng(10), size.pick(1_000, 42_000), 0, 0
    for surface in surfaces:
        some = rays(rng, share)
        walk = walked(surface).cast(*some, by="float64")
        for by in ARITHMETICS:
            t, came = surface.cast(*some, by=by)
            near = np.isclose(t, walk[0], rtol=EPSILON, atol=0.0) & (came == walk[1])
            differ, beyond = differ + int((t != walk[0]).sum()), beyond + int((~near).sum())
    of = f"of {share * len(surfaces):,} rays at {len(surfaces)} surfaces, by both arithmetics"
    return Outcome(np.inf if beyond else differ, f"{of}; {beyond} by more than the last bit")


def walked(surface: Surface) -> Surface:
    """The surface with macrocells that tell nothing, so that rays walk through all cells."""
    low, high = np.full_like(surface.field.low, -np.inf), np.full_like(surface.field.high, np.inf)
    return Surface(surface.field._replace(low=low, high=high), surface.bricks, surface.level)


@case(GROUP, "a far origin", "from a million boxes away a ray meets the point that it meets from near", 1e-4, "voxels")
def far_origin(size: Size) -> Outcome:
    """Move origins back along their rays, towards a ball's middle and past it."""
    rng, count, worst = np.random.default_rng(14), size.pick(1_000, 100_000), 0.0
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    through = MIDDLE + rng.uniform(-3.0, 3.0, directions.shape)
    ball = surface_of(CLOSED["ball"][0](), 0.0)
    for by in ARITHMETICS:
        near, _ = ball.cast(through - 1.5 * SIDE * directions, directions, by=by)
        for far in (1e2, 1e4, 1e6):
            away, _ = ball.cast(through - far * SIDE * directions, directions, by=by)
            worst = max(worst, float(abs((away - far * SIDE) - (near - 1.5 * SIDE)).max()))
    return Outcome(worst, f"of {count:,} rays, 100 to 1,000,000 boxes away")
