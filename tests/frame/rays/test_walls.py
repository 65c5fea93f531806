"""Walls of rooms: their light beside texels, what it errs by, and how it is kept."""

import math
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import interp1d

from isogi_core.bake.noise import Goal
from isogi_core.cache.upkeep import PruneRule, audit_store, census_of, plan_prune
from isogi_core.cache.wall_store import WallStore
from isogi_core.errors import ViewError
from isogi_core.files.vector import triple
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.wall_light import RoomLight
from isogi_core.frame.rays.wall_texels import (
    WallTexels,
    filter_wall,
)
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.plan.variants import WALLS_SIDE
from isogi_core.storage.store import Store
from tests.frame.conftest import CONSTANT, LOOSE, Workbench, relative_rmse
from tests.frame.several.drawing import bake
from tests.loaded import load_scene

SIZE = 32


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital in a Cornell room, baked to a tenth in the view from its open side."""
    scene = load_scene(
        "demo:orbital", room="cornell", bounces=2, target_error=LOOSE, projected=False
    )
    bench = Workbench(scene, tmp_path_factory.mktemp("room"))
    bench.bake(bench.view(90.0, 0.0, SIZE, distance=4.0))
    return bench


@pytest.mark.slow
def test_a_room_becomes_final_and_is_what_paths_say(room: Workbench) -> None:
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    first = room.renderer.render(view)
    walls = first.gbuffer.walls
    assert set(walls.numbers.tolist()) == {0, 1, 2, 3, 4, 5}
    assert first.surface == len(walls.pixels) + len(first.gbuffer.pixels)
    assert set(first.state.ravel()[walls.pixels]) == {PROVISIONAL}
    assert first.quality.waiting == len(walls.pixels)
    assert first.checkable
    frame = room.settled(view)
    assert frame.quality.waiting == 0
    assert (frame.state[first.state > 0] == FINAL).all()
    assert frame.version != first.version
    traced = room.renderer.render(
        room.view(90.0, 0.0, SIZE, distance=4.0, shading="path_traced", samples=256)
    )
    assert relative_rmse(frame, traced) < 1.5 * LOOSE
    assert frame.noise < LOOSE
    red, green = (
        frame.radiance.reshape(-1, 3)[walls.pixels[walls.numbers == k]].mean(axis=0) for k in (3, 4)
    )
    assert red[0] > 2.0 * red[1]
    assert green[1] > 2.0 * green[0]
    lamp = frame.radiance.reshape(-1, 3)[walls.pixels[walls.numbers == 5]]
    np.testing.assert_allclose(lamp, room.scene.lighting.room.walls[5].radiance[0], rtol=1e-6)


@pytest.mark.slow
def test_edges_of_walls_and_before_walls_are_smooth(room: Workbench) -> None:
    """Against the mean of six times as many pixels along each side, of the same light."""
    room.settled(room.view(90.0, 0.0, SIZE, distance=4.0))
    view = room.view(90.0, 0.0, 3 * SIZE, distance=2.5, smooth=True)
    fine = replace(view, width=18 * SIZE, height=18 * SIZE, smooth=False)
    room.bake(view)
    room.bake(fine)
    smooth, stairs, many = (
        room.renderer.render(each) for each in (view, replace(view, smooth=False), fine)
    )
    true = many.radiance.reshape(3 * SIZE, 6, 3 * SIZE, 6, 3).mean(axis=(1, 3)).reshape(-1, 3)
    assert smooth.edges is not None
    pixels = smooth.edges.pixels
    assert (
        np.isin(smooth.gbuffer.walls.pixels, pixels).any()
        and np.isin(smooth.gbuffer.pixels, pixels).any()
    )
    found = smooth.edges.covered[:, :3], stairs.radiance.reshape(-1, 3)[pixels]
    off = [np.sqrt(np.mean((each - true[pixels]) ** 2)) for each in found]
    assert off[0] < off[1] / 3, off


def test_positions_are_those_of_walls_too(room: Workbench) -> None:
    frame = room.renderer.render(room.view(90.0, 0.0, SIZE, distance=4.0))
    walls = frame.gbuffer.walls
    places = frame.position.reshape(-1, 3)[walls.pixels]
    corners = room.scene.lighting.room.corners[walls.numbers]
    edges = room.scene.lighting.room.edges[walls.numbers]
    heights = ((places - corners) * np.cross(edges[:, 0], edges[:, 1])).sum(axis=1)
    assert np.abs(heights).max() < 1e-2 * room.scene.volume.radius
    np.testing.assert_array_equal(frame.positions(3, 5), frame.position[3:5])


@pytest.mark.parametrize("shading", ["vicinity", "lambert", "phong_shadow", "lambert_fog"])
def test_other_shadings_show_the_walls(room: Workbench, shading: str) -> None:
    frame = room.renderer.render(room.view(90.0, 0.0, SIZE, distance=4.0, shading=shading))
    walls = frame.gbuffer.walls
    shown = frame.radiance.reshape(-1, 3)[walls.pixels[walls.numbers == 3]]
    assert frame.quality.waiting == 0
    assert (frame.state.ravel()[walls.pixels] == FINAL).all()
    assert (shown[:, 0] > 2.0 * shown[:, 1]).all()


def test_the_camera_may_not_stand_in_a_wall(room: Workbench) -> None:
    view = room.view(size=8)
    wall = room.scene.lighting.room.walls[0]
    eye = triple(np.array(wall.corner) + np.array(wall.edges).sum(axis=0) / 3.0)
    with pytest.raises(ViewError, match="The camera stands in wall 1: move it"):
        room.renderer.render(replace(view, camera=replace(view.camera, eye=eye)))


@pytest.mark.slow
def test_a_white_furnace_stays_one_in_a_closed_room(tmp_path: Path) -> None:
    """Walls that all give off 1 and reflect nothing are a constant light of radiance 1 to a surface
    in them.
    """
    low = -30.0
    high = 130.0
    a, b, c = (high - low) * np.eye(3)
    p, q = np.full(3, low), np.full(3, high)
    faces = [(p, b, c), (q, -c, -b), (p, c, a), (q, -a, -c), (p, a, b), (q, -b, -a)]
    walls = [
        {
            "corner": x.tolist(),
            "edges": [u.tolist(), v.tolist()],
            "albedo": 0,
            "radiance": 1,
            "sides": 1,
        }
        for x, u, v in faces
    ]
    settings = {"bounces": 1, "target_error": 0.05, "albedo": 0.5, "projected": False}
    closed = Workbench(load_scene("demo:orbital", walls=walls, **settings), tmp_path / "closed")
    alone = load_scene(
        "demo:orbital", lights=[CONSTANT], rotating=False, representation="irradiance", **settings
    )
    outside = Workbench(alone, tmp_path / "open")
    view = closed.view(40.0, 30.0, 16, distance=1.5)
    surface = closed.bake(view).gbuffer.pixels
    found, expected = (
        bench.bake(view).radiance.reshape(-1, 3)[surface] for bench in (closed, outside)
    )
    assert abs(found.mean() / expected.mean() - 1.0) < 0.01


def on_walls(*frames: Frame) -> list[np.ndarray]:
    """What pictures of one view show on walls, (m, 3) each."""
    return [frame.radiance.reshape(-1, 3)[frame.gbuffer.walls.pixels] for frame in frames]


def test_pictures_wait_for_no_step_of_walls(room: Workbench) -> None:
    """While a step of all walls holds their locks, pictures show the texels before it."""
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    before = room.renderer.render(view)
    light = room.renderer.surface.kept.held((RoomLight, view.isovalue, view.albedo, view.glow))
    with ThreadPoolExecutor(1) as other, ExitStack() as stepping:
        for side in light.sides.values():
            stepping.enter_context(side.lock)
        frame = other.submit(room.renderer.render, view).result(timeout=60.0)
    assert len(light.sides) == 6
    np.testing.assert_array_equal(frame.radiance, before.radiance)


def test_walls_are_final_at_once_after_a_restart(room: Workbench) -> None:
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    before = room.settled(view)
    after = room.again().renderer.render(view)
    assert after.quality.waiting == 0
    np.testing.assert_array_equal(*on_walls(before, after))
    np.testing.assert_array_equal(
        *(frame.error.ravel()[before.gbuffer.walls.pixels] for frame in (before, after))
    )


@pytest.mark.long
@pytest.mark.slow
def test_walls_between_two_isovalues_show_what_is_known_of_these(
    room: Workbench, tmp_path: Path
) -> None:
    middle = room.scene.isovalue
    low, here, high = (
        room.view(90.0, 0.0, SIZE, distance=4.0, isovalue=middle * share)
        for share in (0.8, 1.0, 1.2)
    )
    fresh = Workbench(room.scene, tmp_path)
    for view in (low, high):
        fresh.bake(view)
        fresh.settled(view)
    fresh.bake(here)
    lent = fresh.again().renderer.render(here)
    walls = lent.gbuffer.walls.pixels
    true = room.settled(here)
    assert lent.quality.waiting == len(walls), "they are not final"
    assert set(lent.state.ravel()[walls]) == {CONVERGING}
    shown, known = (
        frame.radiance.reshape(-1, 3)[walls] @ LUMINANCE_WEIGHTS for frame in (lent, true)
    )
    wrong = shown - known
    told = lent.error.ravel()[walls] * shown
    assert np.sqrt((wrong**2).mean()) < 2.0 * np.sqrt((told**2).mean())
    assert np.sqrt((wrong**2).mean()) < LOOSE * known.mean()
    np.testing.assert_array_equal(
        fresh.settled(here).radiance.reshape(-1, 3)[walls], true.radiance.reshape(-1, 3)[walls]
    )


@pytest.mark.slow
def test_damaged_light_of_walls_is_baked_again(room: Workbench, tmp_path: Path) -> None:
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    true = room.settled(view)
    copy = Workbench(room.scene, Path(shutil.copytree(room.folder, tmp_path / "copy")))
    objects = sorted(path for walls in walls_of(copy) for path in walls.glob("c/*/*/*/0"))
    assert objects
    for path in objects:
        path.write_bytes(path.read_bytes()[:-9])
    found = sorted(damage.key for damage in audit_store(copy.caches.store).damages)
    damaged = [path.relative_to(copy.folder).as_posix() for path in objects]
    assert found == damaged, "an audit finds them"
    assert copy.renderer.render(view).quality.waiting
    np.testing.assert_array_equal(*on_walls(copy.settled(view), true))
    assert audit_store(copy.caches.store).sound


def walls_of(bench: Workbench) -> list[Path]:
    """The folders of a store with light of walls."""
    counts = census_of(bench.caches.store).counts.values()
    walls = [each for each in counts if each.facts.layer.kind == "walls"]
    return [bench.folder / each.files.digest for each in walls]


def test_light_of_walls_is_pruned_with_the_rest(room: Workbench, tmp_path: Path) -> None:
    room.settled(room.view(90.0, 0.0, SIZE, distance=4.0))
    store = Store(shutil.copytree(room.folder, tmp_path / "copy"))
    census = census_of(store)
    walls = [count for count in census.counts.values() if count.facts.layer.kind == "walls"]
    assert walls and all(count.lit and count.paths for count in walls)
    plan = plan_prune(census, PruneRule(scene=room.scene.id), store.now() + 1e6)
    assert {count.files.digest for count in walls} <= {count.files.digest for count in plan.going}


@pytest.mark.slow
def test_walls_are_lit_where_a_store_takes_nothing(room: Workbench, tmp_path: Path) -> None:
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    bench = Workbench(room.scene, tmp_path)
    bench.bake(view)
    bench.caches.store.read_only = True
    np.testing.assert_array_equal(*on_walls(bench.settled(view), room.settled(view)))
    assert not (tmp_path / "walls").exists()


def test_finer_texels_are_what_they_were_when_they_are_read(
    room: Workbench, tmp_path: Path
) -> None:
    store = WallStore(Store(tmp_path), room.prepared)
    view = room.view(90.0, 0.0, SIZE, distance=4.0)
    light = RotatedLight(room.caches.spec("gi"), view)
    surface = room.prepared.surface(view.isovalue)
    lit = RoomLight.of(light, surface, store)
    first = WallTexels.begun(light, 0, 1, 2)
    coarse = first.nearer(light, surface, LOOSE, room.renderer.tiles)
    assert 32 <= coarse.across <= 128
    rows, columns = (2 * each for each in coarse.settled.shape)
    asked = np.zeros((rows, columns), bool)
    asked[rows // 6 : rows // 3, columns // 4 : columns // 2] = True
    fine = coarse.finer(light, asked).grown(light, surface, room.renderer.tiles)
    lit.keep([coarse, fine])
    again = RoomLight.of(light, surface, store).side((0, 1)).texels
    assert (again.across, again.count) == (fine.across, fine.count)
    for name in ("means", "settled", "variance", "unsharp"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fine, name))
    further = (
        texels.grown(light, surface, room.renderer.tiles, texels.count).means
        for texels in (again, fine)
    )
    np.testing.assert_array_equal(*further)


def wall_texels(
    across: int, light: Callable[[np.ndarray, np.ndarray], np.ndarray], noise: float = 0.0
) -> WallTexels:
    """Texels of a square wall on which so much light arrives, at (x, y) in 0 to 1; halves have so
    much noise.
    """
    middles = (np.arange(across) + 0.5) / across
    found = light(*np.meshgrid(middles, middles))[..., None, None] * np.ones((2, 3))
    found += noise * np.random.default_rng(1).normal(size=(across, across, 2, 1))
    return WallTexels(
        0, 1, np.ones(3), np.zeros(3), found, across, np.full((across, across), np.nan), count=8
    )


def even(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Light of 1 everywhere."""
    return np.ones_like(x + y)


