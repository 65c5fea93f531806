"""Rays cast by SIMD against the scalar kernel: the same bits, on smooth, noisy, flat, holed and
real volumes.
"""

import mmap

import numpy as np
import pytest

from isogi_core.kernels.simd.types import REGISTER_LANES
from isogi_core.kernels.tracing.active_cells import (
    BRICK_CELLS,
    ActiveCells,
    block_ranges,
    brick_shape,
    make_active_cells,
)
from isogi_core.kernels.tracing.cast import cast_batch, cast_one_by_one
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, UNKNOWN_SIDE
from isogi_core.kernels.tracing.macrocells import macrocell_shape
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.model.volume import make_volume
from isogi_core.prepared.prepared_scene import make_field
from tests.loaded import read_nrrd
from tests.scale import COMPILED, few

COUNT = few(20_000, 20)
BALL = 12.0 - np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)


def cast_both(voxels, isovalues, origins, directions, sides, spread=0.0):
    """(t, came) by SIMD and one by one; the map covers ``spread`` more than the isovalues on each
    side.
    """
    volume = make_volume(voxels)
    scale = np.array([volume.normalise_isovalue(v) for v in np.atleast_1d(isovalues)])
    isovalues = np.broadcast_to(scale, len(origins)).copy()
    field = make_field(volume)
    ranges = block_ranges(volume.voxels)
    cells = make_active_cells(
        volume.voxels, ranges, isovalues.min() - spread, isovalues.max() + spread
    )
    sides = np.broadcast_to(np.asarray(sides, np.int8), len(origins)).copy()
    results = []
    for kernel in (cast_batch, cast_one_by_one):
        t = np.full(len(origins), -1.0)
        came = np.full(len(origins), 99, np.int8)
        kernel(field, cells, Rays(isovalues, *along(origins, directions), sides), t, came)
        results.append((t, came))
    return results


def along(*vectors):
    """Vectors (n, 3) as the kernels take them, (3, n)."""
    return [np.ascontiguousarray(v.T) for v in vectors]


def assert_same(*arguments, **options):
    """Both casts agree in every bit; returns the share of rays that hit."""
    (t, came), (t_one, came_one) = cast_both(*arguments, **options)
    assert np.array_equal(t, t_one)
    assert np.array_equal(came, came_one)
    return np.isfinite(t).mean()


