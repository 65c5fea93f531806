"""Bakes of projected texels: added on demand, the oldest forgotten; and an engine whose views at
rest have them.
"""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache import upkeep as pruning
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.upkeep import census_of, trim_projected
from isogi_core.frame import projected_texels
from isogi_core.frame.demand import Demand
from isogi_core.frame.texel_reading import Stage
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import Store
from isogi_server.api.headers import projection_header
from isogi_server.pictures import planes
from isogi_server.render import bakes as room
from isogi_server.render.bakes import SideBakes, share_nothing
from isogi_server.render.engine import RenderEngine
from isogi_worker.bake_requests import GUEST_VIEWER
from tests.server.inline import LONG, view_of


class FakeBaker:
    """Takes on bakes and forgets them."""

    def __init__(self) -> None:
        self.bakes: dict[str, Any] = {}

    def add(self, name: str, bake: Any) -> None:
        self.bakes[name] = bake

    def forget(self, name: str) -> None:
        del self.bakes[name]


@pytest.fixture(autouse=True)
def steep(inline: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projected_texels, "STEEPNESS", 2.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:orbital", lattice=0.5, bounces=1, target_error=0.3, projected=True)


def test_a_bake_is_made_once_and_the_oldest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "MAX_BAKES", 2)
    baker: Any = FakeBaker()
    monkeypatch.setattr(room, "trim_projected", lambda store, most: 0)
    bakes = SideBakes(baker, Store("memory://projected"), 0)
    made: list[float] = []

    def name(scene: str, shown: float) -> str:
        return bakes.name(scene, shown, 0, lambda: made.append(shown))  # type: ignore[arg-type, func-returns-value]

    first = name("a", 0.25)
    second = name("b", 0.25)
    assert first != second and name("a", 0.25) == first
    third = name("a", 0.5)
    assert list(baker.bakes) == [first, third] and made == [0.25, 0.25, 0.5]
    assert (bakes.scene(first), bakes.scene(third), bakes.scene("b")) == ("a", "a", "b")
    bakes.forget("a")
    assert not baker.bakes and bakes.scene(first) == first


