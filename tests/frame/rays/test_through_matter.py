"""Pictures of glass: what is seen through it, and the caustics on walls, against paths from each
pixel.
"""

from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.through_matter import SeenThrough, Trees, dark_row
from isogi_core.frame.shot import Shot
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from tests.frame.conftest import CONSTANT, LOOSE, Workbench, relative_rmse
from tests.loaded import load_scene

SIZE = 16


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital of glass over a floor under a sky."""
    floor = {"corner": [-20, -20, -5], "edges": [[135, 0, 0], [0, 135, 0]], "sides": 1}
    glass = {"material": "glass", "absorption": [0.02, 0.0, 0.0], "environment": "overcast"}
    scene = load_scene("demo:orbital", walls=[floor], bounces=1, target_error=0.1, **glass)
    return Workbench(scene, tmp_path_factory.mktemp("glass"))


def test_glass_in_a_room_becomes_what_paths_say(room: Workbench) -> None:
    view = room.view(90.0, 20.0, SIZE, distance=3.0)
    first = room.renderer.render(view)
    glass = first.gbuffer.pixels
    walls = first.gbuffer.walls.pixels
    assert len(glass) and len(walls) and not first.demands
    assert set(first.state.ravel()[walls]) == {PROVISIONAL}
    assert 0 < first.quality.waiting <= first.surface and first.checkable
    frame = room.settled(view)
    assert frame.final
    assert frame.version != first.version
    assert (frame.state[first.state > 0] == FINAL).all()
    traced = room.renderer.render(
        room.view(90.0, 20.0, SIZE, distance=3.0, shading="path_traced", samples=512)
    )
    for pixels in (glass, walls):
        found, true = (
            each.radiance.reshape(-1, 3)[pixels].mean(axis=0) for each in (frame, traced)
        )
        np.testing.assert_allclose(found, true, rtol=0.03)
    assert relative_rmse(frame, traced) < 0.1


def test_clear_glass_under_an_even_sky_is_as_bright_as_that(tmp_path: Path) -> None:
    scene = load_scene("demo:casting", lights=[CONSTANT], material="glass", index=1.6)
    bench = Workbench(scene, tmp_path)
    frame = bench.renderer.render(bench.view(size=SIZE))
    assert frame.final and not frame.demands and not frame.quality.waiting
    np.testing.assert_allclose(frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels], 1.0, rtol=1e-5)
    traced = bench.renderer.render(bench.view(size=SIZE, shading="path_traced", samples=2))
    np.testing.assert_allclose(
        traced.radiance.reshape(-1, 3)[traced.gbuffer.pixels], 1.0, rtol=1e-5
    )


@pytest.fixture(scope="module")
def casting(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """A casting of glass in a studio: rays pass dozens of interfaces."""
    scene = load_scene("demo:casting", material="glass", environment="studio", target_error=0.05)
    return Workbench(scene, tmp_path_factory.mktemp("casting"))


def true_light(bench: Workbench, view: View, trees: int) -> np.ndarray:
    """The luminance of each point by so many trees, of other random numbers than a picture's."""
    light = RotatedLight(bench.renderer.caches.spec("gi"), view)
    shot = Shot(bench.renderer.gbuffer(view), light, Goal(LOOSE), bench.renderer.tiles)
    seen = SeenThrough.of(shot, Trees(64, range(10, 11), range(trees)))
    return np.asarray(
        seen.gather(dark_row(0))[0].reshape(-1, trees, 3).mean(axis=1) @ LUMINANCE_WEIGHTS
    )


@pytest.mark.slow
def test_glass_tells_its_error_and_becomes_right(casting: Workbench) -> None:
    view = casting.view(size=32)
    true = true_light(casting, view, 64)

    def wrong() -> tuple[Frame, float]:
        frame = casting.renderer.render(view)
        light = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels] @ LUMINANCE_WEIGHTS
        return frame, float(np.sqrt(((light - true) ** 2).mean()) / true.mean())

    first, error = wrong()
    assert error > 0.05 and error / 3.0 < first.noise < 2.0 * error
    assert not first.final and first.checkable and first.counts["converging"] == first.surface
    casting.settled(view)
    frame, error = wrong()
    assert frame.final and frame.version != first.version
    assert 0.7 * error < frame.noise < 0.05 and error < 0.06
    other = casting.again().settled(view)
    assert (other.version, other.radiance.tobytes()) == (frame.version, frame.radiance.tobytes())


@pytest.mark.long
@pytest.mark.slow
def test_trees_bring_on_the_average_what_paths_bring(casting: Workbench) -> None:
    traced = casting.renderer.render(casting.view(size=32, shading="path_traced", samples=512))
    found = true_light(casting, casting.view(size=32), 64).mean()
    light = traced.radiance.reshape(-1, 3)[traced.gbuffer.pixels].astype(float) @ LUMINANCE_WEIGHTS
    assert found == pytest.approx(light.mean(), rel=0.02)


@pytest.mark.slow
def test_a_subsurface_becomes_what_paths_inside_say(tmp_path: Path) -> None:
    chosen = {
        "material": "subsurface",
        "mean_free_path": 3.0,
        "albedo": [0.9, 0.6, 0.3],
        "environment": "overcast",
    }
    scene = load_scene("demo:casting", **chosen, target_error=LOOSE, projected=False)
    bench = Workbench(scene, tmp_path)
    frame = bench.settled(bench.bake(bench.view(size=SIZE)).view)
    assert frame.final
    traced = bench.renderer.render(bench.view(size=SIZE, shading="path_traced", samples=512))
    assert relative_rmse(frame, traced) < 1.2 * LOOSE
    means = [
        each.radiance.reshape(-1, 3)[each.gbuffer.pixels].mean(axis=0) for each in (frame, traced)
    ]
    np.testing.assert_allclose(means[0][0], means[1][0], rtol=0.03)
    np.testing.assert_allclose(*means, rtol=0.1)
    assert means[0][0] / means[0][2] > 1.3 * 0.9 / 0.3
