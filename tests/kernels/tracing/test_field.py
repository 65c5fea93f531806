"""The scalar field against NumPy and SciPy: trilinear values and gradients, the B-spline's weights
and gradient.
"""

import math

import numpy as np
import pytest
from numba import njit
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates

from isogi_core.kernels.tracing import field
from tests.kernels.fields import bare_field
from tests.scale import few

COUNT = few(2000, 50)
RNG = np.random.default_rng(11)
VOXELS = RNG.random((6, 7, 9), np.float32)
SIZE = np.array(VOXELS.shape[::-1])
ANYWHERE = RNG.random((COUNT, 3)) * (SIZE - 1)
LATTICE = (
    np.stack(np.meshgrid(*map(np.arange, SIZE), indexing="ij"), axis=-1)
    .reshape(-1, 3)
    .astype(float)
)
FACES = np.where(RNG.random((COUNT, 3)) < 0.5, np.rint(ANYWHERE), ANYWHERE)
POINTS = np.concatenate([ANYWHERE, FACES, LATTICE])


@njit(cache=True)
def values(voxels, points):
    """`field.value` at points (n, 3)."""
    out = np.empty(len(points))
    for m in range(len(points)):
        out[m] = field.value(voxels, (points[m, 0], points[m, 1], points[m, 2]))
    return out


@njit(cache=True)
def gradients(voxels, points, smooth):
    """`field.gradient` or `field.smooth_gradient` at points (n, 3)."""
    out = np.empty((len(points), 3))
    for m in range(len(points)):
        p = (points[m, 0], points[m, 1], points[m, 2])
        if smooth:
            g = field.smooth_gradient(voxels, p)
        else:
            g = field.gradient(voxels, p)
        out[m, 0], out[m, 1], out[m, 2] = g
    return out


def cells(points):
    """Lower corner (n, 3) of the cell of each point; a point on the last face belongs to the last
    cell.
    """
    return np.minimum(np.floor(points).astype(int), SIZE - 2)


def interpolate(voxels, points, order):
    """SciPy's interpolation, with the voxels as B-spline coefficients and the border's repeated
    beyond it.
    """
    return map_coordinates(
        voxels.astype(float), points.T[::-1], order=order, prefilter=False, mode="nearest"
    )


def tensor_gradient(points, taps, weights, slopes):
    """Σ over all taps of voxel · weight · weight · slope, by three explicit outer products; (n,
    3).
    """
    base = cells(points)
    out = np.zeros((len(points), 3))
    for m, p in enumerate(points):
        w = [weights(t) for t in p - base[m]]
        s = [slopes(t) for t in p - base[m]]
        index = [np.clip(base[m, a] + np.array(taps), 0, SIZE[a] - 1) for a in range(3)]
        block = VOXELS[np.ix_(index[2], index[1], index[0])].astype(float)
        for axis in range(3):
            x, y, z = (s[a] if a == axis else w[a] for a in range(3))
            out[m, axis] = np.einsum("kji,k,j,i->", block, z, y, x)
    return out


def test_value_is_scipys_linear_interpolation():
    np.testing.assert_allclose(
        values(VOXELS, POINTS), interpolate(VOXELS, POINTS, 1), rtol=0, atol=1e-14
    )


def test_value_at_a_lattice_point_is_the_voxel_exactly():
    i, j, k = LATTICE.astype(int).T
    assert np.array_equal(values(VOXELS, LATTICE), VOXELS[k, j, i].astype(float))


