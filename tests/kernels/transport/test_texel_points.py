"""Texels projected onto an isosurface: against a search in NumPy, on a ball, and where they cannot
be.
"""

import collections

import numpy as np
import pytest

from isogi_core.kernels.transport.transfer import (
    NO_SURFACE,
    NORMAL_TURNED,
    OTHER_SHEET,
    TEXEL_HEMMED,
    TEXEL_PROJECTED,
    TOO_FAR,
    measure_distances,
    project_texels,
)
from tests.kernels.fields import field_of
from tests.kernels.interpolation import OFFSET, REACH, STRIDE, search, smoothed, trilinear


def projected(voxels, level, texels, step=(1.0, 1.0, 1.0), spacing=(1.0, 1.0, 1.0)):
    """`project_texels`: points and normals (m, 3), and verdicts (m,)."""
    m = len(texels)
    points = np.empty((3, m))
    normals = np.empty((3, m))
    verdicts = np.empty(m, np.uint8)
    texels = np.ascontiguousarray(texels, np.int32)
    project_texels(
        field_of(voxels, spacing), np.array(step), level, texels, points, normals, verdicts
    )
    return points.T, normals.T, verdicts


def outward(voxels, p, spacing):
    """The unit world normal at `p`, by the smoothed gradient."""
    n = -smoothed(voxels, p) / spacing
    return n / np.linalg.norm(n)


def expected(voxels, level, p, spacing):
    """What becomes of a texel at `p`: verdict, and the stride of its way that the level is crossed
    in.
    """
    if np.abs(smoothed(voxels, p)).max() < 1e-9:
        return NO_SURFACE, None
    own = trilinear(voxels, p[None])[0]
    n = outward(voxels, p, spacing)
    down = n * spacing * (1.0 if own > level else -1.0)
    down /= np.linalg.norm(down)
    within = search(voxels, p, down, level)
    if within is None:
        return TOO_FAR, None
    reach = np.linalg.norm(within[1] - p)
    away = np.abs(
        trilinear(voxels, p + np.arange(0.0, reach - 1e-9, STRIDE)[:, None] * down) - level
    )
    there = within.mean(axis=0)
    m = outward(voxels, there, spacing)
    if (away - np.minimum.accumulate(away)).max() > 0.1 * abs(own - level):
        return OTHER_SHEET, within
    if n @ m <= 0.0:
        return NORMAL_TURNED, within
    up = m / spacing
    above = trilinear(voxels, there[None] + OFFSET * up / np.linalg.norm(up))[0]
    return (TEXEL_HEMMED if above > level else TEXEL_PROJECTED), within


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 4.0)])
@pytest.mark.parametrize("step", [1.0, 0.5])
def test_texels_go_where_a_search_in_numpy_finds_them(step, spacing):
    voxels = np.random.default_rng(5).integers(0, 5, (9, 9, 9)).astype(np.float32)
    texels = np.argwhere(np.ones([int(8 / step) + 1] * 3))[:: round(1 / step**3)]
    level = 1.7
    points, normals, verdicts = projected(voxels, level, texels, (step,) * 3, spacing)
    kinds = collections.Counter()
    unlike = 0
    for m, p in enumerate(texels[:, ::-1] * step):
        kind, within = expected(voxels, level, p, np.array(spacing))
        kinds[kind] += 1
        if kind != verdicts[m]:  # the middle of a stride stands for the crossing there
            unlike += 1
            assert {kind, int(verdicts[m])} <= {
                TEXEL_PROJECTED,
                NORMAL_TURNED,
                TEXEL_HEMMED,
                OTHER_SHEET,
            }
        elif kind == TEXEL_PROJECTED:
            inside = np.clip(within, 0.0, 8.0)
            assert (points[m] >= inside.min(axis=0) - 1e-9).all() and (
                points[m] <= inside.max(axis=0) + 1e-9
            ).all()
            assert trilinear(voxels, points[None, m])[0] == pytest.approx(level)
            np.testing.assert_allclose(normals[m], outward(voxels, points[m], spacing), atol=1e-9)
        else:
            np.testing.assert_array_equal(points[m], p)
    assert unlike <= 0.05 * len(texels)
    assert kinds.keys() >= {TEXEL_PROJECTED, TOO_FAR, OTHER_SHEET, NORMAL_TURNED} | (
        {TEXEL_HEMMED} if step == 1.0 else set()
    ), kinds


