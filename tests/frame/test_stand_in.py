"""Light of the whole volume that stands in while what is cut open has none of its own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View, read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.masks import NORMAL_REACH, cut_away, voxels_left
from tests.frame.conftest import Workbench, scene_of, shell

CUT = "x>16"


def pair(workbench: Callable[[Scene], Workbench], folder: Path) -> tuple[View, Workbench, Workbench, Renderer]:
    """A view; the whole shell, baked; the cut one with nothing baked, and a renderer of it with the other's light."""
    whole = workbench(scene_of(shell(), 0.0))
    cut = Workbench(scene_of(cut_away(shell(), CUT), 0.0), folder / "cut")
    view = View(0.0, whole.scene.camera(20.0, 30.0, 3.0, 30.0), width=40, height=40)
    whole.bake(replace(view, window=read_window(CUT)))
    lent = StandIn(whole.caches, voxels_left(whole.scene.volume, CUT))
    return view, whole, cut, Renderer(cut.caches, Tiles(), stand_in=lent)


def test_the_wholes_light_stands_in_far_from_faces(workbench: Callable[[Scene], Workbench], tmp_path: Path) -> None:
    view, whole, cut, renderer = pair(workbench, tmp_path)
    before = whole.renderer.render(replace(view, window=read_window(CUT)))
    bare, lent = cut.renderer.render(view), renderer.render(view)
    assert bare.version != lent.version
    assert set(np.unique(lent.state)) == {0, PROVISIONAL}, "what stands in is told as provisional"
    assert len(lent.demands) == len(bare.demands), "and all of it is still to be baked"
    shared = np.intersect1d(before.gbuffer.pixels, lent.gbuffer.pixels)
    one, other = (each.position.reshape(-1, 3)[shared] for each in (before, lent))
    far = shared[np.isclose(one, other, atol=1e-3).all(axis=1) & (other[:, 0] < 16 - NORMAL_REACH - 1.8)]
    assert len(far) > 20
    shown, wanted, plain = (each.radiance.reshape(-1, 3)[far] for each in (lent, before, bare))
    assert np.allclose(shown, wanted, rtol=1e-4)
    assert np.abs(plain - wanted).max() > 0.05, "without it a hollow that is dark shows the sky"
    near = lent.gbuffer.pixels[lent.gbuffer.points[:, 0] > 16 - NORMAL_REACH + 1]
    assert np.array_equal(lent.radiance.reshape(-1, 3)[near], bare.radiance.reshape(-1, 3)[near])


def test_nothing_of_it_is_left_once_light_is_there(workbench: Callable[[Scene], Workbench], tmp_path: Path) -> None:
    view, _, cut, renderer = pair(workbench, tmp_path)
    final = cut.bake(view)
    lent = renderer.render(view)
    assert (lent.state[lent.state > 0] > PROVISIONAL).all() and np.array_equal(lent.state, final.state)
    assert lent.version == final.version and np.array_equal(lent.radiance, final.radiance)


def test_a_whole_that_is_gone_lends_nothing(workbench: Callable[[Scene], Workbench], tmp_path: Path) -> None:
    view, whole, cut, _ = pair(workbench, tmp_path)
    again = whole.again()
    renderer = Renderer(cut.caches, Tiles(), stand_in=StandIn(again.caches, voxels_left(whole.scene.volume, CUT)))
    del again
    assert renderer.render(view).version == cut.renderer.render(view).version
