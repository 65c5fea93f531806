"""Views without light: what a new one lacks is known before its first picture is lit."""

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from isogi_core.frame import renderer as renderer_module
from isogi_core.frame import texel_shading
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import unlit_frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from tests.frame.conftest import SKY, Workbench, refine_chunk
from tests.loaded import load_scene

ORBITAL = {"lights": [SKY], "bounces": 1, "target_error": 0.5}
Make = Callable[..., Workbench]


def unlit(bench: Workbench, view: View) -> Frame | None:
    """The frame of a view that is new, and has no light."""
    return unlit_frame(bench.renderer, view, bench.scene.target_error, threading.Event())


def test_it_demands_what_the_first_picture_does(workbench: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """And that picture traces no ray and finds no texel again."""
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    view = bench.view()
    frame = unlit(bench, view)
    assert frame is not None and not frame.checkable
    for module, name in ((renderer_module, "trace"), (texel_shading, "find_texels")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("it is done twice"))
    first = bench.renderer.render(view)
    assert np.array_equal(frame.state, first.state) and (first.state[first.state > 0] == PROVISIONAL).all()
    pairs = list(zip(frame.demands, first.demands, strict=True))
    assert len(pairs) > 3 and all(ours.index == theirs.index and ours.weight > 0.0 for ours, theirs in pairs)
    assert all(np.array_equal(ours.offsets, theirs.offsets) for ours, theirs in pairs)
    assert all(ours.effort == theirs.effort for ours, theirs in pairs)


def test_there_is_none_of_a_view_that_is_known_or_lit(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    view = bench.view()
    assert unlit(bench, view) is not None
    assert unlit(bench, view) is None, "it is known"
    refine_chunk(bench.caches.of("gi"), 16, 0.5, bench.renderer.render(view).demands[0])
    assert unlit(bench, replace(view, width=40)) is None, "some of it has light"
    assert unlit(bench.again(), view) is None, "also after a restart"


@pytest.mark.parametrize("other", [{"moving": True}, {"shading": "lambert"}, {"shading": "vicinity"}])
def test_views_without_light_of_their_own_are_passed_over(workbench: Make, other: dict[str, object]) -> None:
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    found = unlit(bench, bench.view(**other))
    assert (found is not None) == (other == {"shading": "vicinity"})


def test_it_ends_once_nobody_waits(workbench: Make) -> None:
    bench, cancelled = workbench(load_scene("demo:orbital", **ORBITAL)), threading.Event()
    cancelled.set()
    with pytest.raises(Cancelled):
        unlit_frame(bench.renderer, bench.view(), 0.5, cancelled)


@pytest.mark.parametrize("settings", [{}, {"isovalue": 0.02}])
def test_the_first_picture_is_the_same_about_any_normals(
    workbench: Make, settings: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is lit about those of surface points, as texels' own would take as long as all else."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    view = bench.view(**settings)
    monkeypatch.setattr(texel_shading, "find_texel_normals", lambda *_: pytest.fail("it takes long"))
    near = bench.renderer.render(view)
    monkeypatch.undo()
    monkeypatch.setattr("isogi_core.frame.texel_reading.Reading.unbaked", False)
    own = bench.again().renderer.render(view)
    np.testing.assert_allclose(near.radiance, own.radiance, rtol=1e-5, atol=1e-7)
    assert near.version == own.version and (near.radiance[near.state > 0] > 0.0).all()
