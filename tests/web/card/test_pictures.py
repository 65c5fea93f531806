"""Pictures that a page's card draws beside isogi's, before pixels get light of their own."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.obstacles import SHADINGS
from isogi_core.model.view import View, light_in_box, orthographic, read_window
from isogi_core.model.volume import Orientation, make_volume
from isogi_core.plan.variants import remade
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, scene_of
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import (
    IDENTITY,
    TURN,
    CardScene,
    Difference,
    Lab,
    Shown,
    developed,
    difference,
    light_of,
    orthographic_camera,
    plain_light,
)

pytestmark = pytest.mark.usefixtures("unfiltered")

SIZE = (72, 56)
WITHIN = 0.999
RMSE = 0.002


def view_at(bench: Workbench, **settings: Any) -> View:
    """A view of the bench's scene in a picture that is wider than it is high."""
    return replace(bench.view(**settings), width=SIZE[0], height=SIZE[1])


def assert_same(found: Difference) -> None:
    """A card's picture is isogi's, but for rounding."""
    assert found.surface > 500
    assert found.within >= WITHIN and found.rmse <= RMSE, found


def lit_bench(make_bench: Make, demo: str = "orbital", **settings: Any) -> Workbench:
    """A scene whose ``view_at`` is baked."""
    bench = make_bench(
        load_scene(
            f"demo:{demo}", **{"bounces": 2, "target_error": LOOSE, "projected": False, **settings}
        )
    )
    bench.bake(view_at(bench))
    return bench


LAMP = {"type": "directional", "azimuth": -30, "elevation": 40, "irradiance": 2.0}
LOCAL = [shading for shading in SHADINGS if shading != "gi"]


