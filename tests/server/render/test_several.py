"""Several surfaces, and rooms, in an engine: the light of every side that is seen, and walls that
lag.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from queue import Queue
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import ReportError
from isogi_core.frame.frame import Frame
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_report.bench import Bench
from isogi_server.answers import scene_schema
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine
from isogi_server.render.picture_checks import CHECK
from isogi_worker.bake_requests import GUEST_VIEWER
from tests.server.inline import LONG

HALO = {"isovalue": 0.012, "clear": 0.6, "albedo": [0.4, 0.6, 0.9], "name": "halo"}
SCENE = {
    "surfaces": [HALO],
    "isovalue": 0.06,
    "bounces": 1,
    "target_error": 0.2,
    "projected": False,
}


@pytest.fixture
def make(tmp_path: Path, inline: None) -> Iterator[Callable[..., RenderEngine]]:
    """Make engines of an orbital over one store, with a worker on a thread of this process if
    ``with_workers``.
    """
    with ExitStack() as engines:

        def make(with_workers: bool, **settings: Any) -> RenderEngine:
            scene = load_scene("demo:orbital", **settings)
            engine = engines.enter_context(
                closing(RenderEngine([scene], tmp_path / "store", workers=1))
            )
            engine.start(with_workers)
            return engine

        yield make


@pytest.mark.slow
def test_workers_bake_all_sides_and_a_restart_finds_them(make: Callable[..., RenderEngine]) -> None:
    engine = make(True, **SCENE)
    scene = engine.scenes["orbital"]
    view = View(0.06, scene.camera(40.0, 20.0, 3.0, 30.0), width=24, height=24)
    heard: list[str] = []
    engine.listen(lambda bake, index, more: heard.append(bake))
    goal = Goal.checked(scene.target_error)
    frame = awaited(engine, "orbital", view, goal, 240.0)
    assert parts_of(frame) and frame.final
    assert len(parts_of(frame)) > 2 and set(heard) == {"orbital"}
    engine.close()
    other = make(False, **SCENE)
    again = other.survey("orbital", view, goal)
    assert not again.provisional and other.baker.paths == 0
    assert (again.radiance == frame.radiance).all() or again.traced_pixels != frame.traced_pixels


def test_the_document_of_a_scene_tells_its_surfaces() -> None:
    told = scene_schema(load_scene("demo:orbital", clear=0.25, **SCENE)).model_dump()
    assert told["surfaces"] == [
        {**HALO, "albedo": (0.4, 0.6, 0.9), "transmission": (0.0, 0.0, 0.0)}
    ]
    assert told["clear"] == 0.25 and told["rotating"] is True and told["turn_step"] == 5.0


def test_a_report_of_several_surfaces_is_refused(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", **SCENE)
    with pytest.raises(ReportError, match="path_traced"):
        Bench(scene, View(0.06, scene.camera(40.0, 20.0, 3.0, 30.0)), tmp_path)


def coarse(frame: Frame) -> bool:
    """Whether walls in a frame are provisional."""
    return bool((frame.state.ravel()[frame.gbuffer.walls.pixels] == PROVISIONAL).any())


def test_walls_are_lit_beside_texels(make: Callable[..., RenderEngine]) -> None:
    """A view asks for both at once: its walls are fine before anybody bakes."""
    engine = make(False, room="cornell", bounces=1, target_error=0.2, projected=False)
    scene = engine.scenes["orbital"]
    camera = scene.camera(90.0, 0.0, 4.0, 30.0)
    goal = Goal.checked(scene.target_error)
    view = View(scene.isovalue, camera, width=24, height=24)
    heard: Queue[tuple[tuple[int, ...], bool]] = Queue()
    engine.listen(lambda bake, index, more: heard.put((index, more)))
    first = engine.survey("orbital", view, goal)
    assert coarse(first) and first.demands
    wanted = {demand.index for demand in first.demands}
    assert engine.want("orbital", first, goal, GUEST_VIEWER) == wanted | {CHECK}
    while heard.get(timeout=LONG) != (CHECK, False):
        pass
    second = engine.survey("orbital", view, goal)
    assert not coarse(second) and second.demands and engine.baker.paths == 0
    assert engine.want("orbital", second, goal, GUEST_VIEWER) == wanted
    engine.start_workers()
    frame = awaited(engine, "orbital", view, goal, LONG)
    assert frame.final and not frame.quality.waiting