def test_walls_foresee_the_paths_that_noise_takes() -> None:
    """Paths grow with the square of the noise, by doubling."""
    texels = wall_texels(64, even, noise=0.1)
    error = texels.relative(texels.variance)
    assert texels.steps_left(1.1 * error) == []
    steps = texels.steps_left(error / 4.1)
    assert len(steps) == math.ceil(2.0 * math.log2(4.1))
    assert steps == [texels.paths * 2**n for n in range(len(steps))]


def test_walls_foresee_that_coarse_texels_become_fine() -> None:
    """Sixteen times as many texels, with as many paths each as the coarse ones."""
    texels = wall_texels(16, even, noise=0.01)
    assert texels.steps_left(0.02) == [16.0 * texels.paths]


def test_walls_foresee_finer_texels_along_an_edge() -> None:
    """Those next to a straight shadow, and two on either side of these, four times as many."""
    texels = wall_texels(64, lambda x, y: 1.0 + (x > 0.4 + 0.3 * y))
    first, second = texels.steps_left(0.01)
    each = 2.0 * texels.count
    assert 4.0 <= first / each / 4.0 / 64.0 <= 7.0
    assert second == 2.0 * first


def between_texels(
    texels: WallTexels, light: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> float:
    """What their light, interpolated, errs by: the root of the mean square over a wall."""
    share = (np.arange(1000) + 0.5) / 1000 * texels.across - 0.5
    along = interp1d(np.arange(texels.across), texels.luminance, fill_value="extrapolate")(share)
    shown = interp1d(np.arange(texels.across), along.T, fill_value="extrapolate")(share)
    x, y = np.meshgrid(*((np.arange(1000) + 0.5) / 1000,) * 2)
    return float(np.sqrt(((shown.T - light(x, y)) ** 2).mean()))


@pytest.mark.parametrize("turn", [0.1, 0.6, 1.3])
def test_walls_tell_what_edges_of_shadows_between_texels_are_off(turn: float) -> None:
    def shadow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1.0 + (np.cos(turn) * (x - 0.47) + np.sin(turn) * (y - 0.52) > 0.0)

    texels = wall_texels(64, shadow, noise=0.02)
    told = np.sqrt(texels.unsharp.mean())
    true = between_texels(texels, shadow)
    assert 0.7 < told / true < 1.6
    assert texels.too_coarse(0.02)
    assert not wall_texels(512, shadow).too_coarse(0.005), "and no finer ones are made then"


def test_walls_tell_what_smooth_light_between_texels_is_off() -> None:
    def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1.0 + 0.4 * np.sin(30.0 * x + 20.0 * y)

    texels = wall_texels(64, waves)
    assert 0.6 < np.sqrt(texels.unsharp.mean()) / between_texels(texels, waves) < 1.6


def test_noise_of_walls_is_not_taken_for_edges() -> None:
    texels = wall_texels(64, lambda x, y: 1.0 + 0.3 * np.sin(3.0 * x + y), noise=0.1)
    assert texels.unsharp.mean() < 0.25 * texels.variance.mean()
    assert not texels.too_coarse(0.02)


def test_the_noise_of_walls_is_filtered_out_of_what_they_show() -> None:
    """But for a quarter, whether light is even, rises or waves; and the variance says so."""
    for light in (
        lambda x, y: 1.0 + 0.0 * x,
        lambda x, y: 0.4 + x + 0.5 * y,
        lambda x, y: 1.0 + 0.3 * np.sin(3.0 * x + y),
    ):
        texels = wall_texels(64, light, noise=0.03)
        truth = wall_texels(64, light).luminance
        shown = texels.leaving.reshape(64, 64, 4)
        wrong = np.sqrt(((shown[..., :3] @ LUMINANCE_WEIGHTS - truth) ** 2).mean())
        noise = np.sqrt(((texels.luminance - truth) ** 2).mean())
        assert wrong < 0.3 * noise
        told = np.sqrt((shown[..., 3] - texels.unsharp).mean())
        assert 0.8 < told / wrong < 1.3
        # Whether they have enough paths is decided by light as it was traced.
        assert np.sqrt(texels.variance.mean()) == pytest.approx(noise, rel=0.1)


def test_edges_of_shadows_on_walls_stay() -> None:
    def shadow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1.0 + (x > 0.5)

    texels = wall_texels(64, shadow, noise=0.03)
    shown = texels.leaving.reshape(64, 64, 4)[..., 0]
    truth = wall_texels(64, shadow).luminance
    assert np.abs((shown - truth).mean(axis=0)).max() < 0.02, "an edge 1 high"
    assert ((shown - truth) ** 2).mean() < ((texels.luminance - truth) ** 2).mean()


@pytest.mark.parametrize("shape", [(2, 2), (2, 64), (3, 5)])
def test_the_shortest_walls_are_filtered_too(shape: tuple[int, int]) -> None:
    light = np.random.default_rng(1).uniform(0.5, 1.5, (*shape, 3))
    found, variance = filter_wall(light, np.full(shape, 0.1))
    assert np.isfinite(found).all() and (variance <= 0.1).all()
    rising = np.add.outer(np.arange(shape[0]), 2.0 * np.arange(shape[1]))[..., None] * np.ones(3)
    found, _ = filter_wall(rising, np.full(shape, 0.1))
    np.testing.assert_allclose(found, rising, atol=1e-9)


# --- walls before and beside texels
# -----------------------------------------------------------------------------------


SMALL = 24
SCENES: dict[str, dict[str, Any]] = {"one": {}, "several": {"isovalue": 0.06, "clear": 0.6}}


@pytest.fixture(params=list(SCENES))
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Workbench:
    """The orbital in a Cornell room, with one surface or with both sides of one that lets rays
    pass; nothing is lit.
    """
    own = {"room": "cornell", "bounces": 2, "target_error": LOOSE, "projected": False}
    return Workbench(load_scene("demo:orbital", **own, **SCENES[request.param]), tmp_path)


def view_of(bench: Workbench) -> View:
    """The view from the open side of the room."""
    return bench.view(90.0, 0.0, SMALL, distance=4.0)


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
    view = view_of(bench)
    target = 0.01
    first = bench.renderer.render(view, Goal.checked(target))
    assert first.walls_lag and first.refinable and not first.checkable
    assert not bench.renderer.render(replace(view, moving=True)).refinable, (
        "a view that moves has no time for it"
    )
    assert bench.renderer.refine(view, Goal.checked(target))
    second = bench.renderer.render(view, Goal.checked(target))
    assert 0.9 * first.quality.waiting < second.quality.waiting and not second.walls_lag
    assert (beside_surface(second) > PROVISIONAL).all()
    assert second.coverage["provisional"] < first.coverage["provisional"] == 1.0
    assert not bench.renderer.refine(view, Goal.checked(target))
    assert bench.renderer.render(view, Goal.checked(target)).version == second.version


@pytest.mark.slow
def test_walls_take_about_the_paths_that_they_foresaw(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges of shadows that the first noise hides take half as many again or more."""
    traced = [0]
    grown = WallTexels.grown

    def counted(self: WallTexels, *given: Any) -> WallTexels:
        after = grown(self, *given)
        traced[0] += after.paths - self.paths
        return after

    view = view_of(bench)
    goal = Goal.checked(0.01)
    bake(bench, view) if bench.scene.surfaces.several else bench.bake(view)
    bench.renderer.refine(view, goal)
    frame = bench.renderer.render(view, goal)
    assert not frame.walls_coarse
    walls = next(part for part in bench.renderer.work_left(frame, goal) if not part.light)
    monkeypatch.setattr(WallTexels, "grown", counted)
    while bench.renderer.render(view, goal).quality.waiting:
        assert bench.renderer.refine(view, goal)
        bake(bench, view) if bench.scene.surfaces.several else bench.bake(view)
    assert 0.4 < walls.foreseen.pixels / traced[0] < 2.0


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