@pytest.mark.parametrize("demo", ["orbital", "casting"])
@pytest.mark.parametrize("shading", LOCAL)
def test_local_models_are_isogis(lab: Lab, make_bench: Make, demo: str, shading: str) -> None:
    bench = make_bench(load_scene(f"demo:{demo}", lights=[SKY], target_error=LOOSE))
    view = view_at(bench, shading=shading)
    frame = bench.renderer.render(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    assert_same(difference(card.picture(view), frame.radiance, frame.state > 0))


KEYS = {"light": [SKY], "camera": [CONSTANT], "nothing": [LAMP, CONSTANT]}


@pytest.mark.parametrize("follows", KEYS)
def test_the_key_light_follows_what_isogis_does(lab: Lab, make_bench: Make, follows: str) -> None:
    """One document serves all turns of light and camera."""
    bench = make_bench(load_scene("demo:orbital", lights=KEYS[follows], target_error=LOOSE))
    view = view_at(bench, shading="phong_shadow")
    card = CardScene(lab, bench.renderer, view, SIZE)
    assert lab.ask("return card.drawing.document.model.follows;") == follows
    others = [view_at(bench, shading="phong_shadow", azimuth=130.0)]
    others += [replace(view, light=TURN)] if follows == "light" else []
    for other in others:
        frame = bench.renderer.render(other)
        assert_same(difference(card.picture(other), frame.radiance, frame.state > 0))


def test_fog_of_parallel_rays_is_isogis(lab: Lab, make_bench: Make) -> None:
    """Their eye is ten million radii away."""
    bench = make_bench(load_scene("demo:orbital", lights=[SKY], target_error=LOOSE))
    view = view_at(bench, shading="lambert_fog")
    flat = replace(view, camera=orthographic(view.camera, bench.scene.volume.radius))
    frame = bench.renderer.render(flat)
    card = CardScene(lab, bench.renderer, view, SIZE)
    found = card.picture(view, camera=orthographic_camera(view.camera))
    assert_same(difference(found, frame.radiance, frame.state > 0))


KINDS = {
    "uint16": (np.uint16, 1000.0, (1.0, 1.0, 1.0)),
    "float32": (np.float32, 1e-3, (0.5, 1.0, 2.0)),
    "uint8": (np.uint8, 40.0, (1.0, 0.7, 1.0)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_voxels_of_any_kind_and_spacing_are_drawn(lab: Lab, make_bench: Make, kind: str) -> None:
    dtype, scale, spacing = KINDS[kind]
    z, y, x = np.mgrid[:24, :30, :36]
    field = 3.0 + np.sin(0.4 * x) + np.cos(0.5 * y) * np.sin(0.6 * z) + 0.05 * x
    scene = scene_of(
        make_volume((scale * field).astype(dtype), spacing), 3.9 * scale, target_error=LOOSE
    )
    bench = make_bench(scene)
    view = view_at(bench, shading="lambert", azimuth=200.0)
    frame = bench.renderer.render(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    assert bench.prepared.voxel_codes.kind == kind
    assert_same(difference(card.picture(view), frame.radiance, frame.state > 0))


@pytest.mark.parametrize("solid", ["above", "below"])
def test_holes_in_the_values_are_no_surface(lab: Lab, make_bench: Make, solid: str) -> None:
    z, y, x = np.mgrid[:20, :24, :28]
    field = (8.0 - np.sqrt((x - 13.5) ** 2 + (y - 11.5) ** 2 + (z - 9.5) ** 2)).astype(np.float32)
    field[6:11, 4:9, 12:20] = np.nan
    sign = 1.0 if solid == "above" else -1.0
    scene = scene_of(
        make_volume(sign * field, (1.0, 1.0, 1.0), solid=solid), 0.0, target_error=LOOSE
    )
    bench = make_bench(scene)
    view = view_at(bench, shading="lambert", azimuth=-60.0)
    frame = bench.renderer.render(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    assert bench.prepared.voxel_codes.hole is not None
    found = difference(card.picture(view), frame.radiance, frame.state > 0)
    assert found.surface > 500 and found.within > 0.99, found


SCENES: dict[str, dict[str, Any]] = {
    "constant": {"lights": [CONSTANT]},
    "colours": {"lights": [SKY], "albedo": [0.8, 0.6, 0.4]},
    "irradiance": {"lights": [SKY], "rotating": False},
    "fine": {"lights": [SKY], "lattice": 1.5, "chunk": 8},
}


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.long] * (each == "fine")) for each in SCENES]
)
def test_light_of_texels_is_isogis(lab: Lab, make_bench: Make, name: str) -> None:
    bench = lit_bench(make_bench, **SCENES[name])
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    assert_same(difference(card.picture(view), *plain_light(bench.renderer, view, LOOSE)))


TILTED = Orientation(
    ((0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.8, 0.0, 0.6)), (100.0, -50.0, 7.0), "mm", "LPS"
)


@pytest.mark.parametrize("rotating", [True, False])
def test_light_of_a_tilted_volume_is_isogis(lab: Lab, make_bench: Make, rotating: bool) -> None:
    """Light that does not turn is kept in the volume's box, other light in the world."""
    straight = load_scene(
        "demo:orbital",
        lights=[SKY],
        rotating=rotating,
        bounces=2,
        target_error=LOOSE,
        projected=False,
    )
    volume = replace(straight.volume, orientation=TILTED)
    bench = make_bench(remade(straight, straight.source.document, volume))
    assert bench.scene.lighting.rotating == rotating
    view = view_at(bench)
    if rotating:
        view = replace(view, light=light_in_box(IDENTITY, TILTED))
    bench.bake(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE, turn=IDENTITY)
    camera = {
        "eye": TILTED.to_world(view.camera.eye).tolist(),
        "target": TILTED.to_world(view.camera.target).tolist(),
        "up": (TILTED.matrix @ view.camera.up).tolist(),
        "fov": view.camera.fov,
    }
    found = card.picture(view, camera=camera, light=IDENTITY)
    assert_same(difference(found, *plain_light(bench.renderer, view, LOOSE)))


@pytest.fixture(scope="module")
def under_sky(make_bench: Make) -> Workbench:
    """The orbital under a sky, baked."""
    return lit_bench(make_bench, **SCENES["colours"])


def test_a_turned_light_is_folded_on_the_card(lab: Lab, under_sky: Workbench) -> None:
    view = view_at(under_sky)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE, raw=True)
    turned = replace(view, light=TURN)
    light, on = plain_light(under_sky.renderer, turned, LOOSE)
    assert difference(card.picture(view), light, on).rmse > 0.05, "the light makes a difference"
    assert_same(difference(card.picture(turned), light, on))
    assert_same(difference(card.picture(view), *plain_light(under_sky.renderer, view, LOOSE)))


