"""Prewarms go by the measured error of pictures: they bake what a server would for the views, and
nothing more.
"""

import asyncio
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.reachable_texels import surface_texels
from isogi_server.api import prewarm_jobs
from isogi_server.api.prewarm_jobs import Prewarm
from isogi_server.cli import prewarm as command
from isogi_server.cli.prewarm import prewarm
from isogi_server.prewarm.baking import PrewarmContext, Step
from isogi_server.prewarm.order import Views, order_of
from isogi_server.prewarm.record import Record, Summary
from isogi_server.prewarm.work import Pictures, Seen
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from tests.baking import bake_each_texel
from tests.server.inline import LONG, PATHS_ALONE, chunks_in, weigh_at

TARGET = 0.005
VIEWS: dict[str, Any] = {"isovalues": [0.5], "views": 3, "width": 40, "height": 32}
WHOLE: dict[str, Any] = {"isovalues": ["0.5"], "all_directions": True}
RANGE: dict[str, Any] = WHOLE | {"isovalues": ["0.49:0.51"]}


@dataclass(frozen=True)
class Warm:
    """A store that was warmed for an order: how that ended, and the steps that were shown."""

    store: Path
    summary: Summary
    steps: list[Step]


pytestmark = pytest.mark.usefixtures("all_inline")


@pytest.fixture(scope="module")
def lit(blocks: Path) -> Path:
    """The scene whose pictures need more than first light: a sky, and a target that 16 samples do
    not reach.
    """
    path = blocks.with_name("lit.toml")
    dim = (
        blocks.read_text()
        .replace('"constant"', '"sky"')
        .replace("error = 0.1", f"error = {TARGET}")
    )
    path.write_text(dim)
    return path


@pytest.fixture(scope="module")
def viewed(lit: Path, all_inline: None, tmp_path_factory: pytest.TempPathFactory) -> Warm:
    """The store that is warmed for VIEWS."""
    return watched(lit, tmp_path_factory.mktemp("viewed"), VIEWS)


@pytest.fixture(scope="module")
def whole(lit: Path, all_inline: None, tmp_path_factory: pytest.TempPathFactory) -> Warm:
    """The store that is warmed for WHOLE."""
    return watched(lit, tmp_path_factory.mktemp("whole"), WHOLE)


def watched(scene: Path, store: Path, order: dict[str, Any]) -> Warm:
    """Warm a store, and keep what is shown meanwhile."""
    steps: list[Step] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "show", lambda _, step: steps.append(step))
        return Warm(store, warmed(scene, store, order), steps)


@contextmanager
def engine_of(scene: Path, store: Path, with_workers: bool) -> Iterator[RenderEngine]:
    with closing(RenderEngine([load_scene(scene)], str(store), workers=1)) as engine:
        engine.start(with_workers=with_workers)
        yield engine


def views_of(scene: Path, order: dict[str, Any]) -> list[View]:
    return list(Views(order_of(order), load_scene(scene), Settings()))


def warmed(scene: Path, store: Path, order: dict[str, Any]) -> Summary:
    return prewarm(str(scene), order_of(order), Settings(store=str(store), workers=1))


def rungs_in(scene: Path, store: Path, low: float, high: float) -> np.ndarray:
    """The samples of all lit texels of the isosurfaces from one isovalue to another."""
    with engine_of(scene, store, with_workers=False) as engine:
        renderer = engine.renderer(scene.stem)
        prepared = renderer.prepared
        volume = renderer.prepared.scene.volume
        ends = volume.normalise_isovalue(low), volume.normalise_isovalue(high)
        found = []
        for index, offsets in surface_texels(
            volume.voxels, prepared.shape, prepared.lattice.chunk, [ends]
        ):
            chunk = renderer.caches.chunk_store("gi").read(index)
            assert chunk is not None
            light = chunk.with_texels(offsets).light.rows(
                chunk.with_texels(offsets).rows_of(offsets)
            )
            found.append(light.samples[~light.void])
    return np.concatenate(found)


