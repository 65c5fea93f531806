"""Texels at the edge of a plateau: against a search in NumPy, and where a wall, a ball and a border
put them.
"""

import collections

import numpy as np
import pytest

from isogi_core.kernels.transport.transfer import locate_texels
from tests.kernels.fields import field_of
from tests.kernels.interpolation import OFFSET, at_edge, search, smoothed, trilinear

SIDE = 16
LAYERS = np.arange(SIDE)[:, None, None] + np.zeros((SIDE, SIDE, SIDE))
AROUND = np.array(list(np.ndindex(3, 3, 3))) - 1.0
WALL = (LAYERS < 8).astype(np.float32)


def locate(voxels, texels, step=(1.0, 1.0, 1.0), spacing=(1.0, 1.0, 1.0)):
    """`locate_texels`: points and normals (m, 3), isovalues and void (m,)."""
    m = len(texels)
    points = np.empty((3, m))
    normals = np.empty((3, m))
    isovalues = np.empty(m)
    void = np.empty(m, np.bool_)
    texels = np.ascontiguousarray(texels, np.int32)
    locate_texels(
        field_of(voxels, spacing), np.array(step), texels, points, normals, isovalues, void
    )
    return points.T, normals.T, isovalues, void


def about(voxels, p):
    """The voxels that the smoothed gradient at `p` is made of."""
    return voxels[tuple(slice(max(int(np.floor(x)) - 1, 0), int(np.ceil(x)) + 2) for x in p[::-1])]


def lifted(voxels, points, normals):
    """Values where rays from points (m, 3) start along their normals in index space, of any
    length.
    """
    with np.errstate(invalid="ignore"):
        return trilinear(
            voxels,
            points + OFFSET * normals / np.linalg.norm(normals, axis=1, keepdims=True),
        )


def expected(voxels, p):
    """What becomes of a texel at `p`: "own", "kept", "void" or "moved", its isovalue, and the
    stride that it is in.
    """
    block = about(voxels, p)
    own = trilinear(voxels, p[None])[0]
    low, high = np.nanmin(block), np.nanmax(block)
    level = (low + high) / 2
    if not at_edge(block, own):
        return "own", own, None
    uphill = smoothed(voxels, p)
    down = uphill / np.linalg.norm(uphill) * (-1.0 if own > level else 1.0)
    found = search(voxels, p, down, level)
    behind = AROUND[AROUND @ down < -0.6]
    if own > level and (found is None or (trilinear(voxels, p + behind) <= level).any()):
        return "void", own, None
    if found is None:
        return ("kept", own, None)
    return ("moved", level, found)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 4.0)])
@pytest.mark.parametrize("step", [1.0, 0.5])
def test_texels_are_where_a_search_in_numpy_finds_them(step, spacing):
    voxels = np.random.default_rng(3).integers(0, 4, (9, 9, 9)).astype(np.float32)
    texels = np.argwhere(np.ones([int(8 / step) + 1] * 3))[:: int(3 / step**3)]
    texels = texels[[np.abs(smoothed(voxels, texel[::-1] * step)).max() > 1e-9 for texel in texels]]
    points, normals, isovalues, void = locate(voxels, texels, (step,) * 3, spacing)
    above = lifted(voxels, points, normals / spacing) - isovalues
    kinds = collections.Counter()
    for m, p in enumerate(texels[:, ::-1] * step):
        kind, isovalue, within = expected(voxels, p)
        if within is None:
            within = p[None]
        else:
            within = np.clip(within, 0.0, 8.0)
        if kind != "void" and abs(above[m]) > 1e-9:
            kind = "hemmed in" if above[m] > 0.0 else kind
            assert void[m] == (kind == "hemmed in")
        kinds[kind] += 1
        assert void[m] or kind != "void"
        assert isovalues[m] == pytest.approx(isovalue)
        assert (points[m] >= within.min(axis=0) - 1e-9).all() and (
            points[m] <= within.max(axis=0) + 1e-9
        ).all()
        assert kind != "moved" or trilinear(voxels, points[None, m])[0] == pytest.approx(isovalue)
    assert kinds.keys() >= {"own", "moved", "void", "hemmed in"}, kinds


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 1.0, 1000.0), (20.0, 1.0, 0.01)])
def test_both_sides_of_a_masks_wall_are_lit_in_its_middle(spacing):
    texels = [[z, y, x] for z in (7, 8) for y in (0, 5, 15) for x in (3, 15)]
    points, normals, isovalues, void = locate(WALL, texels, spacing=spacing)
    assert not void.any() and (isovalues == 0.5).all()
    np.testing.assert_allclose(points, [(x, y, 7.5) for _, y, x in texels], atol=1e-9)
    np.testing.assert_allclose(normals, [(0.0, 0.0, 1.0)] * len(texels), atol=1e-12)