def test_without_transfer_a_turned_light_keeps_its_ratios(lab: Lab, under_sky: Workbench) -> None:
    view = view_at(under_sky)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE)
    turned = replace(view, light=TURN)
    light, on = plain_light(under_sky.renderer, turned, LOOSE)
    near = difference(card.picture(turned), light, on)
    far = difference(card.picture(view), light, on)
    assert near.rmse < 0.5 * far.rmse


def test_folded_light_of_several_turns_goes_together(lab: Lab, under_sky: Workbench) -> None:
    """What was folded by another light, of which there is transfer, is folded once more; the rest
    is as it came.
    """
    view = view_at(under_sky)
    turned = replace(view, light=TURN)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE, raw=True)
    card.light(replace(turned, width=8, height=8), LOOSE)
    light, on = plain_light(under_sky.renderer, turned, LOOSE)
    assert_same(difference(card.picture(turned), light, on))
    keys = lab.ask("return card.drawing.texels.runs.map((run) => run.lightKey);")
    assert len(set(keys)) == 2


def test_parallel_rays_are_isogis(lab: Lab, under_sky: Workbench) -> None:
    view = view_at(under_sky)
    flat = replace(view, camera=orthographic(view.camera, under_sky.scene.volume.radius))
    under_sky.bake(flat)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(flat, LOOSE)
    found = card.picture(view, camera=orthographic_camera(view.camera))
    assert_same(difference(found, *plain_light(under_sky.renderer, flat, LOOSE)))


WINDOWS = {"a side": "x>34", "a slope": "1,0.3,-0.5>14;z<6", "nothing left": "x>-5"}


@pytest.mark.parametrize("name", WINDOWS)
def test_windows_show_the_faces_that_they_open(lab: Lab, under_sky: Workbench, name: str) -> None:
    view = replace(view_at(under_sky), window=read_window(WINDOWS[name]))
    under_sky.bake(view)
    frame = under_sky.renderer.render(view)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE)
    faces = under_sky.renderer.gbuffer(view).faces
    (light, on) = plain_light(under_sky.renderer, view, LOOSE)
    light.reshape(-1, 3)[faces.pixels] = frame.radiance.reshape(-1, 3)[faces.pixels]
    on.reshape(-1)[faces.pixels] = True
    shown = card.picture(view)
    if name == "nothing left":
        assert not on.any() and not shown.covers.any()
        return
    found = difference(shown, light, on)
    assert len(faces.pixels) > 20 and found.surface > 100
    assert found.within > 0.995 and found.rmse <= 0.01, found


def test_texels_that_lack_show_the_mean_around(lab: Lab, under_sky: Workbench) -> None:
    """Of a view turned by 7 degrees, with the light of the view before alone."""
    view = view_at(under_sky)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE)
    other = view_at(under_sky, azimuth=47.0)
    under_sky.bake(other)
    found = difference(card.picture(other), *plain_light(under_sky.renderer, other, LOOSE))
    assert found.rmse < 0.04, found
    lab.ask("""const { texels } = card.drawing;
      for (let b = 0; b < texels.table.length; b += 4)
        if (texels.table[b + 3] > 0) texels.table[b + 2] = 0xffffffff;
      const { fillTexture } = await import("/web/card/textures.js");
      fillTexture(card.device.gl, texels.bricks, texels.table);""")
    bare = difference(card.picture(other), *plain_light(under_sky.renderer, other, LOOSE))
    assert bare.rmse > 1.3 * found.rmse, "unshadowed light in place of the means of bricks"


def test_light_that_grows_replaces_what_was_there(lab: Lab, make_bench: Make) -> None:
    bench = make_bench(
        load_scene("demo:orbital", lights=[SKY], bounces=2, target_error=0.05, projected=False)
    )
    view = view_at(bench)
    bench.bake(view, 0.6)
    card = CardScene(lab, bench.renderer, view, SIZE)
    for target in (0.6, 0.3, 0.1):
        bench.bake(view, target)
        card.light(view, 0.05)
    assert_same(difference(card.picture(view), *plain_light(bench.renderer, view, 0.05)))


