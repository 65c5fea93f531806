"""Chunks against plain NumPy: which a view touches, which of their texels it reads, and how it
numbers these.
"""

import numpy as np
import pytest

from isogi_core.frame.demand import first_texels
from isogi_core.kernels.shading.chunks import Pages, find_rows, ones, touch_chunks, weigh_chunks
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import BURIED_ROW, UNLIT_ROW, VOID_ROW
from isogi_core.plan.scene import CHUNK_SIDES
from tests.kernels.shading.lattices import RNG, border_points, corner_texels, lattice, view_of

SIDES = pytest.mark.parametrize("chunk", CHUNK_SIDES)


COARSE = pytest.mark.parametrize("coarse", [False, True])


def texels_read(points, coarse=False):
    """The texels (n, 8, 3; z, y, x) that stand for those around each point, x fastest: these, or
    coarse ones of them.

    Coarse ones are all even or all odd, whichever of a cell's two is nearer to a corner.
    """
    texels = corner_texels(points)
    if not coarse:
        return texels
    parity = texels % 2
    ends = [
        np.take_along_axis(texels, np.argmax((parity == p).all(axis=2), axis=1)[:, None, None], 1)
        for p in (0, 1)
    ]
    apart = [np.abs(texels - end).sum(axis=2) for end in ends]
    return np.where((apart[0] < apart[1])[..., None], *ends)


def chunks_read(points, chunk, coarse=False):
    """The set of chunks (z, y, x) that each point reads."""
    return [{tuple(t // chunk) for t in texels} for texels in texels_read(points, coarse)]


@SIDES
def test_positions_are_lattice_indices(chunk):
    offsets = np.array([0, 1, chunk, chunk**2, chunk**3 - 1])
    expected = np.array([[2, 0, 1]]) * chunk + [
        [0, 0, 0],
        [0, 0, 1],
        [0, 1, 0],
        [1, 0, 0],
        [chunk - 1] * 3,
    ]
    found = lattice(chunk).positions((2, 0, 1), offsets)
    assert np.array_equal(found, expected) and found.dtype == np.int32


@COARSE
@SIDES
def test_touched_chunks_are_those_that_some_point_reads(chunk, coarse):
    points = border_points()
    assert max(map(len, chunks_read(points, chunk, coarse))) == (2 if coarse else 8)
    for some in (points, points[:7], points[10:11]):
        touched = np.zeros(lattice(chunk).chunks, np.bool_)
        touch_chunks(lattice(chunk), some, coarse, touched)
        assert set(map(tuple, np.argwhere(touched))) == set().union(
            *chunks_read(some, chunk, coarse)
        )


@COARSE
@SIDES
def test_a_chunk_weighs_what_its_points_look_wrong_by(chunk, coarse):
    points = border_points()
    width = 40
    height = len(points) // 40 + 3
    pixels = np.arange(len(points), dtype=np.uint32) + 17
    y, x = np.divmod(pixels.astype(float), width)
    aside = ((2 * x + 1) / width - 1) ** 2 + ((2 * y + 1) / height - 1) ** 2
    planes = Framebuffer(
        RNG.random((width * height, 3)).astype(np.float32),
        RNG.integers(PROVISIONAL, FINAL + 1, width * height, np.uint8),
        RNG.random(width * height).astype(np.float32),
    )
    light = planes.radiance[pixels].astype(float) @ [0.2126, 0.7152, 0.0722]
    wrong = np.where(planes.state[pixels] == FINAL, 0.0, (light * planes.error[pixels]) ** 2)
    weights = (2 - aside / 2) * wrong
    _, places, corners = view_of(points, chunk=chunk, coarse=coarse)
    expected = np.zeros(lattice(chunk).chunks)
    weight = np.zeros(expected.size)
    weigh_chunks(
        lattice(chunk), corners, places.astype(np.uint32), pixels, width, height, planes, weight
    )
    for chunks, own in zip(chunks_read(points, chunk, coarse), weights, strict=True):
        for each in chunks:
            expected[each] += own
    np.testing.assert_allclose(weight.reshape(expected.shape), expected, rtol=1e-5)


@pytest.mark.parametrize("pieces", [1, 3])
@COARSE
@SIDES
def test_marked_texels_are_the_corners_of_all_points_and_no_more(pieces, chunk, coarse):
    points = border_points()
    chunks = lattice(chunk).chunks
    _, places, corners = view_of(points, pieces, chunk, coarse)
    read = texels_read(points, coarse)
    expected = np.zeros(tuple(c * chunk for c in chunks), np.bool_)
    expected[tuple(read.reshape(-1, 3).T)] = True
    blocks = expected.reshape(*(n for c in chunks for n in (c, chunk))).transpose(0, 2, 4, 1, 3, 5)
    assert np.array_equal(places, np.flatnonzero(blocks)), "numbered chunk by chunk, x fastest"
    z, y, x = np.moveaxis(read, -1, 0)
    slot = np.ravel_multi_index((z // chunk, y // chunk, x // chunk), chunks)
    offset = np.ravel_multi_index((z % chunk, y % chunk, x % chunk), (chunk,) * 3)
    assert np.array_equal(places[corners], slot * chunk**3 + offset)


@SIDES
def test_coarse_texels_are_those_that_have_light_first(chunk):
    _, places, _ = view_of(border_points(), chunk=chunk, coarse=True)
    assert first_texels(places % chunk**3, chunk.bit_length() - 1).all()


def test_ones_counts_bits():
    for word in (0, 1, 0b1011, 2**32 - 1, 1 << 31):
        assert ones(word) == word.bit_count()


@SIDES
def test_rows_are_looked_up_chunk_by_chunk(chunk):
    """Two chunks of a view, of which one is in the pool: texels get its rows, their errors and
    their stamps.
    """
    table = np.full((3, chunk**3), UNLIT_ROW, np.int32)
    table[2, [5, 9, 11, 500]] = 4, VOID_ROW, BURIED_ROW, 1
    pool_error, pool_stamp = RNG.random((2, 6)).astype(np.float32)
    places = np.array([5, 6, 9, 11, 500, chunk**3 + 5], np.uint32)
    rows, error, stamp = np.zeros(6, np.int32), *np.zeros((2, 6), np.float32)
    pages = Pages(table, pool_error, pool_stamp)
    find_rows(lattice(chunk), places, np.array([2, -1], np.int32), pages, rows, error, stamp)
    assert rows.tolist() == [4, UNLIT_ROW, VOID_ROW, BURIED_ROW, 1, UNLIT_ROW]
    assert error.tolist() == [pool_error[4], 0.0, 0.0, 0.0, pool_error[1], 0.0]
    assert stamp.tolist() == [
        pool_stamp[4],
        UNLIT_ROW,
        VOID_ROW,
        BURIED_ROW,
        pool_stamp[1],
        UNLIT_ROW,
    ]
