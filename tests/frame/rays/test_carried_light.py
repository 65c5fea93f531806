"""Light of pixels that earlier views have traced, carried over to another view of the surface."""

import math
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame import view_checks
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.carried_light import (
    Neighbours,
    TracedLight,
    TracedPoints,
    carried_key,
    project,
)
from isogi_core.frame.rays.own_light import PixelLight
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles
from tests.frame.conftest import SKY, Workbench, luminance, true_error
from tests.loaded import load_scene

TARGET = 0.02
SIZE = 128


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """A surface whose texels are too far apart for the target, so that pixels need light."""
    scene = load_scene("demo:orbital", lights=[SKY], bounces=2, lattice=0.25, target_error=TARGET)
    return Workbench(scene, tmp_path_factory.mktemp("carried"))


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light is carried to pictures that are too small for it to be worth it."""
    monkeypatch.setattr(view_checks, "WORTH_CARRYING", 0)


def apart(bench: Workbench) -> Workbench:
    """The same scene and store by a renderer that has drawn nothing."""
    other = bench.again()
    other.renderer = Renderer(other.caches, bench.renderer.tiles)
    return other


def finished(bench: Workbench, view: View) -> Frame:
    """The picture of a view, when its check has ended."""
    frame = bench.bake(view)
    while bench.renderer.refine(view):
        frame = bench.bake(view)
    return frame


def traced(frame: Frame) -> set[int]:
    """Pixels of a picture whose light was traced for themselves, and not carried over."""
    known = frame.quality.known
    assert known is not None
    return set(known.own.places.tolist()) - set(known.carried.tolist())


def carried(frame: Frame) -> int:
    """Number of points that took light over."""
    assert frame.quality.known is not None
    return len(frame.quality.known.carried)


@pytest.mark.usefixtures("always")
def test_a_view_beside_another_takes_its_light(bench: Workbench) -> None:
    """It reaches the target with fewer paths than alone, and its error is as told."""
    first = finished(bench, bench.view(azimuth=30.0, size=SIZE))
    assert traced(first) and not carried(first)
    view = bench.view(azimuth=33.0, size=SIZE)
    alone = finished(apart(bench), view)
    after = finished(bench, view)
    assert carried(after) > 0.2 * len(traced(alone))
    assert len(traced(after)) < len(traced(alone))
    assert after.final and after.total.high <= TARGET
    assert true_error(bench, after) < 1.2 * TARGET
    assert after.version != alone.version


def test_a_small_picture_takes_none(bench: Workbench) -> None:
    """Measuring it with that light takes more paths than the light spares."""
    first = finished(bench, bench.view(azimuth=50.0, size=SIZE))
    assert traced(first)
    view = bench.view(azimuth=50.01, size=SIZE)
    after = finished(bench, view)
    assert not carried(after)
    assert after.version == finished(apart(bench), view).version


@pytest.mark.usefixtures("always")
def test_light_that_is_dropped_leaves_the_rest(bench: Workbench) -> None:
    """Pixels keep the light that was traced for themselves, as if no other had been there."""
    finished(bench, bench.view(azimuth=30.0, size=SIZE))
    frame = finished(bench, bench.view(azimuth=33.0, size=SIZE))
    known = frame.quality.known
    assert known is not None and len(known.carried)
    spec = bench.caches.spec("gi")
    light = RotatedLight(spec, frame.view)
    left = known.own.without(known.carried, light, frame.gbuffer, bench.renderer.tiles)
    assert set(left.places.tolist()) == traced(frame)
    assert 0 < left.paths < known.own.paths
    rows = np.searchsorted(known.own.places, left.places)
    assert np.array_equal(left.estimate.sums, known.own.estimate.sums[rows])
    assert np.isfinite(left.light).all() and len(left.light) == len(left.places)
    none = known.own.without(known.own.places, light, frame.gbuffer, bench.renderer.tiles)
    assert not len(none.places)


@pytest.mark.usefixtures("always")
def test_nearly_the_same_camera_shows_the_same_light(bench: Workbench) -> None:
    view = bench.view(azimuth=30.0, size=SIZE)
    first = finished(bench, view)
    nearly = finished(bench, bench.view(azimuth=30.0001, size=SIZE))
    assert carried(nearly) > 0.25 * len(traced(first)), "all but those at rims"
    difference = luminance(nearly) - luminance(first)
    assert math.sqrt((difference**2).mean()) < TARGET * luminance(first).mean()


@pytest.mark.usefixtures("always")
def test_other_light_is_not_taken(bench: Workbench) -> None:
    finished(bench, bench.view(azimuth=30.0, size=SIZE))
    turned = replace(
        bench.view(azimuth=30.0, size=SIZE), light=quaternion_from_angles(90.0, 0.0, 0.0)
    )
    assert not carried(finished(bench, turned))


def test_light_of_a_part_is_not_carried(bench: Workbench) -> None:
    view = bench.view(size=SIZE)
    spec = bench.caches.spec("gi")
    for other in (replace(view, strip=(0, 2 * SIZE)), replace(view, columns=(0, 2 * SIZE))):
        assert carried_key(RotatedLight(spec, other)) is None
    assert carried_key(RotatedLight(spec, view)) is not None


def test_points_project_to_their_pixels(bench: Workbench) -> None:
    view = bench.view(azimuth=200.0, size=SIZE)
    gbuffer = bench.renderer.gbuffer(view)
    columns, lines, depths = project(view, gbuffer.points * np.array(gbuffer.spacing))
    rows = lines.astype(int) * SIZE + columns.astype(int)
    assert np.array_equal(rows, gbuffer.pixels) and (depths > 0).all()
    np.testing.assert_allclose(columns % 1.0, 0.5, atol=1e-3)


def around_all(luminance: np.ndarray) -> Neighbours:
    """The neighbours of all pixels of a grey picture; those that are NaN have no light."""
    numbers = np.full(luminance.shape, -1, np.int32)
    known = np.isfinite(luminance)
    numbers[known] = np.arange(known.sum())
    light = np.repeat(luminance[known][:, None], 3, axis=1)
    return Neighbours(numbers, light, np.arange(luminance.size))


def test_slopes_of_a_plane_are_exact() -> None:
    """It does not bend; at the border both are unknown."""
    lines, columns = np.mgrid[:5, :6].astype(float)
    around = around_all(2.0 + 0.5 * columns - 0.25 * lines)
    slopes = around.slopes.reshape(5, 6, 2, 3)
    np.testing.assert_allclose(slopes[1:-1, 1:-1, 0], 0.5)
    np.testing.assert_allclose(slopes[1:-1, 1:-1, 1], -0.25)
    bends = around.bends.reshape(5, 6)
    np.testing.assert_allclose(bends[1:-1, 1:-1], 0.0, atol=1e-15)
    bends[1:-1, 1:-1] = np.inf
    assert np.isinf(bends).all()


def test_bends_are_second_differences_relative_to_light() -> None:
    lines, columns = np.mgrid[:5, :5].astype(float)
    assert around_all(4.0 + columns**2).bends[12] == 2.0 / 8.0
    # Along a diagonal both coordinates change, over √2 of the length.
    assert around_all(4.0 + columns * lines).bends[12] == 1.0 / 8.0
    hole = 4.0 + columns
    hole[1, 1] = np.nan
    bends = around_all(hole).bends.reshape(5, 5)
    assert np.isinf(bends[:3, :3]).all() and bends[3, 3] == 0.0


def test_light_changes_along_its_slope_on_the_way(bench: Workbench) -> None:
    """Light that is a plane in the earlier picture is that of the plane at the other point."""
    surface = bench.renderer.surface
    view = bench.view(azimuth=70.0, size=SIZE)
    first = surface.shot(view, bench.renderer.gbuffer(view), Goal(TARGET), bench.renderer.tiles)
    pixels = first.gbuffer.pixels.astype(np.int64)
    lines, columns = np.divmod(pixels, SIZE)
    plane = 2.0 + 0.01 * columns - 0.02 * lines
    grey = np.repeat(plane[:, None], 3, axis=1)
    estimate = Estimate(np.repeat(4.0 * grey[:, None], 2, axis=1), np.full(len(plane), 4))
    own = PixelLight(
        np.arange(len(plane)), estimate, grey, np.ones(len(plane)), grey[:, :1], np.ones(len(plane))
    )
    points = TracedPoints.of(first, own, np.empty(0, np.int64))
    # Another camera sees other points, between those of the first one.
    other_view = bench.view(azimuth=70.3, size=SIZE)
    other = surface.shot(
        other_view, bench.renderer.gbuffer(other_view), Goal(TARGET), bench.renderer.tiles
    )
    box = other.gbuffer.points * np.array(other.gbuffer.spacing)
    sides = project(other_view, box)[2] * other_view.camera.pixel_size(SIZE)
    pairs = points.pairs(other, box, sides)
    where, line, _ = project(view, box[pairs.places])
    there = 2.0 + 0.01 * (where - 0.5) - 0.02 * (line - 0.5)
    assert len(pairs.places) > 1000 and np.abs(pairs.changes).max() > 1e-3
    np.testing.assert_allclose(pairs.changes[:, 0] + plane[pairs.numbers], there, atol=1e-5)
    # The paths that are taken over have that light, in each replica.
    carried = TracedLight((points,)).carried_to(other, np.ones(len(box)))
    assert np.array_equal(carried.places, pairs.places)
    means = np.repeat(np.repeat(there[:, None, None], 2, axis=1), 3, axis=2)
    np.testing.assert_allclose(carried.estimate.means, means, atol=1e-5)


def test_of_one_view_the_most_points_are_kept(bench: Workbench) -> None:
    """Points that took light over are not kept anew, and must not drive out those they took."""
    frame = finished(bench, bench.view(azimuth=110.0, size=SIZE))
    shot = bench.renderer.surface.shot(
        frame.view, frame.gbuffer, Goal(TARGET), bench.renderer.tiles
    )
    assert frame.quality.known is not None
    own = frame.quality.known.own
    whole = TracedPoints.of(shot, own, np.empty(0, np.int64))
    half = TracedPoints.of(shot, own, own.places[::2])
    assert TracedLight((whole,)).joined(half).views == (whole,)
    assert TracedLight((half,)).joined(whole).views == (whole,)
    other = replace(half, view=bench.view(azimuth=111.0, size=SIZE))
    assert TracedLight((whole,)).joined(other).views == (other, whole)


@pytest.mark.usefixtures("always")
def test_points_at_rims_are_not_taken_even_at_no_distance(bench: Workbench) -> None:
    """Light at a rim may change by any amount, and the same view again shows the same points."""
    view = bench.view(azimuth=70.0, size=SIZE)
    first = finished(bench, view)
    assert first.quality.known is not None
    shot = bench.renderer.surface.shot(view, first.gbuffer, Goal(TARGET), bench.renderer.tiles)
    known = first.quality.known
    points = TracedPoints.of(shot, known.own, known.carried)
    assert np.isinf(points.bends).any() and np.isfinite(points.bends).any()
    box = first.gbuffer.points * np.array(first.gbuffer.spacing)
    sides = project(view, box)[2] * view.camera.pixel_size(view.height)
    pairs = points.pairs(shot, box, sides)
    assert len(pairs.numbers) and not pairs.away.any()
    assert np.isfinite(points.bends[pairs.numbers]).all()