def rays_about(shape, seed, count=COUNT):
    """Rays from in and around a volume to points in it."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    origins = (rng.random((count, 3)) * 2.0 - 0.5) * size
    return origins, rng.random((count, 3)) * size - origins


FIELDS = {
    "ball": (BALL, 0.0),
    "noise": (np.random.default_rng(1).normal(size=(19, 23, 30)), 0.3),
    "steps": (np.random.default_rng(2).integers(0, 3, (18, 21, 17)).astype(np.uint8), 1),
    "between steps": (np.random.default_rng(2).integers(0, 3, (18, 21, 17)).astype(np.uint8), 0.5),
    "binary": ((BALL > 0).astype(np.uint8), 0.5),
    "plateau": (np.clip(np.round(BALL), -3, 3), 2.0),
    "thin": (np.random.default_rng(3).normal(size=(2, 40, 5)), 0.0),
    "least": (np.random.default_rng(4).normal(size=(2, 2, 2)), 0.0),
    "long": (np.sin(np.indices((9, 5, 700)).sum(axis=0) * 0.3), 0.5),
    "spike": (np.where(np.indices((20, 20, 20)).sum(axis=0) == 30, 1e6, BALL[:20, :20, :20]), -3.0),
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("side", [UNKNOWN_SIDE, OUTSIDE_SIGN, SOLID_SIGN])
def test_the_same_bits_as_the_scalar_kernel(name, side):
    voxels, iso = FIELDS[name]
    origins, directions = rays_about(voxels.shape, 5)
    hits = assert_same(voxels, iso, origins, directions, side)
    assert hits > 0.1, "the rays say little"


@pytest.mark.parametrize("spread", [0.0, 0.01, 0.2])
def test_one_map_serves_a_range_of_isovalues(spread):
    origins, directions = rays_about(BALL.shape, 6)
    isovalues = np.random.default_rng(6).uniform(-2.0, 4.0, len(origins))
    assert assert_same(BALL, isovalues, origins, directions, UNKNOWN_SIDE, spread=spread) > 0.3


def axis_aligned():
    """Rays along axes, nearly, on and off lattice planes."""
    rng = np.random.default_rng(7)
    origins = rng.integers(0, 41, (COUNT, 3)) + rng.choice(
        [0.0, 0.5, 1e-9, -1e-9, 1e-5], (COUNT, 3)
    )
    directions = rng.choice([0.0, -0.0, 1e-300, -1e-9, 1e-4], (COUNT, 3))
    directions[np.arange(COUNT), rng.integers(0, 3, COUNT)] += rng.choice([-1.0, 1.0], COUNT)
    return origins, directions


def diagonal():
    """Rays through lattice points, along axes and diagonals."""
    rng = np.random.default_rng(8)
    origins = rng.integers(-5, 46, (COUNT, 3)).astype(float)
    directions = rng.integers(-2, 3, (COUNT, 3)).astype(float)
    directions[~directions.any(axis=1)] = 1.0
    return origins, directions


@pytest.mark.parametrize("name", ["ball", "binary", "plateau"])
@pytest.mark.parametrize("rays", [axis_aligned, diagonal])
def test_rays_along_the_lattice_have_the_same_bits(rays, name):
    assert assert_same(*FIELDS[name], *rays(), UNKNOWN_SIDE) > 0.02


@pytest.mark.parametrize("length", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("distance", [1.0, 1e4, 1e8])
def test_any_length_of_direction_from_any_distance(length, distance):
    rng = np.random.default_rng(9)
    directions = rng.normal(size=(COUNT, 3))
    origins = 20.0 + rng.uniform(-10, 10, directions.shape) - 30.0 * distance * directions
    assert assert_same(BALL, 0.0, origins, directions * length, UNKNOWN_SIDE) > 0.1


@pytest.mark.parametrize("share", [1e-4, 0.02, 1.0])
def test_holes_are_the_scalar_kernels(share):
    rng = np.random.default_rng(10)
    voxels = np.where(rng.random(BALL.shape) < share, np.nan, BALL)
    voxels[0, 0, 0] = -20.0
    origins, directions = rays_about(voxels.shape, 11)
    assert_same(voxels, 0.0, origins, directions, UNKNOWN_SIDE)


def test_rays_that_say_nothing_hit_nothing():
    directions = np.zeros((5, 3))
    directions[1:] = [[np.nan, 0, 1], [0, np.inf, 0], [np.nan] * 3, [-np.inf, np.inf, 1]]
    (t, came), (t_one, came_one) = cast_both(
        BALL, 0.0, np.full((5, 3), 20.0), directions, SOLID_SIGN
    )
    assert np.array_equal(t, t_one) and np.array_equal(came, came_one)


@pytest.mark.parametrize("count", [0, 1, 31, few(4096, 40), few(4097, 41)])
def test_batches_of_any_size(count):
    origins, directions = rays_about(BALL.shape, 13, count)
    assert_same(BALL, np.zeros(1), origins, directions, UNKNOWN_SIDE) if count else cast_nothing()


def cast_nothing():
    volume = make_volume(BALL)
    cells = make_active_cells(volume.voxels, block_ranges(volume.voxels), 0.5, 0.5)
    none = np.empty((3, 0))
    rays = Rays(np.empty(0), none, none, np.empty(0, np.int8))
    cast_batch(make_field(volume), cells, rays, np.empty(0), np.empty(0, np.int8))


def vast(shape):
    """A volume of zeros with a ball in its last corner, the field and the map; memory holds what is
    touched alone.

    All is empty to the map but for the cells about the ball, whose cells are all marked.
    """
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_NORESERVE", 0)
    room = mmap.mmap(-1, 4 * int(np.prod(shape)), flags=flags)
    voxels = np.frombuffer(room, np.float32).reshape(shape)
    voxels[-24:, -24:, -24:] = np.maximum(
        6.0 - np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0), 0.0
    )
    low, high = np.zeros((2, *macrocell_shape(shape)), np.float32)
    high[-4:, -4:, -4:] = 6.0
    tops = np.zeros(brick_shape(shape), np.int32)
    margins = np.zeros(brick_shape(shape), np.float32)
    tops[-7:, -7:, -7:] = 1
    margins[-7:, -7:, -7:] = 0.1
    words = np.repeat(np.array([0, -1], np.int32), BRICK_CELLS)
    return Field(voxels, low, high, (1.0, 1.0, 1.0)), ActiveCells(
        tops.ravel(), words, margins.ravel(), tops.shape
    )


@COMPILED
@pytest.mark.parametrize("shape", [(1024, 1024, 1024), (1024, 1023, 1025), (1289, 1290, 1291)])
def test_volumes_of_up_to_two_billion_voxels_are_cast_by_simd(shape):
    field, cells = vast(shape)
    origins, directions = rays_about((24, 24, 24), 17)
    origins = origins + np.array(shape[::-1]) - 24.0
    isovalues = np.full(len(origins), 0.5)
    sides = np.full(len(origins), UNKNOWN_SIDE, np.int8)
    rays = Rays(isovalues, *along(origins, directions), sides)
    empty = field._replace(high=np.zeros_like(field.high))  # where the scalar kernel finds nothing
    found = []
    for kernel, seen in ((cast_batch, field), (cast_one_by_one, field), (cast_batch, empty)):
        t = np.empty(len(origins))
        came = np.empty(len(origins), np.int8)
        kernel(seen, cells, rays, t, came)
        found.append((t, came))
    (t, came), (t_one, came_one), (t_simd, _) = found
    assert np.array_equal(t, t_one) and np.array_equal(came, came_one)
    assert np.isfinite(t).mean() > 0.1
    assert REGISTER_LANES is None or np.isfinite(t_simd).any()


@pytest.mark.data
def test_the_engine(shared_data):
    voxels, _ = read_nrrd(shared_data / "engine_256x256x128_uint8.nhdr")
    for iso in (70, 180.5):
        origins, directions = rays_about(voxels.shape, 14, 5 * COUNT)
        assert assert_same(voxels, iso, origins, directions, UNKNOWN_SIDE) > 0.2
