"""Several surfaces that a page's card draws beside isogi's: layers front to back, in the light of
each side.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.model.view import View, read_window
from isogi_core.plan.isovalue_levels import levels_around
from tests.frame.conftest import LOOSE, SKY, Workbench
from tests.frame.several.drawing import bake
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import CardScene, Lab, Shown, difference

pytestmark = pytest.mark.usefixtures("unfiltered")

SIZE = (72, 56)
HALO = {"isovalue": 0.012, "albedo": [0.45, 0.65, 0.9], "clear": 0.65}
SCENES: dict[str, dict[str, Any]] = {
    "opaque in clear": {"isovalue": 0.06, "surfaces": [HALO]},
    "clear in clear": {"isovalue": 0.07, "clear": 0.5, "surfaces": [HALO]},
    "clear alone": {"isovalue": 0.03, "clear": 0.5},
    "sheets": {
        "isovalue": 0.05,
        "albedo": [0.35, 0.3, 0.15],
        "transmission": [0.35, 0.55, 0.15],
        "surfaces": [{**HALO, "transmission": 0.1}, {"isovalue": 0.2, "clear": 0.2}],
    },
}


def bench_of(make_bench: Make, name: str) -> Workbench:
    """The workbench of one of SCENES, with nothing baked yet."""
    given = {"lights": [SKY], "albedo": [0.9, 0.5, 0.2], "bounces": 2, "target_error": LOOSE}
    return make_bench(load_scene("demo:orbital", **{**given, **SCENES[name]}))


def view_at(bench: Workbench, **settings: Any) -> View:
    """A view of the bench's scene in a picture that is wider than it is high."""
    return replace(bench.view(**settings), width=SIZE[0], height=SIZE[1], smooth=False)


def assert_isogis(bench: Workbench, view: View, shown: Shown, least: int = 500) -> None:
    """A card's picture has the light of isogi's, and lets as much of the ground pass."""
    frame = bench.renderer.render(view)
    assert frame.left is not None
    on = frame.state > 0
    seen = replace(shown, covers=(shown.covers > 0.0).astype(np.float32))
    found = difference(seen, frame.radiance, on)
    assert found.surface > least and found.torn == 0
    assert found.within >= 0.999 and found.rmse <= 0.002, found
    hidden = np.where(on, 1.0 - frame.left, 0.0)
    np.testing.assert_allclose(shown.covers, hidden, atol=2e-3)


@pytest.mark.parametrize("name", SCENES)
def test_all_layers_are_in_the_light_of_their_sides(lab: Lab, make_bench: Make, name: str) -> None:
    bench = bench_of(make_bench, name)
    view = view_at(bench)
    frame = bake(bench, view)
    assert any(part.side.inner for part in parts_of(frame))
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    assert_isogis(bench, view, card.picture(view))


def test_light_between_two_levels_is_mixed(lab: Lab, make_bench: Make) -> None:
    bench = bench_of(make_bench, "opaque in clear")
    first = view_at(bench)
    view = replace(first, isovalue=0.07)
    assert len(levels_around(bench.scene.levels, [0.012], 0.07)) == 2
    bake(bench, first)
    bake(bench, view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(first, LOOSE)
    stale = card.picture(view)
    card.light(view, LOOSE)
    shown = card.picture(view)
    assert_isogis(bench, view, shown)
    assert np.abs(stale.light - shown.light).max() > 0.0


def test_a_window_opens_clear_surfaces_and_faces_opaque_ones(lab: Lab, make_bench: Make) -> None:
    bench = bench_of(make_bench, "opaque in clear")
    view = replace(view_at(bench), window=read_window("x>40"))
    frame = bake(bench, view)
    assert len(frame.gbuffer.faces.pixels) > 20
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    assert_isogis(bench, view, card.picture(view), least=300)


@pytest.mark.parametrize("shading", ["lambert_shadow", "lambert_fog", "phong"])
def test_local_models_light_each_surface_alone(lab: Lab, make_bench: Make, shading: str) -> None:
    bench = bench_of(make_bench, "clear in clear")
    view = replace(view_at(bench), shading=shading)
    card = CardScene(lab, bench.renderer, view, SIZE)
    assert_isogis(bench, view, card.picture(view))
