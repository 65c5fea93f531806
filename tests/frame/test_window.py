"""Surfaces that are opened: windows, cuts, and light of the whole that stands in for a cut's."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.frame.gbuffer import GBuffer, trace
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL
from isogi_core.model.view import View, Window, read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.masks import cut_away, voxels_left
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import MIDDLE, Workbench, scene_of, shell

TILES = Tiles(2)
THIN = (1.0, 1.0, 0.5)
"""Spacing of the shell."""


def look(window: str | None, elevation: float = 0.0) -> GBuffer:
    """The shell from +x through a window."""
    scene = scene_of(shell(spacing=THIN), 0.0)
    view = View(0.0, scene.camera(0.0, elevation, 3.0, 30.0), width=64, height=64)
    view = replace(view, window=None if window is None else read_window(window))
    return trace(view, PreparedScene(scene).surface(0.0), TILES)


def radii(points: np.ndarray) -> np.ndarray:
    """Distances of points from the middle, in voxels."""
    return np.linalg.norm(points - MIDDLE, axis=1)


def test_a_window_of_nothing_shows_the_same_points_to_the_bit() -> None:
    whole = look(None)
    through = look("x>1000;y<-1000")
    assert np.array_equal(whole.pixels, through.pixels) and np.array_equal(
        whole.points, through.points
    )
    assert through.alone


def test_a_cut_shell_shows_its_hollow_behind_a_face() -> None:
    gbuffer = look("x>16")
    assert np.allclose(gbuffer.faces.points[:, 0], 16.0, atol=1e-4)
    rings = radii(gbuffer.faces.points)
    assert rings.min() > 5.9 and rings.max() < 12.1, (
        "the face is the ring between hollow and outside"
    )
    assert np.allclose(radii(gbuffer.points), 6.0, atol=0.1), "behind it the hollow alone"
    assert gbuffer.points[:, 0].max() <= 16.0
    assert not set(gbuffer.pixels.tolist()) & set(gbuffer.faces.pixels.tolist())


def test_what_lies_behind_the_last_plane_is_not_seen() -> None:
    gbuffer = look("x<16;z>9", 50.0)
    for points in (gbuffer.points, gbuffer.faces.points):
        assert points[:, 0].min() >= 16.0 - 1e-4
        assert (0.5 * points[:, 2]).max() <= 9.0 + 1e-4, "planes are in world units"


def test_faces_and_points_are_those_of_a_march() -> None:
    window = read_window("1,2,-1>18;0,1,0.3<8")
    scene = scene_of(shell(spacing=THIN), 0.0)
    view = View(0.0, scene.camera(40.0, 25.0, 3.0, 30.0), width=48, height=48, window=window)
    gbuffer = trace(view, PreparedScene(scene).surface(0.0), TILES)
    kinds = np.zeros(48 * 48, int)
    kinds[gbuffer.pixels] = 1
    kinds[gbuffer.faces.pixels] = 2
    found = gbuffer.position.reshape(-1, 3)
    for pixel in np.random.default_rng(3).choice(48 * 48, 300, replace=False):
        kind, place = marched(view, window, int(pixel))
        if kind >= 0:
            assert kinds[pixel] == kind
            assert kind == 0 or np.abs(found[pixel] - place).max() < 0.05


def marched(view: View, window: Window, pixel: int) -> tuple[int, np.ndarray]:
    """What a pixel shows by short steps through the closed form: 0 nothing, 1 the surface, 2 a
    face; -1 unsure.
    """
    right, up, forward = view.camera.basis()
    y, x = divmod(pixel, view.width)
    size = 2 * np.tan(np.radians(view.camera.fov / 2)) / view.height
    d = (
        forward
        + right * (x + 0.5 - view.width / 2) * size
        + up * (view.height / 2 - y - 0.5) * size
    )
    places = np.array(view.camera.eye) + np.arange(0.0, 90.0, 0.01)[:, None] * d
    left = np.array([places @ np.array(plane[:3]) + plane[3] for plane in window.planes]).min(
        axis=0
    )
    r = np.linalg.norm(places / (1.0, 1.0, 0.5) - MIDDLE, axis=1)
    value = np.where(left >= 0, np.minimum(12 - r, r - 6), -np.inf)
    inside = np.flatnonzero(value > 0)
    first = inside[0] if len(inside) else 0
    near = np.abs(np.where(left >= -0.1, np.minimum(12 - r, r - 6), np.inf)).min()
    if not len(inside):
        return (0 if near > 0.3 else -1), places[0]
    opened = left[first - 1] < 0
    if opened:
        surely = np.minimum(12 - r, r - 6)[first] > 0.3
    else:
        surely = left[first] > 0.1
    return (2 if opened else 1) if surely else -1, places[first]


def test_faces_show_values_as_greys_and_are_final(workbench: Workbench) -> None:
    scene = scene_of(shell(spacing=THIN), 0.0)
    bench = workbench(scene)
    view = View(
        0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=48, height=48, window=read_window("x>16")
    )
    frame = bench.renderer.render(view)
    faces = frame.gbuffer.faces
    assert (frame.state.ravel()[faces.pixels] == FINAL).all() and not frame.error.ravel()[
        faces.pixels
    ].any()
    light = frame.radiance.reshape(-1, 3)[faces.pixels]
    assert (light[:, 0] == light[:, 1]).all() and light.min() > 0.0
    depth = 3.0 - np.abs(radii(faces.points) - 9.0)
    assert np.corrcoef(depth, light[:, 0])[0, 1] > 0.9, "brightest in the middle of the wall"


def test_the_window_belongs_to_a_picture_and_not_to_its_light(workbench: Workbench) -> None:
    scene = scene_of(shell(spacing=THIN), 0.0)
    bench = workbench(scene)
    view = View(0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=32, height=32)
    whole, cut = (
        bench.renderer.render(each) for each in (view, replace(view, window=read_window("z>12")))
    )
    assert whole.version != cut.version
    assert bench.renderer.render(view).version == whole.version
    both = np.isin(whole.gbuffer.pixels, cut.gbuffer.pixels)
    same = whole.gbuffer.pixels[both]
    shared = np.isclose(
        whole.position.reshape(-1, 3)[same], cut.position.reshape(-1, 3)[same], atol=1e-4
    ).all(axis=1)
    assert shared.sum() > 20
    light = (frame.radiance.reshape(-1, 3)[same[shared]] for frame in (whole, cut))
    assert np.allclose(*light, rtol=1e-3)


@pytest.mark.parametrize("shading", ["lambert", "vicinity", "path_traced"])
def test_every_shading_has_faces(workbench: Workbench, shading: str) -> None:
    scene = scene_of(shell(spacing=THIN), 0.0)
    view = View(
        0.0,
        scene.camera(0, 0, 3, 30),
        width=24,
        height=24,
        shading=shading,
        window=read_window("x>16"),
    )
    frame = workbench(scene).renderer.render(view)
    assert len(frame.gbuffer.faces.pixels) > 20
    assert (frame.state.ravel()[frame.gbuffer.faces.pixels] == FINAL).all()


# --- cuts
# --------------------------------------------------------------------------------------------------


def test_a_face_under_even_light_has_all_of_it(workbench: Workbench) -> None:
    scene = scene_of(cut_away(shell(0.0), "x>16"), 0.0)
    bench = workbench(scene)
    frame = bench.bake(View(0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=40, height=40))
    rings = np.linalg.norm(
        frame.position.reshape(-1, 3)[frame.gbuffer.pixels][:, 1:] - MIDDLE, axis=1
    )
    light = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels][(rings > 2.0) & (rings < 9.0)]
    assert np.allclose(light, scene.surfaces.albedo[0], rtol=0.03), "a plane sees the whole sky"


def test_light_comes_into_a_hollow_that_is_cut_open(workbench: Workbench) -> None:
    scene = scene_of(cut_away(shell(), "x>16"), 0.0)
    bench = workbench(scene)
    frame = bench.bake(View(0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=40, height=40))
    inside = (
        np.linalg.norm(frame.position.reshape(-1, 3)[frame.gbuffer.pixels] - MIDDLE, axis=1) < 7.0
    )
    light = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels][inside]
    assert inside.sum() > 50 and light.min() > 0.2


# --- light that stands in
# ---------------------------------------------------------------------------------------------


CUT = "x>16"


def pair(
    workbench: Callable[[Scene], Workbench], folder: Path
) -> tuple[View, Workbench, Workbench, Renderer]:
    """A view; the whole shell, baked; the cut one with nothing baked, and a renderer of it with the
    other's light.
    """
    whole = workbench(scene_of(shell(), 0.0))
    cut = Workbench(scene_of(cut_away(shell(), CUT), 0.0), folder / "cut")
    view = View(0.0, whole.scene.camera(20.0, 30.0, 3.0, 30.0), width=40, height=40)
    whole.bake(replace(view, window=read_window(CUT)))
    lent = StandIn(whole.caches, voxels_left(whole.scene.volume, CUT))
    return view, whole, cut, Renderer(cut.caches, Tiles(), stand_in=lent)


def test_the_wholes_light_stands_in_far_from_faces(
    workbench: Callable[[Scene], Workbench], tmp_path: Path
) -> None:
    """The cut is at 16. Normals are those of the whole volume some four voxels before it."""
    view, whole, cut, renderer = pair(workbench, tmp_path)
    before = whole.renderer.render(replace(view, window=read_window(CUT)))
    bare = cut.renderer.render(view)
    lent = renderer.render(view)
    assert bare.version != lent.version
    assert set(np.unique(lent.state)) == {0, PROVISIONAL}, "what stands in is told as provisional"
    assert len(lent.demands) == len(bare.demands), "and all of it is still to be baked"
    shared = np.intersect1d(before.gbuffer.pixels, lent.gbuffer.pixels)
    one, other = (each.position.reshape(-1, 3)[shared] for each in (before, lent))
    far = shared[np.isclose(one, other, atol=1e-3).all(axis=1) & (other[:, 0] < 11.5)]
    assert len(far) > 20
    shown, wanted, plain = (each.radiance.reshape(-1, 3)[far] for each in (lent, before, bare))
    assert np.allclose(shown, wanted, rtol=1e-4)
    assert np.abs(plain - wanted).max() > 0.05, "without it a hollow that is dark shows the sky"
    near = lent.gbuffer.pixels[lent.gbuffer.points[:, 0] > 14.5]
    assert np.array_equal(lent.radiance.reshape(-1, 3)[near], bare.radiance.reshape(-1, 3)[near])


def test_nothing_of_it_is_left_once_light_is_there(
    workbench: Callable[[Scene], Workbench], tmp_path: Path
) -> None:
    view, _, cut, renderer = pair(workbench, tmp_path)
    final = cut.bake(view)
    lent = renderer.render(view)
    assert (lent.state[lent.state > 0] > PROVISIONAL).all() and np.array_equal(
        lent.state, final.state
    )
    assert lent.version == final.version and np.array_equal(lent.radiance, final.radiance)


def test_a_whole_that_is_gone_lends_nothing(
    workbench: Callable[[Scene], Workbench], tmp_path: Path
) -> None:
    view, whole, cut, _ = pair(workbench, tmp_path)
    again = whole.again()
    renderer = Renderer(
        cut.caches, Tiles(), stand_in=StandIn(again.caches, voxels_left(whole.scene.volume, CUT))
    )
    del again
    assert renderer.render(view).version == cut.renderer.render(view).version