def test_gradient_is_the_sum_over_eight_corners():
    expected = tensor_gradient(POINTS[:COUNT], (0, 1), lambda f: [1 - f, f], lambda f: [-1, 1])
    np.testing.assert_allclose(
        gradients(VOXELS, POINTS[:COUNT], False), expected, rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("f", [0.0, 0.1, 1 / 3, 0.5, 0.9, 1.0])
def test_bspline_weights_are_scipys_and_sum_to_one(f):
    basis = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
    places = f - np.arange(-1, 3)
    np.testing.assert_allclose(field.bspline(f), np.nan_to_num(basis(places)), atol=1e-15)
    np.testing.assert_allclose(
        field.bspline_slope(f), np.nan_to_num(basis.derivative()(places)), atol=1e-15
    )
    assert math.fsum(field.bspline(f)) == pytest.approx(1.0, abs=1e-15)
    assert math.fsum(field.bspline_slope(f)) == pytest.approx(0.0, abs=1e-15)


def test_smooth_gradient_is_the_explicit_sum_over_64_voxels():
    points = np.concatenate([POINTS[:COUNT], LATTICE[::3]])
    expected = tensor_gradient(points, (-1, 0, 1, 2), field.bspline, field.bspline_slope)
    np.testing.assert_allclose(gradients(VOXELS, points, True), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "spacing", [(1.0, 1.0, 1.0), (1.0, 2.0, 0.25), (1e-9, 1e-9, 3e-9), (1e-3, 0.03, 1.0)]
)
def test_normal_of_a_slope_is_exact_in_world_space(spacing):
    towards = np.array([2.0, -1.0, 3.0]) / math.sqrt(14.0)
    x, y, z = (np.arange(8.0) * s for s in spacing)
    planes = (
        towards[0] * x[None, None, :]
        + towards[1] * y[None, :, None]
        + towards[2] * z[:, None, None]
    )
    slope = bare_field(-planes / np.abs(planes).max(), spacing)
    rounding = 1e-6 * max(spacing) / min(spacing)
    np.testing.assert_allclose(field.normal(slope, (3.3, 3.7, 3.1)), towards, atol=rounding)


def test_normals_are_of_the_plain_gradient_where_smooth_is_off():
    rough = bare_field(VOXELS, (1.0, 2.0, 0.5))
    plain = rough._replace(smooth=False)
    points = POINTS[:200]
    g = gradients(VOXELS, points, False) / rough.spacing
    expected = -g / np.linalg.norm(g, axis=1, keepdims=True)
    found = np.array([[field.normal(each, tuple(p)) for p in points] for each in (plain, rough)])
    np.testing.assert_allclose(found[0], expected, atol=1e-12)
    assert np.abs(found[1] - expected).max() > 0.1


@pytest.mark.parametrize(
    "g", [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (math.inf, 0.0, 0.0), (0.0, -0.0, 0.0)]
)
def test_a_gradient_that_says_nothing_has_no_normal(g):
    assert field.to_world_normal(g, (1.0, 1.0, 1.0)) == (0.0, 0.0, 0.0)


def test_normal_of_a_ball_points_out():
    z, y, x = np.mgrid[:32, :32, :32] - 15.5
    ball = bare_field(12.0 - np.sqrt(x * x + y * y + z * z))
    units = RNG.normal(size=(COUNT, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    found = np.array([field.normal(ball, tuple(15.5 + 9.0 * u)) for u in units[:200]])
    assert (found * units[:200]).sum(axis=1).min() > math.cos(math.radians(0.5))


def test_next_to_a_hole_the_cells_own_gradient_stands_in():
    voxels = np.ascontiguousarray(np.broadcast_to(-np.arange(8, dtype=np.float32), (8, 8, 8)))
    whole = field.normal(bare_field(voxels), (3.5, 3.5, 3.5))
    voxels = voxels.copy()
    voxels[2, 2, 2] = np.nan
    assert np.isnan(gradients(voxels, np.full((1, 3), 3.5), True)).all()
    assert (
        field.normal(bare_field(voxels), (3.5, 3.5, 3.5)) == pytest.approx(whole) == (1.0, 0.0, 0.0)
    )
    assert field.normal(bare_field(voxels), (2.5, 2.5, 2.5)) == (0.0, 0.0, 0.0)


def test_a_plateau_has_no_normal_and_its_edge_has():
    voxels = np.zeros((8, 8, 8), np.float32)
    voxels[..., 5:] = 1.0
    assert field.normal(bare_field(voxels), (2.5, 3.5, 3.5)) == (0.0, 0.0, 0.0)
    assert field.normal(bare_field(voxels), (4.5, 3.5, 3.5)) == pytest.approx((-1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("x", "cell"), [(-0.5, 0), (0.0, 0), (0.99, 0), (1.0, 1), (3.0, 3), (4.0, 3), (9.0, 3)]
)
def test_the_last_face_belongs_to_the_last_cell(x, cell):
    assert field.clamp_cell(x, 5) == cell
