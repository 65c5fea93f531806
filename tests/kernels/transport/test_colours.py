"""Albedos by data against NumPy, and transfer that carries them against a twin path by path and
against one albedo.
"""

import numpy as np
import pytest

from isogi_core.kernels.tracing.vec import column
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport import colours as module
from isogi_core.kernels.transport.colours import fill_albedos, sample_layer, slope_layer
from isogi_core.kernels.transport.paths import PathTree, SampleRange, TransferRules
from isogi_core.kernels.transport.transfer import ColouredRules, bake_coloured_texels, bake_texels
from tests.kernels.fields import field_of
from tests.kernels.rooms import room_of
from tests.kernels.transport.lighting import TORUS, halves_of, place_of
from tests.oracles.paths import DARK, NO_GLOWS, Start, one_surface, trace
from tests.scale import few

COUNT = few(40, 3)
BOUNCES = 4


def table_of(low, high, outside=(0.5, 0.5, 0.5)):
    """A table of colours from ``low`` to ``high``, linear in the code."""
    share = np.linspace(0.0, 1.0, 255)[:, None]
    return np.vstack([outside, (1.0 - share) * np.array(low) + share * np.array(high)])


def colours_of(places, step=1.0, table=None):
    """Colours of codes (z, y, x) or labels (z, y, x, 3), by a table of red to blue."""
    if table is None:
        made = table_of((0.9, 0.1, 0.2), (0.0, 0.3, 0.8))
    else:
        made = table
    return module.colours_of(np.ascontiguousarray(places, np.uint8), (step, step, step), made)


def one_colour(albedo):
    """Colours that are the same everywhere on the torus."""
    return colours_of(np.full((41, 41, 41), 7), table=table_of(albedo, albedo))


def twin(colours, p):
    """``albedo_at`` by NumPy: the mean code of corners with a value, and the share that these
    have.
    """
    place = p / colours.step
    cell = np.clip(np.floor(place).astype(int), 0, np.array(colours.codes.shape)[::-1] - 2)
    f = np.clip(place - cell, 0.0, 1.0)
    known = 0.0
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, f, 1.0 - f))
        code = int(colours.codes[tuple((cell + corner)[::-1])])
        known = known + weight * (code > 0)
        total = total + weight * code
    mapped = [
        np.interp(total / max(known, 1e-30), np.arange(1, 256), column)
        for column in colours.table[1:].T
    ]
    return known * np.array(mapped) + (1.0 - known) * colours.table[0]


@pytest.mark.parametrize("step", [1.0, 2.5])
def test_albedos_between_codes_are_those_of_numpy(step: float) -> None:
    rng = np.random.default_rng(5)
    colours = colours_of(rng.integers(0, 256, (4, 5, 6)) * (rng.random((4, 5, 6)) < 0.7), step)
    points = (rng.random((200, 3)) * [5.4, 4.4, 3.4] * step - 0.2 * step).astype(np.float32)
    found = np.empty_like(points)
    fill_albedos(colours, points, found)
    np.testing.assert_allclose(found, [twin(colours, p.astype(float)) for p in points], atol=1e-6)


def label_twin(colours, p):
    """``albedo_at`` of labels by NumPy: trilinear shares of all of them, to their eighth power."""
    place = p / colours.step
    sides = np.array(colours.labels.shape)[2::-1]
    cell = np.clip(np.floor(place).astype(int), 0, sides - 2)
    f = np.clip(place - cell, 0.0, 1.0)
    shares = np.zeros(256)
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, f, 1.0 - f))
        first, second, share = colours.labels[tuple((cell + corner)[::-1])]
        shares[first] += weight * (1.0 - share / 510)
        shares[second] += weight * share / 510
    known = shares[1:].sum()
    powers = shares[1:] ** 8
    return known * (powers @ colours.table[1:]) / powers.sum() + (1.0 - known) * colours.table[0]


@pytest.mark.parametrize("step", [1.0, 2.0])
def test_albedos_between_labels_are_those_of_numpy(step: float) -> None:
    """Also where a corner has one label alone, and where a second one has a share of nothing."""
    rng = np.random.default_rng(6)
    labels = rng.integers(1, 6, (4, 5, 6, 3))
    labels[..., 2] = rng.integers(0, 256, (4, 5, 6))
    labels[rng.random((4, 5, 6)) < 0.3, 1:] = 0
    labels[rng.random((4, 5, 6)) < 0.1] = 0
    colours = colours_of(labels, step, np.vstack([rng.random((6, 3)), np.zeros((250, 3))]))
    points = (rng.random((200, 3)) * [5.4, 4.4, 3.4] * step - 0.2 * step).astype(np.float32)
    found = np.empty_like(points)
    fill_albedos(colours, points, found)
    np.testing.assert_allclose(
        found, [label_twin(colours, p.astype(float)) for p in points], atol=1e-6
    )


def test_sampling_brings_a_linear_volume_over() -> None:
    """a + b·x stays so through any affine map; outside of the other volume there is no value."""
    z, y, x = np.mgrid[:7, :8, :9].astype(float)
    voxels = (1.0 + 2.0 * x - 0.5 * y + 0.25 * z).astype(np.float32)
    matrix = np.array([[0.6, 0.3, 0.0, 1.0], [-0.2, 0.7, 0.1, 2.0], [0.0, 0.1, 0.9, 0.5]])
    step = np.array([0.5, 2.0, 1.0])
    values = np.empty((5, 40), np.float32)
    sample_layer(voxels, matrix, 3.0, step, values)
    row, column = np.mgrid[:5, :40]
    a, b, c = (m[0] * 0.5 * column + m[1] * 2.0 * row + m[2] * 3.0 + m[3] for m in matrix)
    inside = (a >= 0) & (a <= 8) & (b >= 0) & (b <= 7) & (c >= 0) & (c <= 6)
    assert inside.any() and not inside.all()
    np.testing.assert_allclose(
        values[inside], (1.0 + 2.0 * a - 0.5 * b + 0.25 * c)[inside], rtol=1e-5
    )
    assert np.isnan(values[~inside]).all()


