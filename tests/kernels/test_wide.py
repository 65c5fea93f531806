"""Wide cells against plain NumPy: their corners, which cells points are read from, and which are to be read finer."""

import math

import numpy as np
import pytest

from isogi_core.kernels.chunks import find_places, mark_texels
from isogi_core.kernels.lattice import BURIED, PARTIAL, UNBAKED, VOID, Lattice, wide_texel
from isogi_core.kernels.planes import BLUE, CONVERGING, FINAL, GREEN, PROVISIONAL, RED, Planes
from isogi_core.kernels.shares import DOUBLINGS, LEAST_COSINE, RECORD, Bare
from isogi_core.kernels.wide import (
    ask_texels,
    choose_cells,
    find_around,
    mark_around,
    mark_wide,
    number_wide,
    spread_light,
    spread_shares,
    touch_wide,
)
from isogi_core.model.scene import CHUNKS
from tests.kernels.lattices import RNG, SHAPE, STEP, border_points, lattice, lower_texels, some_points

SIDES = pytest.mark.parametrize("chunk", CHUNKS)
LUMINANCE = np.array([RED, GREEN, BLUE], float)
GRADES = np.array([UNBAKED, PARTIAL, CONVERGING, FINAL, BURIED, VOID], np.uint8)


def wide_cells(points):
    """Lowest and highest texel (n, 3; z, y, x) of each point's wide cell, and the fractions in it, by NumPy."""
    low, inside = lower_texels(points)
    even = low - low % 2
    high = np.minimum(even + 2, np.array(SHAPE) - 1)
    return even, high, (low - even + inside) / (high - even)


def wide_corners(points):
    """The eight texels (n, 8, 3; z, y, x) of each point's wide cell, x fastest."""
    low, high, _ = wide_cells(points)
    return np.where(np.array(list(np.ndindex(2, 2, 2))) == 1, high[:, None], low[:, None])


