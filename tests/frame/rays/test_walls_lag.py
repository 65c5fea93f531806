"""Walls are lit beside texels: made fine at once, and then as long as they err more than the surface does."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.frame import Frame
from isogi_core.frame.several.composer import parts_of
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.variants import WALLS_SIDE
from tests.frame.conftest import LOOSE, Workbench
from tests.frame.several.drawing import bake
from tests.loaded import load_scene

SIZE = 24
SCENES: dict[str, dict[str, Any]] = {"one": {}, "several": {"isovalue": 0.06, "clear": 0.6}}


@pytest.fixture(params=list(SCENES))
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Workbench:
    """The orbital in a Cornell room, with one surface or with both sides of one that lets rays pass; nothing is lit."""
    own = {"room": "cornell", "bounces": 2, "target_error": LOOSE, "projected": False}
    return Workbench(load_scene("demo:orbital", **own, **SCENES[request.param]), tmp_path)


def view_of(bench: Workbench) -> View:
    """The view from the open side of the room."""
    return bench.view(90.0, 0.0, SIZE, distance=4.0)


def beside_surface(frame: Frame) -> np.ndarray:
    """The states of pixels that show a wall and no surface."""
    alone = frame.state > 0
    parts = parts_of(frame) if parts_of(frame) else ()
    for pixels in [
        frame.gbuffer.pixels,
        *(p for each in parts if each.side != WALLS_SIDE for _, p in each.layers.each),
    ]:
        alone.ravel()[pixels] = False
    return frame.state[alone]


@pytest.mark.slow
def test_walls_are_fine_before_any_texel_has_light(bench: Workbench) -> None:
    """A step makes them so; they err less then than a surface without light, and wait for that."""
    view, target = view_of(bench), 0.01
    first = bench.renderer.render(view, target)
    assert first.walls_lag and first.refinable and not first.checkable
    assert not bench.renderer.render(replace(view, moving=True)).refinable, "a view that moves has no time for it"
    assert bench.renderer.refine(view, target)
    second = bench.renderer.render(view, target)
    assert 0.9 * first.quality.waiting < second.quality.waiting and not second.walls_lag
    assert (beside_surface(second) > PROVISIONAL).all()
    assert second.coverage["provisional"] < first.coverage["provisional"] == 1.0
    assert not bench.renderer.refine(view, target)
    assert bench.renderer.render(view, target).version == second.version


@pytest.mark.slow
def test_walls_grow_while_they_err_more_than_the_surface(bench: Workbench) -> None:
    """Where the surface's light is final they do whatever it takes, as ever."""
    view = view_of(bench)
    bench.renderer.refine(view)
    bake(bench, view) if bench.scene.surfaces.several else bench.bake(view)
    frame = bench.renderer.render(view)
    assert frame.quality.waiting and frame.checkable and frame.refinable
    while bench.renderer.refine(view):
        bake(bench, view) if bench.scene.surfaces.several else bench.bake(view)
    frame = bench.renderer.render(view)
    assert not frame.quality.waiting and not frame.walls_lag and not frame.refinable
    assert (frame.state[frame.state > 0] == FINAL).all()
