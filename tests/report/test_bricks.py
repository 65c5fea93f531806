"""Coarse and fine lattices under one view: against trilinear light, loops, counts of sets, and choices by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.frame.surroundings import Turned
from isogi_core.kernels.lattice import Lattice
from isogi_core.kernels.lights import unshadowed
from isogi_core.kernels.shares import LEAST_COSINE
from isogi_core.report import bricks
from isogi_core.report.bench import Bench
from isogi_core.report.bricks import Bricks, Study, by_coarser, by_error, by_spread, choose, mixed
from isogi_core.report.interpolation import texels_around
from isogi_core.report.metrics import luminance
from isogi_core.report.moved import POWER, by_shares_and_normals
from isogi_core.report.points import Lit, straight_light
from isogi_core.report.strides import Lights, Net, Texels, cells_of, find_texels
from tests.report.conftest import CONSTANT, MakeBench

LATTICE = Lattice.of((9, 12, 15), (2.0, 2.0, 2.0))


@pytest.fixture(scope="module")
def lights(under_sky: Bench) -> Lights:
    """Light of the orbital's texels, and of every second one."""
    return Lights(under_sky, find_texels(under_sky, under_sky.view, (2, 1)), 32)


@pytest.mark.parametrize("stride", [1, 2, 4, 8])
def test_cells_hold_their_points_and_weights_find_them(stride: int) -> None:
    points = np.random.default_rng(2).random((200, 3)) * (np.array(LATTICE.shape[::-1]) - 1) / 2.0
    cells = cells_of(points.astype(np.float32), LATTICE, stride)
    places = np.stack(np.unravel_index(cells.corners, LATTICE.shape), axis=-1)
    last = np.array(LATTICE.shape) - 1
    assert ((places % stride == 0) | (places == last)).all()
    assert ((places[:, 7] - places[:, 0] <= stride) & (places[:, 7] > places[:, 0])).all()
    assert np.allclose(cells.weights.sum(axis=1), 1.0) and (cells.weights >= 0.0).all()
    found = np.einsum("mk,mkc->mc", cells.weights, places)
    assert np.allclose(found[:, ::-1] / 2.0, points, atol=1e-5)


def test_texels_are_each_told_once_and_coarse_ones_are_among_the_fine(under_sky: Bench, lights: Lights) -> None:
    texels = lights.texels
    assert len(np.unique(texels.places, axis=0)) == len(texels.places) == len(texels.ways)
    shape = under_sky.renderer(under_sky.scene).recipe.shape
    for cells, numbers in zip(texels.cells, texels.numbers, strict=True):
        assert np.array_equal(np.ravel_multi_index(tuple(texels.places[numbers].T), shape).T, cells.corners)
    own = texels_around(under_sky)[0]
    fine = {tuple(place) for place in texels.places[texels.numbers[1]].reshape(-1, 3).tolist()}
    assert fine <= {tuple(place) for place in own.tolist()}


def test_unshadowed_light_is_what_the_kernel_says_of_each_normal(under_sky: Bench, lights: Lights) -> None:
    look = under_sky.renderer(under_sky.scene).caches.look("gi")
    sky = Turned(look, under_sky.view).sky
    basis = np.empty(sky.order**2)
    light = np.array([unshadowed(*sky, tuple(n), basis) for n in lights.sides.normals])
    expected = look.unit * luminance(np.maximum(light, 0.0)) + straight_light(under_sky)
    assert np.allclose(bricks.unshadowed(under_sky, lights), expected, rtol=1e-6)