def places_of(texels, chunk):
    """Where texels (…, 3; z, y, x) are among those of all chunks, chunk by chunk."""
    z, y, x = np.moveaxis(texels, -1, 0)
    slot = np.ravel_multi_index((z // chunk, y // chunk, x // chunk), lattice(chunk).chunks)
    return slot * chunk**3 + np.ravel_multi_index((z % chunk, y % chunk, x % chunk), (chunk,) * 3)


def count(whole: Lattice, bits):
    """The first number of each row of `bits`, and where each of those set is."""
    first = np.concatenate([[0], np.cumsum(np.bitwise_count(bits), dtype=np.uint32)]).astype(np.uint32)
    places = np.empty(first[-1], np.uint32)
    find_places(whole, 0, len(bits), bits, first, places)
    return first, places


def test_a_wide_cell_has_two_texels_along_each_side_from_even_ones_on():
    points = border_points()
    low, high, inside = wide_cells(points)
    found = np.array([wide_texel(lattice(), points, m) for m in range(len(points))])
    assert np.array_equal(found[:, :3], low)
    np.testing.assert_allclose(found[:, 3:], inside, atol=1e-6)
    assert set(np.unique(high - low)) == {1, 2}, "lattices of even and of odd sides"
    assert set((np.array(SHAPE) % 2).tolist()) == {0, 1}


def test_what_is_linear_is_carried_to_the_points_of_wide_cells():
    points = some_points()
    low, high, inside = wide_cells(points)
    np.testing.assert_allclose(low + inside * (high - low), points[:, ::-1] / STEP[::-1], atol=1e-4)


@SIDES
def test_wide_cells_are_found_numbered_and_their_corners_marked_among_the_texels_of_points(chunk):
    whole, points = lattice(chunk), border_points()
    slots = np.arange(np.prod(whole.chunks), dtype=np.int32).reshape(whole.chunks)
    touched = np.zeros(whole.chunks, np.bool_)
    touch_wide(whole, points, touched)
    corners = wide_corners(points)
    assert set(map(tuple, np.argwhere(touched))) == set(map(tuple, corners.reshape(-1, 3) // chunk))

    cells = np.zeros(slots.size * whole.rows, np.uint32)
    for piece in np.array_split(points, 3):
        mark_wide(whole, piece, slots, cells)
    first, places = count(whole, cells)
    lows = wide_cells(points)[0]
    expected, twins = np.unique(places_of(lows, chunk), return_inverse=True)
    numbers = np.empty(len(points), np.uint32)
    number_wide(whole, points, slots, cells, first, numbers)
    assert np.array_equal(places, expected) and np.array_equal(numbers, twins)

    lowest = np.zeros((len(places), 3), np.int32)
    lowest[numbers] = lows
    read = np.zeros(slots.size * whole.rows, np.uint32)
    mark_texels(whole, points, slots, read)
    mark_around(whole, lowest, slots, read)
    first, places = count(whole, read)
    around = np.empty((len(lowest), 8), np.uint32)
    find_around(whole, lowest, slots, read, first, around)
    assert np.array_equal(places[around[numbers]], places_of(corners, chunk))
    narrow = lower_texels(points)[0][:, None] + np.array(list(np.ndindex(2, 2, 2)))
    both = np.concatenate([corners.reshape(-1, 3), narrow.reshape(-1, 3)])
    assert np.array_equal(places, np.unique(places_of(both, chunk))), "those of both kinds of cells, and no more"


def some_cells(points=500, cells=60, texels=200):
    """Corners of narrow cells (points, 8), numbers of wide ones (points,), and corners of these (cells, 8)."""
    narrow = RNG.integers(0, texels, (points, 8)).astype(np.uint32)
    numbers = RNG.integers(0, cells, points).astype(np.uint32)
    return narrow, numbers, RNG.integers(0, texels, (cells, 8)).astype(np.uint32)


def test_points_read_the_finer_cell_where_it_is_lit_and_no_worse():
    narrow, numbers, around = some_cells()
    for likely in ([0.1, 0.1, 0.2, 0.5, 0.05, 0.05], [0.02, 0.02, 0.06, 0.8, 0.05, 0.05], [0, 0, 0, 0.8, 0.1, 0.1]):
        grade = RNG.choice(GRADES, 200, p=likely)
        corners, wide = np.empty_like(narrow), np.empty(len(narrow), np.bool_)
        choose_cells(narrow, numbers, around, grade, corners, wide)
        fine, coarse = (np.minimum(grade[each], FINAL).min(axis=1) for each in (narrow, around[numbers]))
        expected = (fine == UNBAKED) | (fine < coarse)
        assert np.array_equal(wide, expected)
        assert np.array_equal(corners, np.where(expected[:, None], around[numbers], narrow))
    assert not wide.any(), "where all is final nothing is read coarse"


def lit_cells(grade_of, cells=80, texels=300):
    """Corners of wide cells, and their texels' grades and light (texels, 4) with its noise."""
    around = np.array([RNG.choice(texels, 8, replace=False) for _ in range(cells)], np.uint32)
    lit = RNG.random((texels, 4)).astype(np.float32) + np.float32(0.2)
    lit[:, 3] *= 0.2
    return around, RNG.choice(grade_of, texels).astype(np.uint8), lit


def spread_twin(around, grade, held, alike=lambda on: np.ones((len(on), len(on)))):
    """What cells' spread is, by NumPy: the deviation over pairs of texels, which count by how much they are `alike`."""
    tone, noise, found = held[:, :3].astype(float) @ LUMINANCE, held[:, 3].astype(float), []
    for own in around:
        on = own[grade[own] == FINAL]
        if (grade[own] < FINAL).any():
            found.append(0.0)
        elif len(on) < 2:
            found.append(math.inf)
        else:
            apart = (tone[on][:, None] - tone[on]) ** 2 - (noise[on] ** 2)[:, None] - noise[on] ** 2
            pairs = np.tril(alike(on), -1)
            found.append(math.sqrt(max((pairs * apart).sum(), 0.0) / (2.0 * pairs.sum())))
    return np.array(found)


MIXES = pytest.mark.parametrize(
    "grades", [[FINAL], [FINAL, VOID], [BURIED, VOID, FINAL, VOID, BURIED], [CONVERGING, *[FINAL] * 30]]
)


@MIXES
def test_the_spread_of_light_is_its_deviation_without_noise(grades):
    around, grade, lit = lit_cells(grades)
    spread = np.empty(len(around), np.float32)
    spread_light(grade, lit, around, spread)
    expected = spread_twin(around, grade, lit)
    np.testing.assert_allclose(spread, expected, rtol=2e-3, atol=2e-4)
    assert (expected > 0.05).any()
    on = around[0][grade[around[0]] == FINAL]
    if len(on) == 8:
        alone = np.zeros_like(lit)
        alone[:, :3] = lit[:, :3]
        spread_light(grade, alone, around, spread)
        assert spread[0] == pytest.approx((lit[on, :3] @ LUMINANCE).std(ddof=1), rel=1e-3)


@MIXES
def test_the_spread_of_shares_is_of_texels_that_face_one_way_in_the_light_about_their_mean_normal(grades):
    around, grade, lit = lit_cells(grades)
    shares = np.zeros((len(lit), RECORD), np.float32)
    normals = RNG.normal(size=(len(lit), 3)) * 0.2 + [0.3, 0.8, 0.1]
    shares[:, :4], shares[:, 4:7], shares[:, 7] = lit, normals / np.linalg.norm(normals, axis=1)[:, None], grade
    quadric, falling = np.zeros((3, 9), np.float32), np.array([0.5, 0.2, 0.1])
    quadric[:, 0], quadric[:, 1] = 1.0, falling  # brighter along y
    none = np.zeros(3, np.float32)
    spread = np.empty(len(around), np.float32)
    spread_shares(grade, shares, Bare(quadric, none, none), around, spread)
    facing = shares[:, 4:7].astype(float)
    twins = spread_twin(
        around, grade, shares, lambda on: np.maximum(facing[on] @ facing[on].T, LEAST_COSINE) ** 2**DOUBLINGS
    )
    for own, found, twin in zip(around, spread, twins, strict=True):
        mean = facing[own[grade[own] == FINAL]].sum(axis=0)
        y = mean[1] / max(np.linalg.norm(mean), 1e-30)
        np.testing.assert_allclose(found, twin * (LUMINANCE @ (1.0 + y * falling)), rtol=3e-3, atol=3e-4)


def test_noise_alone_is_no_spread():
    around = np.arange(8, dtype=np.uint32)[None]
    lit = np.ones((8, 4), np.float32)
    lit[::2, :3] += np.float32(0.01)
    lit[:, 3] = 0.02
    spread = np.empty(1, np.float32)
    spread_light(np.full(8, FINAL, np.uint8), lit, around, spread)
    assert spread == 0.0
    lit[:, 3] = 0.0
    spread_light(np.full(8, FINAL, np.uint8), lit, around, spread)
    assert spread == pytest.approx(0.005 * math.sqrt(8 / 7), rel=1e-2)


def test_what_is_read_is_asked_for_and_what_should_be_in_split_cells_whose_points_are_not_final():
    narrow, numbers, around = some_cells(texels=9000)
    wide, split = RNG.random(len(numbers)) < 0.5, RNG.random(len(around)) < 0.2
    corners = np.where(wide[:, None], around[numbers], narrow).astype(np.uint32)
    size = 2 * len(numbers)
    states = RNG.choice(np.array([PROVISIONAL, CONVERGING, FINAL, FINAL], np.uint8), size)
    planes = Planes(np.zeros((size, 3), np.float32), states.copy(), np.zeros(size, np.float32))
    pixels, asked = np.arange(1, size, 2, dtype=np.uint32), np.zeros(9000, np.bool_)
    ask_texels(narrow, numbers, split, corners, wide, pixels, planes, asked)
    lacking = wide & split[numbers]
    expected = np.zeros(9000, np.bool_)
    expected[corners], expected[narrow[lacking]] = True, True
    assert np.array_equal(asked, expected) and not asked.all()
    held = np.zeros(size, np.bool_)
    held[pixels[lacking]] = True
    assert np.array_equal(planes.state, np.where(held & (states == FINAL), CONVERGING, states))
