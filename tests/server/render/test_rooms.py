"""Rooms in a server's engine: walls that lag are lit while workers bake the surface's light."""

from collections.abc import Iterator
from pathlib import Path
from queue import Queue

import pytest

from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from server.cli.render import awaited
from server.render.bakes import CHECK
from server.render.engine import RenderEngine
from tests.server.inline import LONG
from worker.bake_requests import GUEST_VIEWER


@pytest.fixture
def engine(tmp_path: Path, inline: None) -> Iterator[RenderEngine]:
    """The engine of an orbital in a Cornell room, that has hired nobody."""
    settings = {"room": "cornell", "bounces": 1, "target_error": 0.2, "projected": False}
    engine = RenderEngine([load_scene("demo:orbital", **settings)], tmp_path / "store", workers=1)
    engine.start(hire=False)
    yield engine
    engine.close()


def coarse(frame: Frame) -> bool:
    """Whether walls in a frame are provisional."""
    return bool((frame.state.ravel()[frame.gbuffer.walls.pixels] == PROVISIONAL).any())


def test_walls_are_lit_beside_texels(engine: RenderEngine) -> None:
    """A view asks for both at once: its walls are fine before anybody bakes."""
    scene = engine.scenes["orbital"]
    camera, target = scene.camera(90.0, 0.0, 4.0, 30.0), scene.target_error
    view = View(scene.isovalue, camera, width=24, height=24)
    heard: Queue[tuple[tuple[int, ...], bool]] = Queue()
    engine.listen(lambda bake, index, more: heard.put((index, more)))
    first = engine.survey("orbital", view, target)
    assert coarse(first) and first.demands
    wanted = {demand.index for demand in first.demands}
    assert engine.want("orbital", first, target, GUEST_VIEWER) == wanted | {CHECK}
    while heard.get(timeout=LONG) != (CHECK, False):
        pass
    second = engine.survey("orbital", view, target)
    assert not coarse(second) and second.demands and engine.baker.paths == 0
    assert engine.want("orbital", second, target, GUEST_VIEWER) == wanted
    engine.hire()
    frame = awaited(engine, "orbital", view, None, LONG)
    assert frame.final and not frame.quality.waiting