def test_a_prewarm_bakes_what_serving_the_view_would(
    lit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weigh_at(PATHS_ALONE, monkeypatch)
    one = VIEWS | {"views": 1, "width": 160, "height": 128, "target_error": 0.004}
    summary = warmed(lit, tmp_path / "warmed", one)
    (view,) = views_of(lit, one)
    with engine_of(lit, tmp_path / "served", with_workers=True) as engine:
        frame = engine.frame("lit", view, goal=Goal.checked(0.004), wait=LONG)
        assert frame.final
    assert chunks_in(tmp_path / "warmed") == chunks_in(tmp_path / "served")
    assert summary.paths > FIRST_LEVEL * summary.texels > 0
    assert summary.error == pytest.approx(frame.total.likely)


def test_views_are_final_without_a_texel_baked(lit: Path, viewed: Warm, tmp_path: Path) -> None:
    summary = viewed.summary
    views = views_of(lit, VIEWS)
    kept = chunks_in(viewed.store)
    assert (summary.final, summary.stopped) == (1.0, "target")
    with engine_of(lit, viewed.store, with_workers=False) as engine:
        for view in views:
            frame = engine.frame("lit", view, wait=LONG)
            assert frame.final and not frame.stages
            assert frame.measured is not None and frame.measured.high <= TARGET
    assert warmed(lit, viewed.store, VIEWS).paths == 0
    assert chunks_in(viewed.store) == kept
    with engine_of(lit, tmp_path / "each", with_workers=True) as engine:
        for view in views:
            bake_each_texel(engine, "lit", view)
        assert summary.paths < 0.7 * engine.baker.paths


def test_whole_isosurfaces_have_the_samples_pictures_need(lit: Path, whole: Warm) -> None:
    summary = whole.summary
    rungs = rungs_in(lit, whole.store, 0.5, 0.5)
    assert (summary.final, summary.stopped) == (1.0, "target") and summary.errors.worst <= TARGET
    assert FIRST_LEVEL < rungs.min() <= rungs.max(), "those with fewer are good enough alone"
    assert summary.texels >= len(rungs) and summary.paths >= rungs.sum()
    with engine_of(lit, whole.store, with_workers=False) as engine:
        for view in views_of(lit, VIEWS):
            assert engine.frame("lit", view, wait=LONG).final
    assert warmed(lit, whole.store, WHOLE).paths == 0


def test_ranges_have_the_samples_that_their_ends_need(lit: Path, tmp_path: Path) -> None:
    summary = warmed(lit, tmp_path, RANGE)
    rungs = rungs_in(lit, tmp_path, 0.49, 0.51)
    assert (summary.final, summary.stopped) == (1.0, "target") and summary.errors.mean <= TARGET
    assert FIRST_LEVEL < rungs.min() <= rungs.max()
    assert warmed(lit, tmp_path, RANGE).paths == 0


def test_the_rung_of_whole_isosurfaces_is_recorded(lit: Path, whole: Warm, tmp_path: Path) -> None:
    store = shutil.copytree(whole.store, tmp_path / "store")
    rung = int(rungs_in(lit, store, 0.5, 0.5).max())
    record = Record(str(store), load_scene(lit), order_of(WHOLE), "command")
    context = SimpleNamespace(rung=0)
    record.follow(context)  # type: ignore[arg-type]
    assert context.rung == record.document.rung == rung
    context.rung_rose(2 * rung)
    record.follow(context)  # type: ignore[arg-type]
    assert context.rung == 2 * rung


def test_checks_end_with_the_deadline(
    lit: Path, viewed: Warm, monkeypatch: pytest.MonkeyPatch
) -> None:
    check = RenderEngine.check
    taken = list[float]()

    def slow(engine: RenderEngine, *what: Any, **how: Any) -> bool:
        taken.append(time.monotonic())
        time.sleep(0.3)
        return check(engine, *what, **how)

    monkeypatch.setattr(RenderEngine, "check", slow)
    summary = warmed(lit, viewed.store, VIEWS | {"deadline": 0})
    assert (summary.stopped, summary.paths, taken) == ("deadline", 0, [])
    assert summary.final < 1.0


def test_a_check_can_be_cancelled_and_yields(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def check(*what: Any) -> bool:
        asked.append(what)
        time.sleep(0.05)
        return True

    engine = SimpleNamespace(check=check, store="")
    service: Any = SimpleNamespace(engine=engine, attended=False, settings=Settings())
    scene: Any = SimpleNamespace(id="a scene", target_error=0.1)
    work = Prewarm(service, scene, order_of({}), recorded=False)
    rests: list[float] = []
    monkeypatch.setattr(work.cancelled, "wait", rests.append)
    over = threading.Event()
    step: Any = ("a view", PATHS_ALONE, over)

    def carry_out(context: PrewarmContext, *_: Any) -> SimpleNamespace:
        assert context.refine(*step) and not rests
        service.attended = True
        assert context.refine(*step) and rests[0] >= 0.05
        return SimpleNamespace(failures=())

    monkeypatch.setattr(prewarm_jobs, "carry_out", carry_out)
    monkeypatch.setattr(prewarm_jobs, "wanted", lambda *_: None)
    asyncio.run(work.carry_out(lambda *_: None))
    goal = Goal.checked(0.1)
    assert asked == [("a scene", "a view", goal, work.cancelled, PATHS_ALONE, over)] * 2


def test_a_check_ends_with_the_time() -> None:
    """A step that would go on is cancelled, and the picture taken as it was before."""

    def refine(view: str, prices: Prices, over: threading.Event) -> bool:
        assert over.wait(30.0), "a step that nobody ends"
        raise Cancelled("Time is over.")

    facts = {"surface": 8, "counts": {"final": 2}, "total": SimpleNamespace(likely=0.1)}
    quality = SimpleNamespace(finer=None, lacking=None)
    frame = SimpleNamespace(
        checkable=True, goes_without_texels=False, stages=(), quality=quality, **facts
    )
    context: Any = SimpleNamespace(
        frame_of=lambda view: frame,
        refine=refine,
        late=lambda end: time.monotonic() >= end,
        check=lambda: None,
        report=lambda step: None,
    )
    views: Any = ["a view"]
    pictures = Pictures(context, views, sample=False, rung=FIRST_LEVEL)
    pictures.look((0.0, 1.0), time.monotonic() + 0.2)
    assert pictures.seen == {0: Seen(8, 2, 0.1)} and pictures.waiting == {0}


@pytest.mark.parametrize("order", ["viewed", "whole"])
def test_progress_never_goes_back(request: pytest.FixtureRequest, order: str) -> None:
    steps: list[Step] = request.getfixturevalue(order).steps
    shares = [step.share for step in steps]
    assert shares == sorted(shares) and shares[0] >= 0.0 and shares[-1] <= 1.0
    baking = [step for step in steps if step.what == "Baking"]
    assert len({step.total for step in baking}) >= 1 and all(
        step.left is not None for step in baking
    )
    rounds = sum(step.done == 0 for step in baking)
    assert rounds >= 2, "one for each rung"


AT = {"azimuth": 30, "elevation": 20}

COARSE = """\
volume = "demo:casting"
lattice = 0.125
bounces = 1
projected = false
target_error = 0.05
[[lights]]
type = "constant"
"""

SEVERAL = "[[surfaces]]\nisovalue = 0.7\nclear = 0.5\n[[lights]]"


@pytest.mark.slow
def test_finer_texels_are_prewarmed_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weigh_at(Prices(0.25, 0.0, 0.0), monkeypatch)
    scene = tmp_path / "coarse.toml"
    order = {"directions": [AT], "distance": 3.0, "width": 128, "height": 128}
    scene.write_text(COARSE)
    summary = warmed(scene, tmp_path / "light", order)
    assert (summary.final, summary.stopped) == (1.0, "target") and summary.error <= 0.05
    (view,) = views_of(scene, order)
    with engine_of(scene, tmp_path / "light", with_workers=False) as engine:
        frame = engine.frame("coarse", view, wait=LONG)
        assert frame.final and frame.quality.fineness > 0
    assert warmed(scene, tmp_path / "light", order).paths == 0


@pytest.mark.slow
def test_all_sides_of_several_surfaces_are_prewarmed(blocks: Path, tmp_path: Path) -> None:
    scene = blocks.with_name("several.toml")
    scene.write_text(blocks.read_text().replace("[[lights]]", SEVERAL))
    summary = warmed(scene, tmp_path, VIEWS)
    views = views_of(scene, VIEWS)
    assert (summary.final, summary.stopped) == (1.0, "target")
    with engine_of(scene, tmp_path, with_workers=False) as engine:
        for view in views:
            frame = engine.frame("several", view, wait=LONG)
            assert frame.final and not frame.stages
    assert warmed(scene, tmp_path, VIEWS).paths == 0
