"""Adaptive scenes: every second texel first, all of them where light asks for it, and what is told meanwhile."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.frame import shader
from isogi_core.frame.frame import Frame
from isogi_core.frame.wide import WideCells
from isogi_core.kernels.planes import CONVERGING, FINAL
from isogi_core.model.scene import load_scene
from isogi_core.model.view import View, quaternion_from_angles
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, refine_chunk, relative_rmse

MakeBench = Callable[..., Workbench]
LIGHTS = pytest.mark.parametrize("light", [CONSTANT, SKY], ids=["light itself", "shares"])


@pytest.fixture
def made(tmp_path: Path) -> MakeBench:
    """Make the bench of the orbital as an adaptive scene."""

    def make(light: dict[str, Any] = CONSTANT, **settings: Any) -> Workbench:
        given = {"lights": [light], "bounces": 1, "target_error": LOOSE, "adaptive": True, **settings}
        return Workbench(load_scene("demo:orbital", **given), tmp_path)

    return make


@pytest.fixture
def coarseness(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Take another error for each voxel of a wide cell's edge."""
    return lambda value: monkeypatch.setattr(shader, "COARSENESS", value)


def view_of(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=128, **settings)


def plain(bench: Workbench) -> Workbench:
    """The same scene on the same store, and not adaptive."""
    return Workbench(replace(bench.scene, adaptive=False), bench.folder)


def demanded(bench: Workbench, frame: Frame) -> np.ndarray:
    """The texels (m, 3; z, y, x) that a frame demands."""
    lattice = bench.recipe.lattice
    return np.concatenate([lattice.positions(each.index, each.offsets) for each in frame.demands])


def lit_texels(bench: Workbench, view: View) -> int:
    """How many of the texels that a view may read hold light."""
    store = bench.caches.of(view.shading).store
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    chunks = [(store.load(index), own) for index, own in zip(texels.chunks, texels.offsets, strict=True)]
    return sum(int((np.isin(chunk.offsets, own) & (chunk.light.samples != 0)).sum()) for chunk, own in chunks)


def test_other_scenes_know_nothing_of_it(made: MakeBench) -> None:
    bench = made()
    view, other = view_of(bench), plain(bench)
    assert other.renderer.texels(view, other.renderer.gbuffer(view)).wide is None
    assert other.scene.bake_digest == bench.scene.bake_digest, "light is the same"
    assert other.scene.digest != bench.scene.digest, "pictures are not"


@LIGHTS
def test_every_second_texel_is_wanted_first(made: MakeBench, light: dict[str, Any]) -> None:
    bench = made(light)
    frame = bench.renderer.render(view_of(bench))
    texels, last = demanded(bench, frame), np.array(bench.recipe.shape) - 1
    assert ((texels % 2 == 0) | (texels == last)).all()
    whole = len(demanded(bench, plain(bench).renderer.render(view_of(bench))))
    assert len(texels) < 0.6 * whole
    assert frame.coverage["provisional"] == 1.0 and frame.chunks_final == 0


@LIGHTS
def test_where_light_is_smooth_nothing_more_is(
    made: MakeBench, coarseness: Callable[[float], None], light: dict[str, Any]
) -> None:
    coarseness(0.0)
    bench = made(light)
    first = demanded(bench, bench.renderer.render(view_of(bench)))
    frame = bench.bake(view_of(bench))
    assert not frame.provisional and frame.chunks_final == frame.chunks_needed > 0
    assert lit_texels(bench, view_of(bench)) <= len(first)
    assert plain(bench).renderer.render(view_of(bench)).provisional


@LIGHTS
def test_where_it_is_not_all_texels_are_and_the_picture_is_that_of_the_whole_lattice(
    made: MakeBench, monkeypatch: pytest.MonkeyPatch, light: dict[str, Any]
) -> None:
    spread = WideCells.spread
    monkeypatch.setattr(WideCells, "spread", lambda *of: np.full_like(spread(*of), np.inf))
    bench = made(light)
    frame = bench.bake(view_of(bench))
    best = plain(bench).renderer.render(view_of(bench))
    assert not frame.provisional and not best.provisional
    np.testing.assert_array_equal(frame.radiance, best.radiance)


def first_round(bench: Workbench, view: View) -> Frame:
    """Bake every second texel of a view, and none of the others."""
    rung, frame = FIRST_RUNG, bench.renderer.render(view)
    first = frame.demands
    while rung <= bench.scene.plan.samples and {each.index for each in frame.demands} & {each.index for each in first}:
        for each in first:
            refine_chunk(bench.caches.of(view.shading), rung, LOOSE, each)
        rung, frame = 2 * rung, bench.renderer.render(view)
        if not len(demanded(bench, frame)) or (demanded(bench, frame) % 2 == 1).any():
            break
    return frame


@LIGHTS
def test_pixels_wait_for_the_rest_where_light_is_uneven(
    made: MakeBench, coarseness: Callable[[float], None], light: dict[str, Any]
) -> None:
    coarseness(0.5)
    bench = made(light)
    view = view_of(bench)
    frame = first_round(bench, view)
    assert frame.coverage["final"] > 0.1 and frame.coverage["converging"] > 0.1 and frame.coverage["provisional"] == 0.0
    assert 0 < frame.chunks_final < frame.chunks_needed or frame.chunks_final == 0
    rest = demanded(bench, frame)
    assert (rest % 2 == 1).any()
    before, done = lit_texels(bench, view), bench.bake(view)
    assert not done.provisional
    kept = frame.state == FINAL
    assert (done.state[frame.state == CONVERGING] == FINAL).all()
    assert np.abs(done.radiance - frame.radiance)[kept].max() <= np.abs(done.radiance - frame.radiance).max()
    assert before < lit_texels(bench, view) < lit_texels(bench, view) + len(rest)


