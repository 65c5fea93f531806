"""The illumination lattice against plain NumPy: which texels a point reads, and light carried from them to it."""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import sph_harm_y

from isogi_core.kernels.harmonics import cosine_lobe_factors
from isogi_core.kernels.lattice import (
    BURIED,
    BURIED_ROW,
    CHUNK,
    LEAST_SPREAD,
    PARTIAL,
    ROWS,
    UNBAKED,
    UNLIT,
    VOID,
    VOID_ROW,
    WHOLE_ROW,
    Lattice,
    Sky,
    base_texel,
    carry_light,
    find_corners,
    find_places,
    find_rows,
    light_texels,
    mark_texels,
    ones,
    touch_chunks,
    trilinear,
    weigh_chunks,
)
from isogi_core.kernels.planes import BLUE, CONVERGING, FINAL, GREEN, PROVISIONAL, RED, Planes, luminance

SHAPE = (20, 33, 18)
STEP = np.array([1.5, 0.5, 1.0])
RNG = np.random.default_rng(21)
CHUNKS = tuple(-(-n // CHUNK) for n in SHAPE)


def lattice():
    """SHAPE texels (z, y, x), one every STEP voxels (x, y, z)."""
    return Lattice(SHAPE, tuple((1.0 / STEP).tolist()))


def some_points(count=300):
    """Points (n, 3) float32 in voxels: anywhere, on texels, and on the last faces."""
    last = (np.array(SHAPE[::-1]) - 1) * STEP
    points = RNG.random((count, 3)) * last
    points[::3] = np.rint(points[::3] / STEP) * STEP
    points[::10] = last
    return points.astype(np.float32)


def lower_texels(points):
    """Lower texel (n, 3; z, y, x) of each point's lattice cell, and the fractions in it, by NumPy."""
    place = (points.astype(float) / STEP)[:, ::-1]
    low = np.clip(np.floor(place).astype(int), 0, np.array(SHAPE) - 2)
    return low, np.clip(place - low, 0.0, 1.0)


def corner_texels(points):
    """The eight texels (n, 8, 3; z, y, x) around each point, x fastest."""
    return lower_texels(points)[0][:, None] + np.array(list(np.ndindex(2, 2, 2)))


def view_of(points, pieces=1):
    """The view's tables as `frame.texels` makes them: read (slots · ROWS,), places of the texels, corners (n, 8)."""
    slots = np.arange(np.prod(CHUNKS), dtype=np.int32).reshape(CHUNKS)
    read = np.zeros(slots.size * ROWS, np.uint16)
    for piece in np.array_split(points, pieces):
        mark_texels(lattice(), piece, slots, read)
    first = np.concatenate([[0], np.cumsum(np.bitwise_count(read), dtype=np.uint32)]).astype(np.uint32)
    places, corners = np.full(first[-1], 2**32 - 1, np.uint32), np.empty((len(points), 8), np.uint32)
    for begin in range(0, read.size, 1000):
        find_places(begin, min(begin + 1000, read.size), read, first, places)
    find_corners(lattice(), points, slots, read, first, corners)
    return read, places.astype(int), corners


def test_base_texel_is_the_lower_corner_and_the_fractions_beyond_it():
    points = some_points()
    low, fractions = lower_texels(points)
    found = np.array([base_texel(lattice(), points, m) for m in range(len(points))])
    assert np.array_equal(found[:, :3], low)
    np.testing.assert_allclose(found[:, 3:], fractions, atol=1e-6)


def test_points_beyond_the_box_read_its_outermost_texels():
    points = np.array([[-1.0, -1.0, -1.0], [1e6, 1e6, 1e6]], np.float32)
    assert base_texel(lattice(), points, 0) == (0, 0, 0, 0.0, 0.0, 0.0)
    assert base_texel(lattice(), points, 1) == (*(n - 2 for n in SHAPE), 1.0, 1.0, 1.0)


def test_trilinear_weights_are_the_products_and_sum_to_one():
    fz, fy, fx = 0.2, 0.7, 0.9
    weights = [trilinear(c, fz, fy, fx) for c in range(8)]
    outer = np.einsum("k,j,i->kji", [1 - fz, fz], [1 - fy, fy], [1 - fx, fx]).ravel()
    assert weights == pytest.approx(outer.tolist())
    assert sum(weights) == pytest.approx(1.0)


def chunks_read(points):
    """The set of chunks (z, y, x) that each point reads."""
    return [{tuple(t // CHUNK) for t in texels} for texels in corner_texels(points)]


def border_points():
    """Points whose lattice cells lie on every border, edge and corner of the chunks, and some anywhere."""
    sides = [np.unique(np.clip([0.3, CHUNK - 0.5, 2 * CHUNK - 0.5, n - 1.2], 0, n - 1)) for n in SHAPE[::-1]]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3) * STEP
    return np.concatenate([grid.astype(np.float32), some_points()])


def test_touched_chunks_are_those_that_some_point_reads():
    points = border_points()
    assert max(map(len, chunks_read(points))) == 8
    for some in (points, points[:7], points[10:11]):
        touched = np.zeros(CHUNKS, np.bool_)
        touch_chunks(lattice(), some, touched)
        assert set(map(tuple, np.argwhere(touched))) == set().union(*chunks_read(some))


def test_a_chunk_weighs_what_its_points_that_are_not_final_look_wrong_by_and_the_middle_twice_as_much_as_the_corners():
    points = border_points()
    width, height = 40, len(points) // 40 + 3
    pixels = np.arange(len(points), dtype=np.uint32) + 17
    y, x = np.divmod(pixels.astype(float), width)
    aside = ((2 * x + 1) / width - 1) ** 2 + ((2 * y + 1) / height - 1) ** 2
    planes = Planes(
        RNG.random((width * height, 3)).astype(np.float32),
        RNG.integers(PROVISIONAL, FINAL + 1, width * height, np.uint8),
        RNG.random(width * height).astype(np.float32),
    )
    light = planes.radiance[pixels].astype(float) @ [0.2126, 0.7152, 0.0722]
    wrong = np.where(planes.state[pixels] == FINAL, 0.0, (light * planes.error[pixels]) ** 2)
    weights = (2 - aside / 2) * wrong
    _, places, corners = view_of(points)
    weight = np.zeros(np.prod(CHUNKS))
    weigh_chunks(corners, places.astype(np.uint32), pixels, width, height, planes, weight)
    expected = np.zeros(CHUNKS)
    for chunks, own in zip(chunks_read(points), weights, strict=True):
        for chunk in chunks:
            expected[chunk] += own
    np.testing.assert_allclose(weight.reshape(CHUNKS), expected, rtol=1e-5)


@pytest.mark.parametrize("pieces", [1, 3])
def test_marked_texels_are_the_corners_of_all_points_and_no_more(pieces):
    points = border_points()
    _, places, corners = view_of(points, pieces)
    expected = np.zeros(tuple(c * CHUNK for c in CHUNKS), np.bool_)
    expected[tuple(corner_texels(points).reshape(-1, 3).T)] = True
    blocks = expected.reshape(*(n for c in CHUNKS for n in (c, CHUNK))).transpose(0, 2, 4, 1, 3, 5)
    assert np.array_equal(places, np.flatnonzero(blocks)), "numbered chunk by chunk, x fastest"
    z, y, x = np.moveaxis(corner_texels(points), -1, 0)
    slot = np.ravel_multi_index((z // CHUNK, y // CHUNK, x // CHUNK), CHUNKS)
    offset = np.ravel_multi_index((z % CHUNK, y % CHUNK, x % CHUNK), (CHUNK,) * 3)
    assert np.array_equal(places[corners], slot * CHUNK**3 + offset)


def test_ones_counts_bits():
    for word in (0, 1, 0b1011, WHOLE_ROW, 1 << 15):
        assert ones(word) == word.bit_count()


def test_rows_are_looked_up_chunk_by_chunk():
    """Two chunks of a view, of which one is in the pool: texels get its rows, their errors and their stamps."""
    table = np.full((3, CHUNK**3), UNLIT, np.int32)
    table[2, [5, 9, 11, 700]] = 4, VOID_ROW, BURIED_ROW, 1
    pool_error, pool_stamp = RNG.random((2, 6)).astype(np.float32)
    places = np.array([5, 6, 9, 11, 700, CHUNK**3 + 5], np.uint32)
    rows, error, stamp = np.zeros(6, np.int32), *np.zeros((2, 6), np.float32)
    find_rows(places, np.array([2, -1], np.int32), table, pool_error, pool_stamp, rows, error, stamp)
    assert rows.tolist() == [4, UNLIT, VOID_ROW, BURIED_ROW, 1, UNLIT]
    assert error.tolist() == [pool_error[4], 0.0, 0.0, 0.0, pool_error[1], 0.0]
    assert stamp.tolist() == [pool_stamp[4], UNLIT, VOID_ROW, BURIED_ROW, pool_stamp[1], UNLIT]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("order", [1, 5])
def test_light_of_a_texel_is_the_dot_product_of_transfer_and_light(channels, order):
    transfer = RNG.normal(size=(40, channels, order**2)).astype(np.float32)
    noise = RNG.random(40).astype(np.float32)
    light = RNG.normal(size=(3, order**2)).astype(np.float32)
    rows = RNG.permutation(40)[:30].astype(np.int32)
    rows[4:7] = UNLIT, VOID_ROW, BURIED_ROW
    lit = np.full((30, 4), -7.0, np.float32)
    square = RNG.normal(size=order**2).astype(np.float32)
    light_texels(rows, transfer, noise, light, square, lit)
    colour = np.einsum("mcn,cn->mc", np.broadcast_to(transfer[rows], (30, 3, order**2)), light)
    there = rows >= 0
    assert (colour[there] < 0).any(), "some sums must be negative to see them cut"
    np.testing.assert_allclose(lit[there, :3], np.maximum(colour, 0.0)[there], atol=1e-5)
    seen = transfer[rows, channels // 2]
    variance = np.maximum(seen @ square - (colour @ (RED, GREEN, BLUE)) ** 2, 0.0)
    variance += LEAST_SPREAD * np.maximum(seen[:, 0] * square[0], 0.0)
    np.testing.assert_allclose(lit[there, 3], (noise[rows] * np.sqrt(variance))[there], atol=1e-4)
    assert (lit[~there] == -7.0).all(), "texels without a row are left alone"


def carry(points, grade, lit, normals=None, order=3, unit=1.0):
    """`carry_light`: radiance (n, 3), state (n,), error (n,), and the sky it was given."""
    sky = Sky(order, np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1), SKY_LIGHT)
    _, _, corners = view_of(points)
    size = 3 * len(points)
    planes = Planes(np.zeros((size, 3), np.float32), np.zeros(size, np.uint8), np.zeros(size, np.float32))
    pixels = np.arange(1, size, 3, dtype=np.uint32)
    normals = np.zeros_like(points) if normals is None else normals
    carry_light(lattice(), points, pixels, corners, grade, lit, normals, sky, np.float32(unit), planes)
    assert not planes.state[::3].any() and not planes.radiance[2::3].any(), "other pixels are left alone"
    return tuple(plane[pixels] for plane in planes)


SKY_LIGHT = np.abs(RNG.normal(size=(3, 9))) * 0.05 + np.array([3.0] + [0.0] * 8)


def lit_view(points, seed=1):
    """Every texel of the view lit at random: grades and light (m, 4)."""
    count = len(view_of(points)[1])
    rng = np.random.default_rng(seed)
    lit = rng.random((count, 4)).astype(np.float32) + 0.1
    return np.full(count, FINAL, np.uint8), lit


def test_carried_light_is_scipys_linear_interpolation_of_the_texels():
    points = border_points()
    grade, lit = lit_view(points)
    grid = np.zeros((*(c * CHUNK for c in CHUNKS), 3))
    slot, offset = np.divmod(view_of(points)[1], CHUNK**3)
    inside = np.unravel_index(offset, (CHUNK,) * 3)
    grid[tuple(c * CHUNK + i for c, i in zip(np.unravel_index(slot, CHUNKS), inside, strict=True))] = lit[:, :3]
    place = (points.astype(float) / STEP)[:, ::-1].T
    radiance, state, error = carry(points, grade, lit)
    expected = np.stack([map_coordinates(grid[..., c], place, order=1) for c in range(3)], axis=-1)
    np.testing.assert_allclose(radiance, expected, atol=2e-5)
    assert (state == FINAL).all()
    assert (error < 1.0).any()


@pytest.mark.parametrize("unit", [2.0**-100, 2.0**100])
def test_light_is_carried_in_units(unit):
    points = border_points()
    grade, lit = lit_view(points)
    grade[::3] = UNBAKED
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(points), 1))
    one, other = (carry(points, grade, lit, up, unit=each) for each in (1.0, unit))
    assert np.array_equal(other[0], one[0] * np.float32(unit))
    assert all(np.array_equal(*pair) for pair in zip(one[1:], other[1:], strict=True))


def test_error_is_the_root_of_the_weighted_squares_over_the_luminance():
    points = np.array([[3.4, 2.2, 5.7]], np.float32)
    grade, lit = lit_view(points)
    radiance, _, error = carry(points, grade, lit)
    fz, fy, fx = lower_texels(points)[1][0]
    weights = np.array([trilinear(c, fz, fy, fx) for c in range(8)])
    own = lit[view_of(points)[2][0], 3]
    assert error[0] == pytest.approx(np.sqrt(((weights * own) ** 2).sum()) / luminance(*radiance[0].astype(float)))


def test_a_point_is_as_good_as_the_least_of_its_texels():
    points = np.array([[3.4, 2.2, 5.7]], np.float32)
    grade, lit = lit_view(points)
    grade[5] = CONVERGING
    assert carry(points, grade, lit)[1] == [CONVERGING]
    for grade[2] in (PARTIAL, UNBAKED):
        _, state, error = carry(points, grade, lit, np.array([[0, 0, 1]], np.float32))
        assert state == [PROVISIONAL] and error == [1.0]


def test_light_of_some_layers_is_shown_as_it_is():
    points = some_points(40)
    grade, lit = lit_view(points)
    whole, _, _ = carry(points, grade, lit)
    grade[::2] = PARTIAL
    assert np.array_equal(carry(points, grade, lit)[0], whole)


@pytest.mark.parametrize("left_out", [[VOID], [BURIED], [VOID, BURIED, VOID]])
def test_void_and_buried_texels_are_left_out_of_the_mean(left_out):
    points = np.array([[3.4, 2.2, 5.7]], np.float32)
    grade, lit = lit_view(points)
    corners = view_of(points)[2][0]
    grade[corners[[0, 3, 7]]] = left_out
    kept = np.delete(np.arange(8), [0, 3, 7])
    fz, fy, fx = lower_texels(points)[1][0]
    weights = np.array([trilinear(c, fz, fy, fx) for c in kept])
    expected = weights @ lit[corners[kept]] / weights.sum()
    lit[corners[[0, 3, 7]]] = 1e9
    radiance, state, error = carry(points, grade, lit)
    np.testing.assert_allclose(radiance[0], expected[:3], rtol=1e-5)
    noise = np.sqrt(((weights * lit[corners[kept], 3]) ** 2).sum()) / weights.sum()
    assert error[0] == pytest.approx(min(noise / luminance(*expected[:3]), 1.0), rel=1e-5)
    assert state == [FINAL]


def test_a_point_among_buried_texels_is_black_and_final():
    """However many of the eight are void: somebody looked, and no light comes here."""
    points = np.array([[3.4, 2.2, 5.7], [10.1, 9.9, 13.2]], np.float32)
    grade, lit = lit_view(points)
    lit[:] = np.nan
    grade[:] = BURIED
    grade[view_of(points)[2][1, :7]] = VOID
    radiance, state, error = carry(points, grade, lit, np.full_like(points, 3**-0.5))
    assert not radiance.any() and not error.any() and (state == FINAL).all()


def test_buried_texels_beside_missing_ones_do_not_darken_what_stands_in():
    points = np.array([[3.4, 2.2, 5.7]], np.float32)
    grade, lit = lit_view(points)
    grade[:] = BURIED
    grade[view_of(points)[2][0, 6]] = UNBAKED
    radiance, state, _ = carry(points, grade, lit, np.array([[0, 0, 1]], np.float32))
    np.testing.assert_allclose(radiance[0], irradiance_over_pi((0.0, 0.0, 1.0)), rtol=1e-5)
    assert state == [PROVISIONAL]


def irradiance_over_pi(n):
    """E/π of SKY_LIGHT about the unit normal n by SciPy's harmonics: Σ A_l/π ℓ_lm Y_lm(n); (3,)."""
    theta, phi = math.acos(n[2]), math.atan2(n[1], n[0])
    total = np.zeros(3)
    for l, lobe in enumerate((1.0, 2.0 / 3.0, 0.25)):
        for m in range(-l, l + 1):
            y = (-1) ** m * sph_harm_y(l, abs(m), theta, phi) * math.sqrt(2.0 if m else 1.0)
            total += lobe * (y.imag if m < 0 else y.real) * SKY_LIGHT[:, l * (l + 1) + m]
    return total


@pytest.mark.parametrize("missing", [UNBAKED, VOID])
def test_without_any_lit_texel_unshadowed_light_stands_in(missing):
    points = some_points(20)
    normals = RNG.normal(size=points.shape)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    grade, lit = lit_view(points)
    grade[:] = missing
    lit[:] = np.nan
    radiance, state, _ = carry(points, grade, lit, normals)
    np.testing.assert_allclose(radiance, [irradiance_over_pi(n.astype(float)) for n in normals], rtol=1e-5)
    assert (radiance > 0.0).all() and (state == (PROVISIONAL if missing == UNBAKED else FINAL)).all()


def test_what_is_missing_is_filled_in_proportion():
    points = np.array([[3.4, 2.2, 5.7]], np.float32)
    grade, lit = lit_view(points)
    lit[:, :3] = 0.25
    corners = view_of(points)[2][0]
    grade[corners[[1, 6]]] = UNBAKED
    fz, fy, fx = lower_texels(points)[1][0]
    share = trilinear(1, fz, fy, fx) + trilinear(6, fz, fy, fx)
    radiance, _, _ = carry(points, grade, lit, np.array([[0, 0, 1]], np.float32))
    expected = (1 - share) * 0.25 + share * irradiance_over_pi((0.0, 0.0, 1.0))
    np.testing.assert_allclose(radiance[0], expected, rtol=1e-5)