def test_texels_about_a_masks_ball_are_lit_on_its_skin():
    z, y, x = np.mgrid[:31, :31, :31] - 15.0
    distance = np.sqrt(x * x + y * y + z * z) - 10.2
    texels = np.argwhere(np.abs(distance) < 0.5)
    points, normals, isovalues, void = locate(distance < 0.0, texels)
    assert not void.any() and (isovalues == 0.5).all()
    away = points - 15.0
    size = np.linalg.norm(away, axis=1)
    slant = np.degrees(
        np.arccos(np.einsum("mi,mi->m", normals, away / size[:, None]).clip(-1.0, 1.0))
    )
    assert np.abs(size - 10.2).max() < 0.8 and np.abs(size - 10.2).mean() < 0.25
    assert slant.max() < 35.0 and slant.mean() < 10.0


def test_texels_of_a_rising_field_stay_on_their_own_isosurfaces():
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE] / SIDE
    voxels = np.exp(x + 0.3 * y - 0.5 * z).astype(np.float32)
    texels = np.argwhere(np.ones([SIDE - 2] * 3))[::31] + 1
    points, _, isovalues, void = locate(voxels, texels)
    assert not void.any()
    assert np.array_equal(points, texels[:, ::-1])
    assert np.array_equal(isovalues, voxels[tuple(texels.T)])


def test_voxels_that_are_no_number_leave_the_others_alone():
    voxels = WALL.copy()
    voxels[6:9, 5, 5] = np.nan
    points, _, isovalues, void = locate(voxels, [[7, 6, 6], [8, 6, 6], [7, 5, 5], [7, 4, 4]])
    assert void.tolist() == [False, True, True, True], (
        "their own cells are sound; flat; not a number; nor this"
    )
    np.testing.assert_allclose(points[0], (6.0, 6.0, 7.5), atol=1e-9)
    assert isovalues[0] == 0.5


def test_texels_stay_in_the_box():
    """Steps down to a border: from the top of the last, the way is out of the box."""
    voxels = np.where(LAYERS + LAYERS.transpose(2, 1, 0) < 28, 1.0, 0.0).astype(np.float32)
    texels = [[15, 4, 12], [15, 4, 13], [12, 15, 15], [13, 15, 15]]
    points, _, isovalues, void = locate(voxels, texels)
    assert not void.any() and (isovalues == 0.5).all()
    assert points.min() >= 0.0 and points.max() <= SIDE - 1


def test_a_wall_one_voxel_thin_has_no_texels_of_its_own():
    """Nor where it meets a thick one, whose normals point along it; those on its sides are lit on
    their side of it.
    """
    voxels = np.where((LAYERS == 8) | (LAYERS.transpose(0, 2, 1) < 3), 1.0, 0.0).astype(np.float32)
    texels = [[z, y, 7] for z in (7, 8, 9) for y in (2, 3, 8)]
    points, normals, _, void = locate(voxels, texels)
    assert void.tolist() == [False] * 3 + [True] * 3 + [False] * 3
    np.testing.assert_allclose(points[[2, 8]], [(7.0, 8.0, 7.5), (7.0, 8.0, 8.5)], atol=1e-9)
    np.testing.assert_allclose(normals[[2, 8]], [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)], atol=1e-12)


def test_a_bump_of_a_voxel_is_no_wall():
    voxels = WALL.copy()
    voxels[8, 8, 8] = 1.0
    points, normals, _, void = locate(voxels, [[8, 8, 8]])
    assert not void[0]
    np.testing.assert_allclose(points, [(8.0, 8.0, 8.5)], atol=1e-9)
    np.testing.assert_allclose(normals, [(0.0, 0.0, 1.0)], atol=1e-12)