@pytest.mark.parametrize(("albedo", "most"), [(0.5, 0.02), (0.7, 0.03), (0.3, 0.05), (0.8, 0.08)])
def test_another_albedo_is_predicted(
    lab: Lab, make_bench: Make, albedo: float, most: float
) -> None:
    """Without other light: reflected light grows by one more factor, to first order. Its error is
    what is left.
    """
    bench = lit_bench(make_bench, lights=[SKY], albedo=0.6, albedos=[0.2, 0.8])
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    truth, on = plain_light(bench.renderer, replace(view, albedo=(albedo,) * 3), LOOSE)
    found = difference(card.picture(view, albedo=[albedo / 0.6] * 3), truth, on)
    unchanged = difference(card.picture(view), truth, on)
    assert found.rmse < most and found.rmse < 0.3 * unchanged.rmse, (found, unchanged)


def test_lobes_cast_shadows_while_the_view_moves(lab: Lab, make_bench: Make) -> None:
    bench = lit_bench(make_bench, "casting", lights=[SKY], target_error=0.05)
    view = view_at(bench)
    assert len(light_of(bench.renderer, view).lobes.kinds) > 0
    card = CardScene(lab, bench.renderer, view, SIZE, lobes=True)
    card.light(view, LOOSE)
    light = bench.renderer.render(view, Goal.checked(LOOSE)).radiance
    on = plain_light(bench.renderer, view, LOOSE)[1]
    found = difference(card.picture(view), light, on)
    assert found.within >= 0.98 and found.rmse <= 0.02, found


def test_samples_at_rest_make_edges_smooth(lab: Lab, under_sky: Workbench) -> None:
    view = view_at(under_sky)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE)
    first = card.picture(view)
    rest = card.picture(view, rest=True)
    assert set(np.unique(first.covers)) == {0.0, 1.0}
    between = (rest.covers > 0.01) & (rest.covers < 0.99)
    assert between.sum() > 0.2 * np.sqrt(first.covers.sum())
    np.testing.assert_allclose(rest.covers.mean(), first.covers.mean(), rtol=0.02)
    flat = (contrast_of(first) < 10) & (first.covers > 0.5)
    assert flat.sum() > 50
    np.testing.assert_allclose(
        rest.light[flat], first.light[flat], rtol=2e-3, err_msg="what is at no edge stays as it is"
    )


@pytest.mark.long
def test_edges_are_smooth_after_three_tenths_of_a_second(lab: Lab, under_sky: Workbench) -> None:
    """At 60 Hz all samples are drawn by then; nearly each step of an edge has a blend at it."""
    view = view_at(under_sky)
    card = CardScene(lab, under_sky.renderer, view, SIZE)
    card.light(view, LOOSE)
    first = card.picture(view)
    rest = card.picture(view, rest=True)
    assert lab.ask("return card.last.samples - 1;") <= 0.3 * 60
    on = first.covers > 0.5
    blends = (rest.covers > 0.01) & (rest.covers < 0.99)
    steps = [(on != np.roll(on, 1, axis), blends | np.roll(blends, 1, axis)) for axis in (0, 1)]
    stairs = sum(int(step.sum()) for step, _ in steps)
    smooth = sum(int((step & part).sum()) for step, part in steps)
    assert stairs > 100 and smooth > 0.95 * stairs, (smooth, stairs)


def contrast_of(shown: Shown) -> np.ndarray:
    """How much pixels differ from those around, of 255 steps; 255 where one of two shows the
    surface alone.
    """
    on = shown.covers > 0.5
    codes = developed(shown.light, on, 1.0)
    most = np.zeros(on.shape)
    for dy, dx in product((-1, 0, 1), repeat=2):
        beside, there = (np.roll(each, (dy, dx), axis=(0, 1)) for each in (codes, on))
        most = np.maximum(most, np.where(on != there, 255.0, np.abs(codes - beside).max(axis=2)))
    return most
