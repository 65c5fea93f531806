"""Shine in frames: what paths say of it, live, without a byte of light kept, and at no cost where
nothing shines.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import ViewError
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.pixel_rays import Paths
from isogi_core.frame.rays.shine import cast_rays, paths_from
from isogi_core.frame.rays.shine_light import ShineLight
from isogi_core.model.material import DULL, Shine
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, relative_rmse
from tests.loaded import load_scene

SIZE = 24
POLISHED = {"kind": "plastic", "roughness": 0.3}


@pytest.fixture(scope="module")
def polished(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital in plastic under a sky with a sun, baked to a tenth in its view."""
    scene = load_scene(
        "demo:orbital", lights=[SKY], albedo=0.5, bounces=2, target_error=LOOSE, shine=POLISHED
    )
    bench = Workbench(scene, tmp_path_factory.mktemp("polished"))
    bench.bake(bench.view(size=SIZE))
    return bench


def bench_steps(bench: Workbench, view: View) -> Iterator[Frame]:
    """The frame after each step of refinement."""
    while bench.renderer.refine(view):
        yield bench.renderer.render(view)


def traced(bench: Workbench, view: View, samples: int = 512) -> Frame:
    """The same by paths."""
    return bench.renderer.render(replace(view, shading="path_traced", samples=samples))


@pytest.mark.parametrize(
    ("kind", "roughness"), [("plastic", 0.1), ("plastic", 0.6), ("metal", 0.1), ("metal", 0.3)]
)
def test_frames_at_rest_are_what_paths_say(
    polished: Workbench, kind: str, roughness: float
) -> None:
    view = polished.view(size=SIZE, shine=Shine(kind, roughness))
    frame = polished.settled(view)
    truth = traced(polished, view)
    assert frame.final
    assert frame.measured is not None
    assert frame.measured.high <= LOOSE
    assert relative_rmse(frame, truth) < LOOSE + truth.noise
    lit = frame.state > 0
    assert frame.radiance[lit].mean() == pytest.approx(truth.radiance[lit].mean(), rel=0.03)


@pytest.mark.slow
def test_frames_that_others_have_overtaken_cast_no_rays(polished: Workbench) -> None:
    """Two threads draw the same picture, and one waits while the other casts: numbers are those of
    one alone.
    """
    renderer = polished.renderer
    view = polished.view(size=SIZE, shine=Shine("metal", 0.2))
    alone = polished.settled(view)
    renderer.forget_views()
    while (frame := renderer.render(view)).refinable:
        for _ in range(2):
            goal = Goal(renderer.prepared.scene.target_error)
            renderer.surface.refine_frame(frame, goal, renderer.tiles, Prices().of_present)
    assert (frame.version, frame.total) == (alone.version, alone.total)


def test_first_frames_tell_their_noise(polished: Workbench) -> None:
    """By pixels side by side, at rest and on the move; it falls as more rays are cast."""
    view = polished.view(size=SIZE, shine=Shine("metal", 0.6))
    truth = polished.settled(view)
    polished.renderer.forget_views()
    for first in (
        polished.renderer.render(view),
        polished.renderer.render(replace(view, moving=True)),
    ):
        true = relative_rmse(first, truth)
        assert 0.4 * true < first.noise < 2.5 * true
    polished.renderer.forget_views()
    noise = [frame.noise for frame in bench_steps(polished, view)]
    assert noise[-1] < 0.7 * noise[0]


def test_rays_at_rest_begin_no_noisier_than_the_first(polished: Workbench) -> None:
    """The first rays are filtered. Those that replace them, two of a pixel, are filtered until they
    are so many that the filter would blur more than they are noisy; pictures tell what it blurs.
    """
    view = polished.view(size=48, shine=Shine("metal", 0.6))
    polished.bake(view)
    truth = polished.settled(view)
    polished.renderer.forget_views()
    frames = [polished.renderer.render(view), *bench_steps(polished, view)]
    true = [relative_rmse(frame, truth) for frame in frames[:-1]]
    told = [frame.noise for frame in frames[:-1]]
    assert len(true) > 4 and max(b / a for a, b in pairwise(true)) < 1.05
    assert all(0.6 < a / b < 1.6 for a, b in zip(told[1:5], true[1:5], strict=True))


def test_white_plastic_under_white_light_is_white(workbench: Callable[[Scene], Workbench]) -> None:
    """A ball, on which nothing but the sky is seen: what the coat mirrors is what it takes."""
    scene = load_scene(
        "demo:orbital",
        lights=[CONSTANT],
        albedo=1.0,
        bounces=0,
        target_error=LOOSE,
        shine=POLISHED,
        isovalue=0.03,
    )
    bench = workbench(scene)
    view = bench.view(size=SIZE)
    bench.bake(view)
    frame = bench.settled(view)
    dull = bench.renderer.render(replace(view, shine=DULL))
    lit = frame.state > 0
    open_to_sky = lit & (dull.radiance[..., 0] > 0.995)
    assert open_to_sky.sum() > 10
    assert frame.radiance[open_to_sky].mean() == pytest.approx(1.0, abs=0.02)


def test_shine_bakes_nothing_and_asks_for_nothing(polished: Workbench) -> None:
    """The same chunks, and the same layers, as those of the diffuse surface."""
    dull = load_scene("demo:orbital", lights=[SKY], albedo=0.5, bounces=2, target_error=LOOSE)
    assert dull.bake_digest == polished.scene.bake_digest
    assert dull.digest != polished.scene.digest
    frame = polished.renderer.render(polished.view(size=SIZE))
    assert not frame.demands


