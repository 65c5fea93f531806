"""Finer texels where control pixels ask for them: baked, shown once they are final, and left where
there is no room.
"""

from dataclasses import replace
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.cache.costs import Cost
from isogi_core.cache.upkeep import census_of
from isogi_core.errors import NoRoomError
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import finer
from isogi_server.api.headers import refined_header
from isogi_server.render.engine import RenderEngine
from isogi_worker.bake_requests import GUEST_VIEWER
from isogi_worker.progress import TimeLeft
from tests.server.inline import LONG, weigh_at
from tests.server.inline import view_of as small_view_of

TARGET = 0.05


def view_of(scene: Scene) -> View:
    """A view of many more pixels than texels."""
    return replace(small_view_of(scene), width=128, height=128)


FREE = Prices(0.25, 0.0, 0.0)


@pytest.fixture(autouse=True)
def free(monkeypatch: pytest.MonkeyPatch) -> None:
    """No price for opening finer texels: small pictures would not pay it."""
    weigh_at(FREE, monkeypatch)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """So few texels that light between them is wrong by far more than its noise."""
    constant = [{"type": "constant"}]
    return load_scene(
        "demo:casting",
        lights=constant,
        lattice=0.125,
        bounces=1,
        projected=False,
        target_error=TARGET,
    )


@pytest.mark.slow
def test_a_view_that_asks_for_finer_texels_has_them(engine: RenderEngine, scene: Scene) -> None:
    """Of so few texels they cost less than light for each pixel."""
    news = set()
    engine.listen(lambda bake, index, more: news.add(bake))
    frame = engine.frame(scene.id, view_of(scene), wait=LONG)
    assert frame.final and frame.quality.fineness > 0 and frame.quality.finer is None
    assert refined_header(frame).startswith(f"texels={2**frame.quality.fineness}, pixels=0.")
    assert news == {scene.id}, "who waits for the scene's light hears of finer texels too"
    better = finer(scene)
    assert {better.layer_digest(layer) for layer in better.plan.layers} <= set(
        census_of(engine.store).counts
    )


def test_what_is_coming_is_asked_for_and_not_shown(engine: RenderEngine, scene: Scene) -> None:
    view = view_of(scene)
    goal = Goal.checked(scene.target_error)
    while (frame := engine.survey(scene.id, view, goal)).quality.finer is None:
        assert not engine.frame(scene.id, view, wait=0.01).final
    bake, stage = engine.lacking(scene.id, frame)
    demands = stage.demands
    assert bake != scene.id and demands == frame.quality.finer.stages[0].demands != ()
    assert (
        frame.quality.fineness == 0 and not frame.final and not frame.checkable and frame.measured
    )
    assert frame.measured.low > goal.error
    assert engine.want(scene.id, frame, goal, GUEST_VIEWER) == {demand.index for demand in demands}


def test_paths_are_priced_by_the_texels_that_are_shown(
    engine: RenderEngine, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chunk of finer texels is another place than one of the same number of coarse ones."""
    view = view_of(scene)
    goal = Goal.checked(scene.target_error)
    shown = engine.survey(scene.id, view, goal)
    coming = replace(shown, quality=replace(shown.quality, fineness=1))
    frame = replace(shown, quality=replace(shown.quality, finer=coming))
    asked = []

    def spent(bake: str, chunks: Any) -> Cost:
        asked.append((bake, tuple(chunks)))
        return Cost(1.0, 100)

    monkeypatch.setattr(engine.baker, "spent", spent)
    monkeypatch.setattr(engine.baker, "time_left", lambda *_: TimeLeft(1.0, 2.0, 3.0))
    lacks = engine.unfinished(scene.id, frame, goal)
    assert lacks.bake != engine.bake_of(scene.id, view)
    assert engine.time_without(lacks) is not None
    assert asked == [(engine.bake_of(scene.id, view), lacks.parts[0][0].chunks)]


def test_without_room_for_them_pixels_get_light_of_their_own(
    engine: RenderEngine, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Renderer.render

    def render(self: Renderer, *given: Any) -> Frame:
        if self.prepared.scene.settings.lattice > 0.125:
            raise NoRoomError("The light of a view does not fit.")
        return plain(self, *given)

    monkeypatch.setattr(Renderer, "render", render)
    frame = engine.frame(scene.id, view_of(scene), wait=LONG)
    assert frame.final and frame.quality.fineness == 0 and 0 < frame.traced_pixels <= frame.surface


def test_where_few_pixels_err_they_get_light_of_their_own(
    engine: RenderEngine, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    weigh_at(FREE.of_present, monkeypatch)
    frame = engine.frame(scene.id, view_of(scene), wait=LONG)
    assert frame.final and frame.quality.fineness == 0 and frame.traced_pixels > 0
    assert not engine.lacking(scene.id, frame)[1].demands