@pytest.mark.parametrize("way", [math.inf, 0.3])
def test_a_net_is_what_a_loop_over_its_corners_finds(lights: Lights, way: float) -> None:
    sides, bench = lights.sides, lights.bench
    around, straight = sides.beyond(way), straight_light(bench)
    for k, net in enumerate(lights.nets(way)):
        for m in range(0, len(sides.normals), 7):
            weights, shares, lost = [], [], []
            for t, trilinear in zip(lights.texels.numbers[k][m], lights.texels.cells[k].weights[m], strict=True):
                if around.lit[t]:
                    cosine = float(around.normals[t] @ sides.normals[m])
                    weights.append(trilinear * max(cosine, LEAST_COSINE) ** POWER)
                    shares.append(around.light[t] / sides.bare(around.normals[t : t + 1])[0])
                    lost.append(1.0 - cosine)
            under = sides.bare(sides.normals[m : m + 1])[0]
            mean = np.average(shares, weights=weights)
            assert net.lit.light[m] == pytest.approx(mean * under + straight[m])
            deviation = math.sqrt(np.average((np.array(shares) - mean) ** 2, weights=weights))
            assert net.spread[m] == pytest.approx(deviation * under, abs=1e-6 * under)
            turn = math.sqrt(max(2.0 * np.average(lost, weights=weights), 0.0))
            assert net.turn[m] == pytest.approx(turn * mean * under, abs=1e-6 * under)


def test_every_texel_is_the_study_of_moved_texels(under_sky: Bench, lights: Lights) -> None:
    """Both take light as shares by weights of normals; texels beyond the cell have none there."""
    sides, fine = lights.sides, lights.nets(0.3)[1]
    taps = np.zeros((len(sides.normals), 64), np.int64)
    taps[:, bricks_corners()] = lights.texels.numbers[1]
    fractions = texels_around(under_sky)[2]
    around = replace(sides.beyond(0.3), numbers=taps, fractions=fractions)
    expected = by_shares_and_normals(sides, around)
    assert np.allclose(fine.lit.light, expected.light + straight_light(under_sky), rtol=1e-5)
    assert np.allclose(fine.lit.noise, expected.noise, rtol=1e-4)


def bricks_corners() -> np.ndarray:
    """Where the corners of a cell are among 4 × 4 × 4 taps."""
    return np.array([16 * z + 4 * y + x for z in (1, 2) for y in (1, 2) for x in (1, 2)])


def test_bricks_are_those_that_points_lie_in() -> None:
    rng = np.random.default_rng(4)
    points, wide = rng.random((60, 3)) * 30.0, rng.random((300, 3)) * 30.0
    found = Bricks.of(points, wide, 8.0)
    inside = {tuple(key): found.numbers[m] for m, key in enumerate(np.floor(points / 8.0).astype(int).tolist())}
    assert len(inside) == len(found.pixels) == len(set(inside.values())) and found.pixels.sum() == 60
    expected = [inside.get(tuple(key), -1) for key in np.floor(wide / 8.0).astype(int).tolist()]
    assert found.wide.tolist() == expected and -1 in expected
    nets = np.arange(len(found.pixels)) % 3
    assert found.spread_out(nets).tolist() == [nets[each] if each >= 0 else -1 for each in expected]
    squares = rng.normal(size=60)
    means = [squares[found.numbers == b].mean() for b in range(len(found.pixels))]
    assert np.allclose(found.rms(squares), np.sqrt(np.maximum(means, 0.0)))


@pytest.fixture
def study() -> Study:
    """Nets of 40 pixels, the finer the less they err, over a wide view of 90 pixels and 2000 texels."""
    rng = np.random.default_rng(6)
    own = Lit(1.0 + rng.random(40), np.full(40, 1e-10))
    errors = rng.normal(size=40) * 0.2
    lit = [Lit(own.light + errors / 4**k, np.full(40, 1e-11)) for k in range(4)]
    nets = tuple(Net(8 >> k, 4.0 / 2**k, lit[k], np.abs(errors) / 2**k, np.ones(40)) for k in range(4))
    numbers = rng.integers(0, 2000, (4, 90, 8))
    return Study(nets, own, Texels((8, 4, 2, 1), (), numbers, np.empty(0), np.empty(0)), rng.integers(1, 3, 2000))


