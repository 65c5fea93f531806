"""Adaptive scenes in a studio and in a prewarm: they become final, and less is baked for it."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from isogi_core.frame import shader
from isogi_core.model.scene import Scene, load_scene
from server.facts import plan_facts
from server.prewarm.command import prewarm
from server.prewarm.order import Views, order_of
from server.prewarm.summary import Summary
from server.settings import Settings
from server.studio import Studio
from tests.server.inline import LONG, InlinePool, view_of
from worker import pool

SCENE = """\
volume = "demo:orbital"
bounces = 1
target_error = 0.1
adaptive = {adaptive}
[[lights]]
type = "constant"
"""
ORDER = order_of({"views": 2, "width": 96, "height": 96})


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks are baked in this process, and about half of what views show asks for all texels."""
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)
    monkeypatch.setattr(shader, "COARSENESS", 0.5)


@pytest.fixture
def even(tmp_path: Path) -> Path:
    """The file of an adaptive scene."""
    return scene_file(tmp_path, True)


def scene_file(folder: Path, adaptive: bool) -> Path:
    path = folder / f"{'even' if adaptive else 'plain'}.toml"
    path.write_text(SCENE.format(adaptive=str(adaptive).lower()), encoding="utf-8")
    return path


def stored(store: Path) -> int:
    """Bytes of all chunks."""
    return sum(path.stat().st_size for path in store.glob("*/c/**/*") if path.is_file())


def warmed(path: Path, store: Path) -> Summary:
    return prewarm(str(path), ORDER, Settings(store=str(store), workers=1))


def provisional(scene: Scene, store: Path) -> list[bool]:
    """Of the views of ORDER."""
    with closing(Studio([scene], str(store))) as studio:
        studio.start(hire=False)
        return [studio.survey(scene.id, view, 0.1).provisional for view in Views(ORDER, scene, Settings())]


def test_a_view_becomes_final(even: Path, tmp_path: Path) -> None:
    scene = load_scene(even)
    assert plan_facts(scene).adaptive and not plan_facts(load_scene(scene_file(tmp_path, False))).adaptive
    with closing(Studio([scene], str(tmp_path / "light"))) as studio:
        studio.start()
        first = studio.frame(scene.id, view_of(scene))
        assert first.provisional and first.demands
        frame = studio.frame(scene.id, view_of(scene), wait=LONG)
        assert not frame.provisional and frame.demands == () and frame.chunks_final == frame.chunks_needed
        assert studio.trouble() == ""


def test_what_was_prewarmed_is_final_and_takes_less(even: Path, tmp_path: Path) -> None:
    store, whole = tmp_path / "light", tmp_path / "whole"
    dry = prewarm(str(even), ORDER, Settings(store=str(store), workers=1), dry=True)
    summary, all_of_it = warmed(even, store), warmed(scene_file(tmp_path, False), whole)
    assert (summary.final, summary.stopped) == (all_of_it.final, all_of_it.stopped) == (1.0, "target")
    assert dry.texels < summary.texels < all_of_it.texels, "what cells of two texels ask for comes on top"
    assert summary.paths > 0 and summary.stored_bytes == stored(store) < stored(whole)
    assert provisional(load_scene(even), store) == [False, False]
    assert provisional(load_scene(scene_file(tmp_path, False)), store) == [True, True]
    again = warmed(even, store)
    assert (again.paths, again.texels, again.final) == (0, 0, 1.0)


def test_a_prewarm_of_a_scene_that_sharpens_bakes_all_light_but_the_sharp(even: Path, tmp_path: Path) -> None:
    sharp = tmp_path / "sharp.toml"
    sharp.write_text("sharpen = true\n" + even.read_text(encoding="utf-8"), encoding="utf-8")
    store = tmp_path / "light"
    dry = prewarm(str(sharp), ORDER, Settings(store=str(store), workers=1), dry=True)
    summary = warmed(sharp, store)
    assert summary.texels > dry.texels > 0 and summary.stopped == "target"
    assert warmed(sharp, store).texels == 0, "though pixels wait for sharp light"


class Cursed(InlinePool):
    """A pool that cannot bake the first chunk that is asked for."""

    cursed: Any = None

    def submit(self, task: Any, done: Any) -> None:
        self.cursed = self.cursed or task.index
        if task.index == self.cursed:
            done(None, RuntimeError("The texels are cursed."))
        else:
            super().submit(task, done)


def test_a_chunk_that_fails_takes_nothing_from_the_others(
    even: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = warmed(even, tmp_path / "whole")
    monkeypatch.setattr(pool, "WorkerPool", Cursed)
    summary = warmed(even, tmp_path / "light")
    assert (summary.stopped, summary.failed) == ("failures", 1)
    assert 0.3 < summary.final < 1.0
    assert stored(tmp_path / "light") > 0.5 * stored(tmp_path / "whole")
    assert summary.texels > whole.texels / 2


def test_light_of_the_whole_lattice_serves_an_adaptive_scene(even: Path, tmp_path: Path) -> None:
    store = tmp_path / "light"
    warmed(scene_file(tmp_path, False), store)
    assert provisional(load_scene(even), store) == [False, False]
