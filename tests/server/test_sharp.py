"""Sharp bakes: taken on when they are asked for, the oldest forgotten; and a studio that sharpens views at rest."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from isogi_core.cache import pruning
from isogi_core.cache.census import census_of
from isogi_core.cache.root import Root
from isogi_core.cache.trimming import trim_sharp
from isogi_core.frame import sharpening
from isogi_core.model.scene import Scene, load_scene
from server import sharp as sharps
from server.headers import sharp_header
from server.pictures import planes
from server.sharp import SharpBakes
from server.studio import Studio
from tests.server.inline import LONG, InlinePool, view_of
from worker import pool
from worker.viewers import GUEST

Open = Callable[..., Studio]


class FakeBaker:
    """Takes on bakes and forgets them."""

    def __init__(self) -> None:
        self.bakes: dict[str, Any] = {}

    def add(self, name: str, bake: Any) -> None:
        self.bakes[name] = bake

    def forget(self, name: str) -> None:
        del self.bakes[name]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)
    monkeypatch.setattr(sharpening, "STEEPNESS", 2.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:orbital", lattice=0.5, bounces=1, target_error=0.3, sharpen=True)


@pytest.fixture
def begin(scene: Scene, tmp_path: Path) -> Iterator[Open]:
    """Begins a studio on the store; it is closed when the test ends."""
    begun: list[Studio] = []

    def begin(**more: Any) -> Studio:
        begun.append(Studio([scene], str(tmp_path / "light"), **more))
        begun[-1].start()
        return begun[-1]

    yield begin
    for studio in begun:
        studio.close()


def test_a_bake_is_made_once_and_the_oldest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharps, "MOST", 2)
    baker: Any = FakeBaker()
    bakes = SharpBakes(baker, lambda: None)
    made: list[float] = []

    def name(scene: str, shown: float) -> str:
        return bakes.name(scene, shown, lambda: made.append(shown))  # type: ignore[arg-type, func-returns-value]

    first, second = name("a", 0.25), name("b", 0.25)
    assert first != second and name("a", 0.25) == first
    third = name("a", 0.5)
    assert list(baker.bakes) == [first, third] and made == [0.25, 0.25, 0.5]
    assert (bakes.scene(first), bakes.scene(third), bakes.scene("b")) == ("a", "a", "b")
    bakes.forget("a")
    assert not baker.bakes and bakes.scene(first) == first


def test_light_is_trimmed_when_an_isovalue_is_new() -> None:
    baker: Any = FakeBaker()
    trimmed: list[int] = []
    bakes = SharpBakes(baker, lambda: trimmed.append(1))
    for shown in (0.25, 0.25, 0.5):
        bakes.name("a", shown, lambda: None)  # type: ignore[arg-type, return-value]
        bakes.settle()
    assert len(trimmed) == 2


def test_a_view_at_rest_is_sharpened(begin: Open, scene: Scene) -> None:
    studio, news = begin(), []
    studio.listen(lambda bake, index, more: news.append((bake, index)))
    frame = studio.frame(scene.id, view_of(scene), wait=LONG)
    assert not frame.provisional and frame.sharpness
    shares = frame.sharpness.shares
    assert shares["moved"] > 0.2 and shares["pending"] == 0.0
    assert {bake for bake, _ in news} == {scene.id}, "who waits for the scene's light hears of sharp light too"
    assert studio.lacking(scene.id, frame) == (scene.id, ())
    assert sharp_header(shares).startswith(f"moved={shares['moved']:.3f}, near=")
    whole = planes(frame, 0, frame.view.height)
    assert (whole[..., 4] == frame.told).all()
    shown = scene.volume.normalise_isovalue(scene.isovalue)
    layers = {scene.layer_digest(layer, level) for layer in scene.plan.layers for level in (None, shown)}
    assert set(census_of(studio.root).counts) == layers


def test_sharp_light_has_a_bake_of_its_own_and_time_left(begin: Open, scene: Scene) -> None:
    studio = begin()
    view, name, target = view_of(scene), scene.id, scene.target_error
    while (frame := studio.survey(name, view, target)).demands:
        assert studio.lacking(name, frame) == (name, frame.demands)
        studio.want(name, frame.unsharpened, target, GUEST)
        time.sleep(0.01)
    bake, demands = studio.lacking(name, frame)
    assert frame.provisional and frame.sharpness
    assert bake != name and demands == frame.sharpness.demands != ()
    assert studio.lacking(name, frame.unsharpened) == (name, ())
    final = studio.frame(name, view, wait=LONG)
    left = studio.time_left(name, final)
    assert not final.provisional and left is not None and left.high == 0.0


def test_a_store_keeps_a_bounded_part_of_sharp_light(
    begin: Open, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    studio = begin()
    levels = [scene.isovalue, 1.2 * scene.isovalue]
    for isovalue in levels:
        studio.frame(scene.id, view_of(scene, isovalue=isovalue), wait=LONG)
    root = Root(studio.root.place)
    kept = {digest for digest, count in census_of(root).counts.items() if count.facts.attributes["shown"] is not None}
    assert len(kept) == 2 * len(scene.plan.layers)
    assert trim_sharp(root, 0) == 0, "it was written just now"
    monkeypatch.setattr(pruning, "BUSY", -1.0)
    assert trim_sharp(root, 1 << 40) == 0
    assert trim_sharp(root, 0) == len(kept)
    left = census_of(root).counts
    assert set(left) == {scene.layer_digest(layer) for layer in scene.plan.layers}
    again = studio.frame(scene.id, view_of(scene, isovalue=levels[0]), wait=LONG)
    assert not again.provisional