def test_no_shine_is_the_diffuse_picture_to_the_bit(polished: Workbench) -> None:
    dull = Workbench(
        load_scene("demo:orbital", lights=[SKY], albedo=0.5, bounces=2, target_error=LOOSE),
        polished.folder,
    )
    for shading in ("gi", "path_traced", "lambert", "vicinity"):
        view = dull.view(size=SIZE, shading=shading)
        without = dull.renderer.render(view)
        assert (
            without.radiance.tobytes()
            == polished.renderer.render(replace(view, shine=DULL)).radiance.tobytes()
        )
        if shading in ("lambert", "vicinity"):
            assert without.radiance.tobytes() == polished.renderer.render(view).radiance.tobytes()


def test_a_picture_names_the_rays_that_it_shows(
    polished: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not those that another thread casts while it is drawn."""
    view = polished.view(size=SIZE, shine=Shine("metal", 0.25))
    drawn = []
    put = ShineLight.put

    def overtaken(shine: ShineLight, *given: Any) -> None:
        put(shine, *given)
        rows = np.arange(len(shine.gbuffer.points))
        shine.sums = shine.sums.joined(rows, np.ones((len(rows), 2, 3)), 8)
        drawn.append(shine)

    with monkeypatch.context() as patch:
        patch.setattr(ShineLight, "put", overtaken)
        frame = polished.renderer.render(view)
    (shine,) = drawn
    assert shine.count == 8 and not shine.is_shown(frame)
    assert shine.is_shown(polished.renderer.render(view))
    polished.renderer.forget_views()


def test_shine_is_left_out_where_nothing_shines(polished: Workbench) -> None:
    scenes = (load_scene("demo:orbital", lights=[SKY]), polished.scene)
    assert [[each.what for each in scene.left_out].count("shine") for scene in scenes] == [1, 0]


def test_a_diffuse_scene_refuses_views_that_shine(evenly_lit: Workbench) -> None:
    with pytest.raises(
        ViewError, match=r"^This scene's surface is diffuse: give the scene a \[shine\] table"
    ):
        evenly_lit.renderer.render(evenly_lit.view(size=8, shine=Shine()))


def test_shine_names_its_pictures(polished: Workbench) -> None:
    view = polished.view(size=SIZE)
    versions = {
        polished.renderer.render(each).version
        for each in (
            view,
            replace(view, shine=Shine("metal")),
            replace(view, shine=Shine("metal", 0.5)),
        )
    }
    assert len(versions) == 3


def test_metal_mirrors_in_its_own_colour(workbench: Callable[[Scene], Workbench]) -> None:
    """Pure metal scatters nothing: of copper under white light each channel is F₀ A + B at least
    where that is open.
    """
    copper = [0.9, 0.5, 0.3]
    bench = workbench(
        load_scene(
            "demo:orbital",
            lights=[CONSTANT],
            albedo=copper,
            target_error=LOOSE,
            shine={"kind": "metal"},
        )
    )
    view = bench.view(size=SIZE)
    bench.bake(view)
    frame = bench.settled(view)
    red, green, blue = frame.radiance[frame.state > 0].mean(axis=0)
    assert red > green > blue
    assert green / red == pytest.approx(5 / 9, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("room", ["cornell", None])
def test_rays_see_walls_and_lamps(tmp_path: Path, room: str | None) -> None:
    """In a Cornell room, and under an area light that only shine sees; against paths."""
    lamp = {
        "type": "area",
        "corner": [-9, -9, 40],
        "u": [0, 60, 0],
        "v": [60, 0, 0],
        "radiance": 3.0,
    }
    if room:
        given = {"room": room}
    else:
        given = {"lights": [lamp]}
    shine = {"kind": "metal", "roughness": 0.2, "strength": 0.5}
    scene = load_scene(
        "demo:orbital", bounces=2, target_error=LOOSE, projected=False, shine=shine, **given
    )
    bench = Workbench(scene, tmp_path)
    view = bench.view(90.0, 20.0, SIZE, distance=4.0)
    bench.bake(view)
    frame = bench.settled(view)
    truth = traced(bench, view, 256)
    seen = frame.gbuffer.pixels
    one, other = (each.radiance.reshape(-1, 3)[seen].mean(axis=0) for each in (frame, truth))
    np.testing.assert_allclose(one, other, rtol=0.05)
    assert frame.final


def test_paths_at_the_ends_of_rays_are_those_of_the_surface(polished: Workbench) -> None:
    """What rays see by one path each is on the average what many paths show there, of the surface
    without shine.
    """
    renderer = polished.renderer
    view = polished.view(size=SIZE)
    gbuffer = renderer.gbuffer(view)
    light = RotatedLight(polished.caches.spec("gi"), view)
    rays = cast_rays(light, gbuffer, range(4), range(16), renderer.tiles)
    assert 0 < len(rays.seen) < rays.each * len(gbuffer.points)
    paths = paths_from(rays, np.arange(len(rays.seen)), light, 2, renderer.tiles)
    again = cast_rays(light, gbuffer, range(4), range(16), renderer.tiles)
    np.testing.assert_array_equal(
        paths, paths_from(again, np.arange(len(rays.seen)), light, 2, renderer.tiles)
    )
    many = np.zeros((len(rays.seen), 1, 3))
    dull = RotatedLight(light.spec, rays.view(view))
    Paths(dull, rays.hits, renderer.tiles, 2).add(many, 0, 0, 64)
    np.testing.assert_allclose(paths.mean(axis=0), many.mean(axis=(0, 1)) / 64, rtol=0.15)
