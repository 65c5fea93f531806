"""Depth peels of balls within each other, against the crossings of rays with spheres."""

import numpy as np
import pytest

from isogi_core.frame.several.peels import Hits, Peeler, first_of, side_layers
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.peels import MAX_PEELED_LAYERS
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume
from isogi_core.plan.variants import Side
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import ball, scene_of

SIZE, EYE, MIDDLE = 24, np.array([20.0, -80.0, 20.0]), 20.0
LEVELS = (4.0, 0.0, 8.0)
"""Isovalues of balls of radius 8, 12 and 4."""


@pytest.fixture(scope="module")
def prepared() -> PreparedScene:
    return PreparedScene(scene_of(ball(), 4.0))


def peeled(prepared: PreparedScene, levels: tuple[float, ...], clears: list[float]) -> tuple[View, Hits, np.ndarray]:
    """What a view along y shows."""
    camera = Camera(tuple(EYE.tolist()), (MIDDLE, MIDDLE, MIDDLE), (0.0, 0.0, 1.0), 20.0)  # type: ignore[arg-type]
    view = View(levels[0], camera, width=SIZE, height=SIZE)
    peeler = Peeler.of(view, [prepared.surface(each) for each in levels], np.array(clears), Tiles())
    return view, *peeler.whole(view, Tiles())


def expected(point: np.ndarray, levels: tuple[float, ...], clears: list[float]) -> list[tuple[int, bool, float]]:
    """The surfaces along the ray from the eye to a ``point``, whether their inner sides are seen, and their weights."""
    d = (point - EYE) / np.linalg.norm(point - EYE)
    away = EYE - MIDDLE
    met = []
    for number, level in enumerate(levels):
        root = (away @ d) ** 2 - away @ away + (12.0 - level) ** 2
        if root > 0.0:
            met += [(-(away @ d) - np.sqrt(root), number, False), (-(away @ d) + np.sqrt(root), number, True)]
    left, found = 1.0, []
    for _, number, inner in sorted(met):
        if left * (1.0 - clears[number]) > 0.0:
            found.append((number, inner, left * (1.0 - clears[number])))
        left *= clears[number]
    return [*found, (-1, False, left)]


def test_rays_meet_spheres_in_order_until_one_is_opaque(prepared: PreparedScene) -> None:
    clears = [0.5, 0.8, 0.0]
    _, hits, left = peeled(prepared, LEVELS, clears)
    rows, seen = np.unique(hits.pixels, return_index=True)
    assert len(rows) > 100
    grazing = 0
    for pixel, first, last in zip(rows, seen, [*seen[1:], len(hits.pixels)], strict=True):
        *those, (_, _, rest) = expected(hits.points[first].astype(np.float64), LEVELS, clears)
        mine = [(*divmod(int(hits.sides[i]), 2), hits.weights[i]) for i in range(first, last)]
        if [each[:2] for each in mine] != [each[:2] for each in those]:
            grazing += 1  # a sphere of voxels is a little smaller
            continue
        np.testing.assert_allclose([each[2] for each in mine], [each[2] for each in those], rtol=1e-5)
        assert left.flat[pixel] == pytest.approx(rest, abs=1e-6)
    assert grazing < 0.1 * len(rows)


def test_weights_and_what_is_left_make_a_whole(prepared: PreparedScene) -> None:
    _, hits, left = peeled(prepared, LEVELS, [0.3, 0.6, 0.5])
    total = np.bincount(hits.pixels, hits.weights, SIZE * SIZE) + left.ravel()
    np.testing.assert_allclose(total, 1.0, atol=1.0 / 512.0)
    assert np.bincount(hits.pixels).max() <= MAX_PEELED_LAYERS


def through_sheets(clear: float) -> tuple[Hits, float]:
    """What a ray shows that meets seventy clear sheets before an opaque block, and what is left of it."""
    values = np.where(np.arange(80) < 71, np.arange(80) % 2 - 0.5, 4.0)
    sheets = make_volume(np.ones((9, 80, 9), np.float32) * values[:, None].astype(np.float32), (1.0, 1.0, 1.0))
    prepared = PreparedScene(scene_of(sheets, 1.5))
    view = View(1.5, Camera((4.0, -80.0, 4.0), (4.0, 40.0, 4.0), (0.0, 0.0, 1.0), 1.0), width=1, height=1)
    surfaces = [prepared.surface(each) for each in (view.isovalue, 0.0)]
    hits, left = Peeler.of(view, surfaces, np.array([0.0, clear]), Tiles()).whole(view, Tiles())
    return hits, left.item()


def test_a_ray_shows_all_layers_that_count() -> None:
    hits, left = through_sheets(0.5)
    assert (hits.sides // 2).tolist() == [1] * 10 and left == 0.0
    np.testing.assert_allclose(hits.weights, 0.5 ** np.arange(1, 11))


def test_the_last_layer_is_the_opaque_one_that_is_left() -> None:
    hits, left = through_sheets(0.99)
    assert (hits.sides // 2).tolist() == [1] * (MAX_PEELED_LAYERS - 1) + [0]
    np.testing.assert_allclose(hits.weights[:-1], 0.01 * 0.99 ** np.arange(MAX_PEELED_LAYERS - 1), rtol=1e-5)
    assert hits.weights[-1] == pytest.approx(0.99 ** (MAX_PEELED_LAYERS - 1)) and left == 0.0


def test_a_surface_at_the_shown_isovalue_is_that_one(prepared: PreparedScene) -> None:
    _, once, _ = peeled(prepared, (4.0,), [0.5])
    _, twice, _ = peeled(prepared, (4.0, 4.0), [0.5, 0.2])
    np.testing.assert_array_equal(once.points, twice.points)
    np.testing.assert_allclose(once.weights, twice.weights)


def test_a_side_is_a_tall_picture_of_its_layers(prepared: PreparedScene) -> None:
    view, hits, _ = peeled(prepared, LEVELS, [0.5, 0.8, 0.0])
    first = first_of(view, hits, prepared.surface(4.0))
    assert len(np.unique(first.pixels)) == len(first.pixels)
    layers, some = side_layers(hits, Side(1), first, prepared.surface(0.0)), hits.rows_of(Side(1))
    assert layers.layers == 1
    ((rows, pixels),) = layers.each
    np.testing.assert_array_equal(pixels, hits.pixels[some])
    assert rows == slice(0, len(some))
    np.testing.assert_array_equal(layers.gbuffer.points, hits.points[some])
    away = np.linalg.norm(layers.gbuffer.points - MIDDLE, axis=1)
    np.testing.assert_allclose(away, 12.0, atol=0.1)