def test_the_slope_of_a_ramp_is_per_unit_of_the_world() -> None:
    z, y, x = np.mgrid[:9, :9, :9].astype(np.float32)
    values = np.empty((9, 9), np.float32)
    spacing = np.array([0.5, 2.0, 4.0])
    slope_layer(x + 2.0 * y + 4.0 * z, spacing, 4.0, np.ones(3), values)
    np.testing.assert_allclose(values[2:-2, 2:-2], np.sqrt(2.0**2 + 1.0 + 1.0), rtol=1e-5)


def rules_of(survival=1.0, branches=1):
    """Rows of direct light, of the three channels of reflected light, and of the square of its
    sum.
    """
    mixes = np.vstack([np.eye(3)[:1], np.eye(3), np.ones((1, 3))])
    straight = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    reflected = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    squared = np.array([False, False, False, False, True])
    return ColouredRules(
        np.array([3, 2, 2, 2, 1]), straight, reflected, mixes, squared, BOUNCES, survival, branches
    )


def bake(texels, colours, survival=1.0, branches=1):
    """``bake_coloured_texels`` from nothing: sums (m, 2, 5, 9)."""
    field = field_of(TORUS)
    sums = np.zeros((len(texels), 2, 5, 9))
    place, cells = place_of(field, texels)
    some = SampleRange(3, COUNT)
    rules = rules_of(survival, branches)
    bake_coloured_texels(field, cells, colours, place, np.arange(len(texels)), some, rules, sums)
    return sums


@pytest.fixture(scope="module")
def texels():
    """Texels on the torus, those nearest to its axis first: few paths from others hit it."""
    every = np.argwhere(np.abs(TORUS) < 0.3)
    from_axis = np.hypot(*(every[:, 1:] - 20.0).T)
    return every[np.argsort(from_axis, kind="stable")][:: len(every) // few(60, 3)]


@pytest.mark.parametrize(("survival", "branches"), [(1.0, 1), (0.7, 1), (0.7, 4)])
def test_one_colour_everywhere_is_one_albedo(
    texels: np.ndarray, survival: float, branches: int
) -> None:
    """Direct light has the same bits as without colours, and reflected light is Σ R^k Y_i."""
    albedo = np.array([0.9, 0.6, 0.3])
    field = field_of(TORUS)
    sums = np.zeros((len(texels), 2, 4, 9))
    k = np.arange(BOUNCES + 1.0)[:, None]
    place, cells = place_of(field, texels)
    weights = albedo**k / survival ** np.maximum(k - 1.0, 0.0)
    shares = np.vstack([np.eye(BOUNCES + 2)[1], np.hstack([np.zeros((3, 2)), weights[1:].T])])
    rules = TransferRules(np.ascontiguousarray(shares), survival, branches)
    orders = np.array([3, 2, 2, 2])
    bake_texels(
        field, cells, place, np.arange(len(texels)), SampleRange(3, COUNT), rules, orders, sums
    )
    found = bake(texels, one_colour(albedo), survival, branches)
    assert sums[:, :, 1:].any()
    assert np.array_equal(found[:, :, 0], sums[:, :, 0])
    np.testing.assert_allclose(found[:, :, 1:4], sums[:, :, 1:], rtol=1e-9, atol=1e-9)


def test_squares_are_those_of_what_each_path_counts(texels: np.ndarray) -> None:
    """With one colour the square of the sum of three channels is that of one channel with three
    times the albedo.
    """
    found = bake(texels, one_colour((0.5, 0.5, 0.5)))
    squared = bake(texels, one_colour((0.25, 0.25, 0.25)))
    np.testing.assert_allclose(found[:, :, 4, 0], 9.0 * squared[:, :, 1, 0], rtol=1e-9)


@pytest.mark.parametrize(("survival", "branches"), [(1.0, 1), (0.7, 4)])
def test_a_path_takes_the_colours_of_what_it_hits(
    texels: np.ndarray, survival: float, branches: int
) -> None:
    """Red above the torus's plane, blue below: one ray at a time."""
    codes = np.ones((41, 41, 41))
    codes[20:] = 255
    field = field_of(TORUS)
    colours = colours_of(codes)
    some = texels[::6]
    place, _ = place_of(field, some)
    world = one_surface(field, room=room_of([], colours=colours))
    starts = halves_of(place)
    tree = PathTree(BOUNCES, survival, branches)
    expected = np.zeros((len(starts.isovalues), 3))
    for i, sample, branch in np.ndindex(len(expected), COUNT, branches):
        p, n = column(starts.points, i), column(starts.normals, i)
        start = Start(p, n, starts.isovalues[i], NO_WALL, starts.seeds[i], 3 + sample)
        path = trace(world, (DARK, NO_GLOWS), start, tree, branch, np.ones(3))
        if path.bounces > 0:
            expected[i] += path.carried / branches
    found = bake(some, colours, survival, branches)[:, :, 1:4, 0].reshape(-1, 3)
    assert expected.any()
    np.testing.assert_allclose(found * np.sqrt(4.0 * np.pi), expected, rtol=1e-9, atol=1e-12)