@pytest.mark.parametrize("level", [-0.7, 0.0, 0.7])
def test_texels_about_a_ball_go_to_the_isosurface_that_is_shown(level):
    z, y, x = np.mgrid[:31, :31, :31] - 15.0
    depth = 10.0 - np.sqrt(x * x + y * y + z * z)
    texels = np.argwhere(np.abs(depth - level) < 1.3)
    points, normals, verdicts = projected(depth, level, texels)
    assert (verdicts == TEXEL_PROJECTED).all()
    away = points - 15.0
    size = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(size, 10.0 - level, atol=0.05)
    np.testing.assert_allclose(np.einsum("mi,mi->m", normals, away / size[:, None]), 1.0, atol=1e-3)
    straight = (texels[:, ::-1] - 15.0) / np.linalg.norm(texels - 15.0, axis=1, keepdims=True)
    assert np.einsum("mi,mi->m", straight, away / size[:, None]).min() > 0.99, (
        "they go straight up or down"
    )


def test_a_surface_farther_than_texels_go_is_out_of_reach():
    height = np.broadcast_to(np.arange(12.0)[:, None, None], (12, 6, 6))
    texels = [[z, 3, 3] for z in range(12)]
    points, _, verdicts = projected(height, 5.2, texels)
    near = np.abs(np.arange(12) - 5.2) <= REACH
    assert np.array_equal(verdicts == TEXEL_PROJECTED, near) and (verdicts[~near] == TOO_FAR).all()
    np.testing.assert_allclose(points[near, 2], 5.2)


def test_a_dip_on_the_way_tells_of_another_sheet_if_it_is_deep():
    profile = np.array([0.0, 0.0, 0.0, 4.0, 4.0, 8.0, 8.0, 8.0, 8.0])
    for dip, wanted in ((0.04, TEXEL_PROJECTED), (1.5, OTHER_SHEET)):
        heights = profile.copy()
        heights[4] -= dip
        field = np.broadcast_to(heights[:, None, None], (9, 5, 5))
        verdict = projected(field, 4.5, [[3, 2, 2]])[2][0]
        assert verdict == wanted, f"0.5 to go, a tenth of which is less than {dip}"


def test_flat_places_and_holes_have_no_way():
    voxels = np.zeros((8, 8, 8), np.float32)
    voxels[6:] = 1.0
    voxels[4, 4, 4] = np.nan
    _, _, verdicts = projected(voxels, 0.5, [[1, 1, 1], [4, 4, 4], [5, 1, 1]])
    assert verdicts.tolist() == [NO_SURFACE, NO_SURFACE, TEXEL_PROJECTED]


def test_ways_are_estimated_to_first_order():
    rng = np.random.default_rng(2)
    voxels = rng.random((8, 8, 8)).astype(np.float32)
    texels = rng.integers(0, 15, (50, 3))
    ways = np.empty(len(texels))
    measure_distances(
        field_of(voxels), np.full(3, 0.5), 0.4, np.ascontiguousarray(texels, np.int32), ways
    )
    places = texels[:, ::-1] * 0.5
    slopes = np.array([np.linalg.norm(smoothed(voxels, p)) for p in places])
    np.testing.assert_allclose(ways, np.abs(trilinear(voxels, places) - 0.4) / slopes, rtol=1e-9)


def test_ways_from_flat_places_and_holes_are_endless():
    voxels = np.zeros((8, 8, 8), np.float32)
    voxels[6, 6, 6] = np.nan
    ways = np.empty(2)
    texels = np.array([[1, 1, 1], [6, 6, 6]], np.int32)
    measure_distances(field_of(voxels), np.ones(3), 0.0, texels, ways)
    assert np.isinf(ways).all()
