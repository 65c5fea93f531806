"""Several surfaces in a server's engine: workers bake the light of every side that is seen."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from isogi_core.errors import ReportError
from isogi_core.frame.several.composer import parts_of
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_report.bench import Bench
from server.answers import scene_schema
from server.cli.render import awaited
from server.render.engine import RenderEngine

HALO = {"isovalue": 0.012, "clear": 0.6, "albedo": [0.4, 0.6, 0.9], "name": "halo"}
SCENE = {"surfaces": [HALO], "isovalue": 0.06, "bounces": 1, "target_error": 0.2, "projected": False}


@pytest.fixture
def make(tmp_path: Path, inline: None) -> Iterator[Callable[..., RenderEngine]]:
    """Make engines over one store, with a worker to ``hire``, on a thread of this process, or without."""
    made: list[RenderEngine] = []

    def _engine(hire: bool) -> RenderEngine:
        made.append(RenderEngine([load_scene("demo:orbital", **SCENE)], tmp_path / "store", workers=1))
        made[-1].start(hire)
        return made[-1]

    yield _engine
    for each in made:
        each.close()


@pytest.mark.slow
def test_workers_bake_all_sides_and_a_restart_finds_them(make: Callable[..., RenderEngine]) -> None:
    engine = make(hire=True)
    scene = engine.scenes["orbital"]
    view = View(0.06, scene.camera(40.0, 20.0, 3.0, 30.0), width=24, height=24)
    heard: list[str] = []
    engine.listen(lambda bake, index, more: heard.append(bake))
    frame = awaited(engine, "orbital", view, None, 240.0)
    assert parts_of(frame) and frame.final
    assert len(parts_of(frame)) > 2 and set(heard) == {"orbital"}
    engine.close()
    other = make(hire=False)
    again = other.survey("orbital", view, scene.target_error)
    assert not again.provisional and other.baker.paths == 0
    assert (again.radiance == frame.radiance).all() or again.quality.own != frame.quality.own


def test_the_document_of_a_scene_tells_its_surfaces() -> None:
    told = scene_schema(load_scene("demo:orbital", clear=0.25, **SCENE)).model_dump()
    assert told["surfaces"] == [{**HALO, "albedo": (0.4, 0.6, 0.9), "transmission": (0.0, 0.0, 0.0)}]
    assert told["clear"] == 0.25 and told["rotating"] is False


def test_a_report_of_several_surfaces_is_refused(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", **SCENE)
    with pytest.raises(ReportError, match="path_traced"):
        Bench(scene, View(0.06, scene.camera(40.0, 20.0, 3.0, 30.0)), tmp_path)
