"""Antialiasing: where samples go, what they show, and that the picture comes nearer to the true one."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.frame import film
from isogi_core.frame.film import BACKGROUND, BUDGET, COUNTS, averaged, develop, find_edges, linear_table, pattern
from tests.frame.conftest import Workbench

SIZE = 224
TRUE = 256
"""Samples of a pixel that counts as true."""


@pytest.mark.parametrize("count", [*COUNTS, TRUE])
def test_samples_are_spread_evenly_over_the_pixel(count: int) -> None:
    places = pattern(count)
    for axis in range(2):
        assert sorted((places[:, axis] * count).astype(int)) == list(range(count))
    np.testing.assert_allclose(places.mean(axis=0), 0.5, atol=1e-6)


def test_edges_are_silhouettes_and_contrasts_and_nothing_else() -> None:
    state, picture = np.zeros((200, 200), np.uint8), np.full((200, 200, 3), 90, np.uint8)
    state[10:30, 10:30] = 3
    picture[10:30, 20:] = 130
    edges, count = find_edges(picture, state)
    found = np.zeros(state.size, np.bool_)
    found[edges] = True
    wanted = np.zeros(state.shape, np.bool_)
    wanted[9:31, 9:31] = True
    wanted[11:29, 11:29] = False
    wanted[10:30, 19:21] = True
    assert np.array_equal(found.reshape(state.shape), wanted) and count == max(COUNTS)


@pytest.mark.parametrize("place", [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_a_brighter_pixel_is_an_edge_on_all_sides(place: tuple[int, int]) -> None:
    picture = np.full((4, 4, 3), 100, np.uint8)
    picture[place] = 130
    edges, _ = find_edges(picture, np.full((4, 4), 3, np.uint8))
    beside = {place, *((place[0] + y, place[1] + x) for y, x in ((0, 1), (1, 0), (0, -1), (-1, 0)))}
    assert {divmod(int(each), 4) for each in edges} >= beside


def test_strongest_edges_come_first_and_the_budget_holds() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (400, 400, 3)).astype(np.uint8)
    picture[:, 200:] //= 4
    edges, count = find_edges(picture, np.full((400, 400), 3, np.uint8))
    assert count == min(COUNTS) and 0.9 * BUDGET < len(edges) * count / 400**2 <= BUDGET
    assert (np.diff(edges.astype(int)) > 0).all() and (edges % 400 < 201).all()


def test_smooth_edges_are_four_times_nearer_to_the_true_ones(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = orbital.view(size=SIZE, smooth=True)
    exposure = orbital.scene.default_exposure
    frame, plain = orbital.renderer.render(view), orbital.renderer.render(replace(view, smooth=False))
    assert frame.edges is not None and plain.edges is None
    pixels = frame.edges.pixels
    monkeypatch.setattr(film, "find_edges", lambda *_: (pixels, TRUE))
    true = orbital.renderer.render(view).edges
    assert true is not None
    partly = (true.covered[:, 3] > 0.0) & (true.covered[:, 3] < 1.0)
    wanted = linear_table()[averaged(true, exposure, BACKGROUND, clear=False)][partly]
    smooth, stairs = (
        np.sqrt(np.mean((linear_table()[develop(each, exposure).reshape(-1, 3)[pixels[partly]]] - wanted) ** 2))
        for each in (frame, plain)
    )
    assert smooth < stairs / 4
    inside = np.ones(SIZE**2, np.bool_)
    inside[pixels] = False
    assert np.array_equal(
        develop(frame, exposure).reshape(-1, 3)[inside], develop(plain, exposure).reshape(-1, 3)[inside]
    )


def test_moving_views_have_no_more_samples(orbital: Workbench) -> None:
    assert orbital.renderer.render(orbital.view(size=32, smooth=True, moving=True)).edges is None


def test_a_view_of_nothing_has_no_edges(orbital: Workbench) -> None:
    assert orbital.renderer.render(orbital.view(size=16, distance=1000.0, smooth=True)).edges is None


def test_coverage_is_of_the_samples_on_the_surface(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view(size=64, smooth=True))
    assert frame.edges is not None
    light, share = frame.edges.covered[:, :3], frame.edges.covered[:, 3]
    assert ((share >= 0) & (share <= 1)).all() and ((share > 0) & (share < 1)).any()
    assert (light[share > 0].sum(axis=1) > 0).all() and (light[share == 0] == 0).all()
    clear = develop(frame, 1.0, "none", "transparent").reshape(-1, 4)[frame.edges.pixels, 3]
    np.testing.assert_allclose(clear, 255 * share, atol=0.6)