def test_who_waits_for_a_bake_that_is_dropped_hears_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The baker says what it drops by the name of the bake: requests wait by that of the scene."""
    monkeypatch.setattr(room, "MAX_BAKES", 1)
    monkeypatch.setattr(room, "trim_projected", lambda store, most: 0)
    heard: list[str] = []

    class TellingBaker(FakeBaker):
        def forget(self, name: str) -> None:
            super().forget(name)
            heard.append(bakes.scene(name))

    baker: Any = TellingBaker()
    bakes = SideBakes(baker, Store("memory://projected"), 0)
    for scene in ("a", "b"):
        last = bakes.name(scene, 0.25, 0, lambda: None)  # type: ignore[arg-type, return-value]
    assert heard == ["a"]
    bakes.forget("b")
    assert heard == ["a", "b"] and bakes.scene(last) == last


def test_a_bake_that_leaves_is_gone_before_it_comes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "trim_projected", lambda store, most: 0)
    begun = threading.Event()
    go_on = threading.Event()

    class SlowBaker(FakeBaker):
        def forget(self, name: str) -> None:
            begun.set()
            assert go_on.wait(LONG)
            super().forget(name)

    baker: Any = SlowBaker()
    bakes = SideBakes(baker, Store("memory://projected"), 0)

    def ask() -> str:
        return bakes.name("a", 0.25, 0, lambda: None)  # type: ignore[arg-type, return-value]

    name = ask()
    with ThreadPoolExecutor(2) as threads:
        forgetting = threads.submit(bakes.forget, "a")
        assert begun.wait(LONG)
        asking = threads.submit(ask)
        go_on.set()
        forgetting.result(LONG)
        assert asking.result(LONG) == name
    assert list(baker.bakes) == [name]


def test_few_isovalues_of_lit_walls_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    baker: Any = FakeBaker()
    trimmed = []
    monkeypatch.setattr(room, "MAX_LIT", 2)
    monkeypatch.setattr(room, "trim_projected", lambda *given: trimmed.append(given))
    bakes = SideBakes(baker, Store("memory://projected"), 0)
    for isovalue in (0.1, 0.2, 0.1, 0.3, 0.1, 0.2):
        bakes.lit("a", isovalue)
        bakes.settle()
    assert len(trimmed) == 4, "0.2 was forgotten, and 0.1 not, as it was lit again"
    bakes.forget("a")
    bakes.lit("a", 0.1)
    bakes.settle()
    assert len(trimmed) == 5


def test_the_caches_that_asked_last_hear_of_new_light(
    monkeypatch: pytest.MonkeyPatch, scene: Scene, tmp_path: Path
) -> None:
    """Caches of a side may be let go and made anew while its bake is at work: pictures of the new
    ones go on.
    """
    baker: Any = FakeBaker()
    told: list[tuple[Caches, Any]] = []
    monkeypatch.setattr(Caches, "refresh", lambda self, *given: told.append((self, given)))
    bakes = SideBakes(baker, Store("memory://projected"), 0)
    former, latter = (
        Caches(PreparedScene(scene), tmp_path, 1 << 20, makes=False) for _ in range(2)
    )
    names = {
        bakes.side("a", "gi", Stage((), Goal(0.3), caches=each), share_nothing)
        for each in (former, latter)
    }
    assert len(names) == len(baker.bakes) == 1
    baker.bakes[names.pop()].arrived((0, 0, 0))
    assert told == [(latter, ("gi", (0, 0, 0), None))]


def test_light_is_trimmed_when_an_isovalue_is_new(monkeypatch: pytest.MonkeyPatch) -> None:
    baker: Any = FakeBaker()
    store = Store("memory://projected")
    trimmed = []
    monkeypatch.setattr(room, "trim_projected", lambda *given: trimmed.append(given))
    bakes = SideBakes(baker, store, 7)
    for shown in (0.25, 0.25, 0.5):
        bakes.name("a", shown, 0, lambda: None)  # type: ignore[arg-type, return-value]
        bakes.settle()
    assert trimmed == [(store, 7)] * 2


@pytest.mark.slow
def test_a_view_at_rest_has_projected_texels(engine: RenderEngine, scene: Scene) -> None:
    news = []
    engine.listen(lambda bake, index, more: news.append((bake, index)))
    frame = engine.frame(scene.id, view_of(scene), wait=LONG)
    assert not frame.provisional and frame.quality.projection
    shares = frame.quality.projection.shares
    assert shares["projected"] > 0.2 and shares["pending"] == 0.0
    assert {bake for bake, _ in news} == {scene.id}, (
        "who waits for the scene's light hears of projected texels too"
    )
    assert engine.lacking(scene.id, frame)[1].demands == () == frame.stages
    assert projection_header(shares).startswith(f"projected={shares['projected']:.3f}, near=")
    whole = planes(frame, 0, frame.view.height)
    assert (whole[..., 4] == frame.reported_state).all()
    shown = scene.volume.normalise_isovalue(scene.isovalue)
    layers = {
        scene.layer_digest(layer, level) for layer in scene.plan.layers for level in (None, shown)
    }
    assert set(census_of(engine.store).counts) == layers


@pytest.mark.slow
def test_projected_texels_have_a_bake_and_a_time_left(engine: RenderEngine, scene: Scene) -> None:
    view = view_of(scene)
    name = scene.id
    goal = Goal.checked(scene.target_error)
    while (frame := engine.survey(name, view, goal)).stages[0].shown is None:
        assert engine.lacking(name, frame)[0] == name and frame.stages[0].goal.error >= goal.error
        engine.want(name, frame, goal, GUEST_VIEWER)
        time.sleep(0.01)
    bake, stage = engine.lacking(name, frame)
    assert frame.provisional and frame.quality.projection and bake != name
    assert (
        places_of(stage.demands) == places_of(frame.quality.projection.demands) != []
        and stage.goal.error == goal.error
    )
    moving = engine.survey(name, replace(view, moving=True), goal)
    assert engine.lacking(name, moving)[0] == name and moving.quality.projection is None
    final = engine.frame(name, view, wait=LONG)
    left = engine.time_left(name, final)
    assert not final.provisional and left is not None and left.high == 0.0


def places_of(demands: tuple[Demand, ...]) -> list[tuple[Index, bytes]]:
    return [(demand.index, demand.offsets.tobytes()) for demand in demands]


@pytest.mark.slow
def test_light_that_is_replaced_is_not_brought_to_the_target(
    engine: RenderEngine, scene: Scene
) -> None:
    """Light on texels' own isosurfaces that only stands in stays as it is."""
    view = view_of(scene)
    strict = Goal.checked(0.025)
    lazy = engine.frame(scene.id, view, goal=strict, wait=LONG)
    assert not lazy.provisional and lazy.quality.projection
    wanted = lazy.quality.projection.reading.wanted
    base = lazy.quality.projection.reading.base
    assert wanted.any() and (base.grade[~wanted] >= FINAL).all()
    assert base.samples[wanted].max() == FIRST_LEVEL


@pytest.mark.slow
def test_a_store_keeps_a_bounded_part_of_them(
    engine: RenderEngine, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = [scene.isovalue, 1.2 * scene.isovalue]
    for isovalue in levels:
        engine.frame(scene.id, view_of(scene, isovalue=isovalue), wait=LONG)
    store = Store(engine.store.url)
    kept = {
        digest
        for digest, count in census_of(store).counts.items()
        if count.facts.attributes["shown"] is not None
    }
    assert len(kept) == 2 * len(scene.plan.layers)
    assert trim_projected(store, 0) == 0, "it was written just now"
    monkeypatch.setattr(pruning, "BUSY_SECONDS", -1.0)
    assert trim_projected(store, 1 << 40) == 0
    assert trim_projected(store, 0) == len(kept)
    left = census_of(store).counts
    assert set(left) == {scene.layer_digest(layer) for layer in scene.plan.layers}
    again = engine.frame(scene.id, view_of(scene, isovalue=levels[0]), wait=LONG)
    assert not again.provisional