def test_texels_are_counted_once_with_the_coarser_ones_on_the_way(study: Study) -> None:
    nets = np.random.default_rng(7).integers(-1, 4, 90)
    nets[nets == 0] = 1
    for whole in (True, False):
        read = {
            int(t)
            for m, k in enumerate(nets)
            for j in range(1, 4)
            if (j <= k if whole else j == k)
            for t in study.wide.numbers[j, m]
        }
        assert study.texels(nets, whole) == sum(int(study.lights[t]) for t in read)


def test_errors_are_those_of_the_net_that_each_pixel_reads(study: Study) -> None:
    nets = np.arange(40) % 4
    wrong = np.array([study.nets[k].lit.light[m] - study.own.light[m] for m, k in enumerate(nets)])
    found = study.errors(nets)
    assert found.rmse == pytest.approx(math.sqrt((wrong**2).mean() - 1.1e-10) / study.own.light.mean())
    assert found.p99 == pytest.approx(np.percentile(np.abs(wrong), 99) / study.own.light.mean())


def test_a_brick_stops_at_the_first_estimate_within_the_tolerance() -> None:
    told = np.array([[9.0, 9.0, 0.0, 9.0], [0.5, 2.0, 2.0, 1.0], [3.0, 0.5, 2.0, 9.0], [9.0, 9.0, 9.0, 9.0]])
    assert choose(told, 1.0).tolist() == [1, 2, 3, 1]


def test_estimates_are_of_pixels_in_the_brick(study: Study) -> None:
    one = Bricks(np.zeros(40, np.int64), np.zeros(90, np.int64))
    light = [net.lit.light for net in study.nets]
    assert by_spread(study, one, 2)[0] == pytest.approx(math.sqrt((study.nets[2].spread ** 2).mean()))
    away = ((light[1] - study.own.light) ** 2).mean() - 1.1e-10
    assert by_error(study, one, 1)[0] == pytest.approx(math.sqrt(away))
    assert by_coarser(study, one, 2)[0] == pytest.approx(math.sqrt(((light[2] - light[1]) ** 2).mean() - 2e-11))


def test_mixtures_go_from_coarse_to_fine_as_the_tolerance_falls(study: Study) -> None:
    those = Bricks(np.arange(40), np.arange(90) % 40)
    curve = mixed(study, those, by_error, (10.0, 0.02, 0.0))
    shares, rmse = [it.share for it in curve], [it.errors.rmse for it in curve]
    assert shares[0] < shares[1] < shares[2] and rmse[0] > rmse[1] > rmse[2]
    for it, net in ((curve[0], 1), (curve[2], 3)):
        assert it.errors == study.errors(np.full(40, net)), "all bricks coarse, all bricks fine"
    (short,) = mixed(study, those, by_error, (0.0,), finest=2)
    assert short.errors == study.errors(np.full(40, 2)) and shares[1] < short.share < shares[2]


def test_a_finer_lattice_errs_less_and_a_mixture_needs_fewer_texels(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bricks, "WIDE", 96)
    monkeypatch.setattr(bricks, "SAMPLES", 256)
    section = bricks.study(make_bench(size=32, lights=[CONSTANT], lattice=0.5, target_error=0.05))
    one, first, equal, along, short = section.tables
    coarse, middle, fine = one.rows
    assert float(coarse[3] or 0.0) > 2.0 * float(middle[3] or 0.0) > 2.0 * float(fine[3] or 0.0)
    assert float(coarse[5] or 0) < 0.5 * float(middle[5] or 0) < 0.25 * float(fine[5] or 0)
    assert float(first.rows[0][1] or 0.0) > float(first.rows[1][1] or 0.0), "any light is better than none"
    shares = {str(row[0]): row[1] for row in equal.rows}
    assert float(shares["4 voxels, the error itself"] or 9.0) < 0.9
    assert len(along.rows) == len(short.rows) == len(bricks.EDGES) * len(bricks.TOLD)
    for (_, *most), (_, *least) in zip(along.rows, short.rows, strict=True):
        assert float(least[2] or 9.0) <= float(most[2] or 0.0), "nets that are left out are not read"
