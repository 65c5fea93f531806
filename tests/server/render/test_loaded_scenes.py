"""Scenes that share the memory: loaded when they are looked at, dropped for others, and the same
when they are back.
"""

import gc
import threading
import weakref
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from isogi_core.kernels._compilation import KernelProgress
from isogi_core.plan.scene import Scene
from isogi_server.errors import UnknownSceneError
from isogi_server.render import loaded_scene, scene_kernels
from isogi_server.render.engine import RenderEngine
from isogi_server.render.loaded_scene import LoadedScene, LoadedScenes
from isogi_server.render.scene_kernels import SceneKernels
from isogi_worker import pool
from tests.loaded import load_scene
from tests.server.inline import LONG, InlinePool, view_of

SMALL = 4 << 20
"""Bytes of memory that a view of one scene fits into, and those of two do not."""


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    """Two scenes under the same light, and one under its own."""
    settings: dict[str, Any] = {"lattice": 0.5, "bounces": 0, "target_error": 0.5}
    lights = [{"type": "constant", "radiance": 1.0}]
    own = load_scene("demo:orbital", lights=lights, **settings)
    return [load_scene("demo:orbital", **settings), load_scene("demo:casting", **settings), own]


@pytest.fixture
def engine(scenes: list[Scene], tmp_path: Path, inline: None) -> Iterator[RenderEngine]:
    """An engine in little memory that starts with one of the scenes."""
    with closing(RenderEngine(scenes[:1], str(tmp_path), memory=SMALL)) as engine:
        engine.start()
        yield engine


def test_scenes_under_the_same_light_share_it(scenes: list[Scene]) -> None:
    first, second, third = scenes
    assert (
        first.lighting.environment is second.lighting.environment is not third.lighting.environment
    )
    assert first.inputs.harmonics is second.inputs.harmonics


@pytest.mark.slow
@pytest.mark.long
def test_a_scene_makes_way_and_is_the_same_when_it_is_back(
    engine: RenderEngine, scenes: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other, _ = scenes
    loads: list[str] = []
    load = loaded_scene.load_scene_parts

    def watched(scene: Scene, *given: Any, **more: Any) -> LoadedScene:
        loads.append(scene.id)
        return load(scene, *given, **more)

    monkeypatch.setattr("isogi_server.render.engine.load_scene_parts", watched)
    engine.admit(other)
    assert not loads, "nobody has looked at it"
    first = engine.frame(one.id, view_of(one), wait=LONG)
    renderer = weakref.ref(engine.renderer(one.id))
    lacking = engine.frame(one.id, view_of(one, 120.0))
    engine.frame(other.id, view_of(other), wait=LONG)
    gc.collect()
    assert loads == [other.id] and renderer() is None
    bake, stage = engine.lacking(one.id, lacking)
    engine.bake(bake, stage).wait(LONG)
    again = engine.frame(one.id, view_of(one), wait=LONG)
    assert again.version == first.version and again.radiance.tobytes() == first.radiance.tobytes()
    assert loads == [other.id, one.id]
    assert not engine.frame(one.id, view_of(one, 120.0)).demands, (
        "light that came meanwhile is seen"
    )


def test_a_dismissed_scene_is_found_no_more(engine: RenderEngine, scenes: list[Scene]) -> None:
    one, other, _ = scenes
    engine.admit(other)
    engine.dismiss(other.id)
    for scene in (other.id, "nobody"):
        with pytest.raises(UnknownSceneError):
            engine.planned(scene)
    assert engine.planned(one.id).id == one.id


def test_a_server_tidies_after_frames_and_not_while_idle(
    scenes: list[Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tidied = threading.Semaphore(0)
    monkeypatch.setattr(pool, "start_pool", InlinePool)
    monkeypatch.setattr(loaded_scene, "TIDY_SECONDS", 0.01)
    monkeypatch.setattr(loaded_scene, "give_memory_back", tidied.release)
    with closing(RenderEngine(scenes[:1], str(tmp_path))) as engine:
        engine.start()
        assert tidied.acquire(timeout=LONG), "what loading left"
        assert not tidied.acquire(timeout=0.2)
        engine.frame(scenes[0].id, view_of(scenes[0], shading="lambert"))
        assert tidied.acquire(timeout=LONG)


def test_what_nobody_looks_at_is_dropped_and_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    trimmed = list[None]()
    monkeypatch.setattr(loaded_scene, "give_memory_back", lambda: trimmed.append(None))

    def load(scene: Any) -> Any:
        return SimpleNamespace(nbytes=10)

    kept = LoadedScenes(load, 1 << 20, lambda: now[0])
    first, second = (SimpleNamespace(id=name) for name in ("first", "second"))
    kept.at(first)  # type: ignore[arg-type]
    now[0] = 450.0
    kept.drop_idle()
    assert kept.held("first") is not None and not trimmed
    now[0] = 1500.0
    kept.at(second)  # type: ignore[arg-type]
    now[0] = 1800.0
    kept.drop_idle()
    assert kept.held("first") is None and kept.held("second") is not None
    assert len(trimmed) == 1
    assert kept.held("first") is None and kept.held("second") is not None


FAR = KernelProgress(1, 3, 4.0)


class Slow:
    """In place of a Compilation: nothing is compiled but what ``go`` lets go, of the one scene that
    is admitted.
    """

    go = threading.Event()
    waiting = threading.Event()

    def __init__(self, *stages: Iterable[Any]) -> None:
        self.begun = False

    def begin(self, _stopped: threading.Event, _niceness: int = 0) -> None:
        self.begun = True

    def wait(self, _kernels: Iterable[Any]) -> None:
        self.waiting.set()
        assert self.go.wait(LONG)

    def progress(self, kernels: Iterable[Any]) -> KernelProgress | None:
        assert list(kernels)
        if self.begun and not self.go.is_set():
            return FAR
        return None


def test_what_an_admitted_scene_lacks_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_kernels, "Compilation", Slow)
    monkeypatch.setattr(scene_kernels, "load", lambda *_: None)
    scene = load_scene("demo:orbital")
    known = SceneKernels(lambda: [scene], threading.Event())
    assert known.progress is None
    work = threading.Thread(target=known.admit, args=[scene])
    work.start()
    assert Slow.waiting.wait(LONG)
    assert known.progress == FAR
    assert known.compiling == "Compiling, once on this machine: 1 of 3, about 4 s left."
    Slow.go.set()
    work.join(LONG)
    assert known.progress is None and known.compiling == ""