@LIGHTS
def test_the_picture_is_near_that_of_the_whole_lattice(made: MakeBench, light: dict[str, Any]) -> None:
    bench = made(light, target_error=0.05)
    frame = bench.bake(view_of(bench))
    lit = lit_texels(bench, view_of(bench))
    other = plain(bench)
    best = other.bake(view_of(bench))
    assert lit < lit_texels(other, view_of(bench))
    assert 0.0 < relative_rmse(frame, best) < 0.05


def test_light_that_other_views_left_is_read(made: MakeBench, coarseness: Callable[[float], None]) -> None:
    """Of a scene that was baked whole nothing is wanted, and its picture is the same."""
    coarseness(0.5)
    bench = made()
    best = plain(bench).bake(view_of(bench))
    frame = bench.renderer.render(view_of(bench))
    assert not frame.provisional and frame.demands == ()
    np.testing.assert_array_equal(frame.radiance, best.radiance)


def test_a_smaller_target_asks_for_more(made: MakeBench) -> None:
    bench = made()
    assert not bench.bake(view_of(bench)).provisional
    loose = lit_texels(bench, view_of(bench))
    assert not bench.bake(view_of(bench), target=LOOSE / 4).provisional
    assert lit_texels(bench, view_of(bench)) > loose


def test_light_that_is_turned_may_ask_for_more(made: MakeBench, coarseness: Callable[[float], None]) -> None:
    coarseness(0.3)
    bench = made(SKY)
    view = view_of(bench)
    assert not bench.bake(view).provisional
    turned = replace(view, light=quaternion_from_angles(150.0, 30.0, 0.0))
    frame = bench.renderer.render(turned)
    assert frame.coverage["provisional"] == 0.0 and (frame.coverage["final"] < 1.0) == bool(frame.demands)
    assert not bench.bake(turned).provisional and not bench.renderer.render(view).provisional


def test_views_that_sharpen_want_sharp_light_of_what_they_read_alone(made: MakeBench) -> None:
    bench = made(sharpen=True)
    view = view_of(bench)
    frame = bench.bake(view)
    for _ in range(20):
        if not frame.sharpness or not frame.sharpness.demands:
            break
        reading = frame.sharpness.reading
        assert reading.asked is not None and not (reading.wanted & ~reading.asked).any()
        for each in frame.sharpness.demands:
            refine_chunk(bench.caches.sharp(frame.gbuffer.isovalue), 256, LOOSE, each)
        frame = bench.bake(view)
    assert not frame.provisional and frame.sharpness is not None
    shares = frame.sharpness.shares
    assert sum(shares.values()) == pytest.approx(1.0) and shares["moved"] > 0.0


def test_vicinity_shading_is_adaptive_too(made: MakeBench) -> None:
    bench = made()
    view = view_of(bench, shading="vicinity")
    first = demanded(bench, bench.renderer.render(view))
    assert ((first % 2 == 0) | (first == np.array(bench.recipe.shape) - 1)).all()
    assert not bench.bake(view).provisional


def split_share(bench: Workbench, view: View) -> float:
    """The share of pixels that ask for more."""
    return bench.renderer.render(view).coverage["converging"]


def test_cells_are_judged_at_the_albedo_that_a_view_asks_for(
    made: MakeBench, coarseness: Callable[[float], None]
) -> None:
    """With direct light alone it scales all light, and nothing relative to it."""
    coarseness(0.5)
    bench = made(SKY, bounces=0)
    view = view_of(bench)
    first_round(bench, view)
    shares = [split_share(bench, replace(view, albedo=(albedo,) * 3)) for albedo in (0.9, 0.7, 0.35, 0.1)]
    assert 0.0 < shares[0] < 1.0 and shares == pytest.approx([shares[0]] * 4, abs=0.01)


def test_versions_tell_targets_apart_where_these_say_what_is_read(made: MakeBench) -> None:
    bench = made()
    view = view_of(bench)
    bench.bake(view)
    loose, strict = (bench.renderer.render(view, target).version for target in (LOOSE, LOOSE / 4))
    assert loose != strict and loose == bench.again().renderer.render(view, LOOSE).version
    other = plain(bench).renderer
    assert other.render(view, LOOSE).version == other.render(view, LOOSE / 4).version


def test_cells_do_not_wait_for_sharp_light_to_be_judged(made: MakeBench, coarseness: Callable[[float], None]) -> None:
    coarseness(0.5)
    bench = made(SKY, sharpen=True)
    frame = bench.bake(view_of(bench))
    assert frame.sharpness is not None and frame.sharpness.demands and frame.sharpness.shares["moved"] == 0.0
    even = made(SKY)
    assert lit_texels(bench, view_of(bench)) == lit_texels(even, view_of(even)) > 0
    assert not even.renderer.render(view_of(even)).provisional, "of light on texels' own isosurfaces all is there"
