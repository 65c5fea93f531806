"""What is told of a prewarm before it is begun: what is rehearsed is what tasks do, and a sample
stands for all.
"""

import math
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.noise import Effort, Goal
from isogi_core.frame.demand import Demand
from isogi_core.frame.texel_reading import Stage
from isogi_core.plan.assembly import load_scene
from isogi_server.prewarm.baking import forecast, rehearse, stratified
from isogi_server.render.engine import RenderEngine
from isogi_worker import bake_requests
from isogi_worker.bake_requests import Viewer
from isogi_worker.progress import ChunkCost, extrapolated
from isogi_worker.tasks import BakeTask
from tests.server.inline import LONG, InlinePool, view_of


def demand(number: int, texels: int) -> Demand:
    offsets = np.arange(texels, dtype=np.int32)
    return Demand(
        (number, 0, 0), offsets, 1.0, Effort(texels, 0.0, 0.0), np.ones(texels, np.float32)
    )


def rehearsal(texels: int, seconds: float) -> ChunkCost:
    return ChunkCost(texels, seconds, seconds / 2, 0.0, 0.1, 3 * texels)


@pytest.mark.parametrize("long", [0.0, math.inf], ids=["in steps", "at once"])
def test_a_rehearsal_does_the_tasks_of_a_bake_and_keeps_nothing(
    blocks: Path, tmp_path: Path, inline: None, monkeypatch: pytest.MonkeyPatch, long: float
) -> None:
    """What is long is split: here all that is left of a chunk is, or nothing."""
    monkeypatch.setattr(bake_requests, "LONG_TASK_PATHS", long)
    tasks = list[BakeTask]()
    submit = InlinePool.submit
    monkeypatch.setattr(
        InlinePool,
        "submit",
        lambda self, task, done: (tasks.append(task), submit(self, task, done)),
    )
    scene = load_scene(blocks)
    with closing(RenderEngine([scene], str(tmp_path), workers=1)) as engine:
        engine.start()
        patient = Viewer("a test", patient=True)
        view = view_of(scene)
        renderer = engine.renderer("blocks")
        demands = engine.survey("blocks", view, Goal(0.1)).demands
        tried = [
            rehearse(renderer, each, Goal(0.1, 128), math.inf, threading.Event())
            for each in demands
        ]
        cut = rehearse(renderer, demands[0], Goal(0.1, 128), 0.0, threading.Event())
        before = engine.survey("blocks", view, Goal(0.1))
        assert before.counts["provisional"] == before.surface > 0
        engine.bake("blocks", Stage(demands, Goal(0.1, 128)), patient).wait(LONG)
        assert sum(one.tasks for one in tried) == len(tasks)
        stored = sum(path.stat().st_size for path in tmp_path.glob("*/c/**/*") if path.is_file())
        assert sum(one.stored for one in tried) == stored
        assert all(one.seconds > 0.0 for one in tried)
        assert cut.tasks == pytest.approx(tried[0].tasks, rel=5.0)
        assert not engine.survey("blocks", view, Goal(0.1, 128)).provisional
        rest = engine.survey("blocks", view, Goal(0.002)).demands
        assert rehearse(renderer, rest[0], Goal(0.002), math.inf, threading.Event()).tasks >= 1.0
        assert forecast(renderer, (), Goal(0.1), 1, 1.0, threading.Event()).seconds == 0.0


def test_the_sample_is_spread_over_all_texels() -> None:
    demands = [demand(number, 10 + 90 * (number % 2)) for number in range(1000)]
    chosen = list(stratified(demands[::-1]))
    assert len(chosen) == 48, "as docs/prewarm.md says"
    assert sum(len(each.offsets) == 100 for each in chosen) > 0.8 * len(chosen)
    for first in (8, 16, 32):
        places = np.array([each.index[0] for each in chosen[:first]])
        assert np.histogram(places, 4, (0, 1000))[0].tolist() == pytest.approx(
            [first / 4] * 4, abs=1
        )
    few = demands[:4]
    assert list(stratified(few)) == few, "all of them, as they come"
    assert list(stratified(demands[:20])) != demands[:20]


def test_what_was_tried_stands_for_all() -> None:
    tried = [rehearsal(100, 1.0), rehearsal(50, 1.0), rehearsal(200, 2.0)]
    told = extrapolated(tried, 1000, whole=False, per_task=0.0)
    assert told.seconds == pytest.approx((0.01 + 0.02 + 0.01) / 3 * 1000)
    assert told.processor == pytest.approx(told.seconds / 2)
    assert (told.stored, told.maps) == (3000, pytest.approx(0.3))
    assert told.unsure == pytest.approx(0.25)
    left = told.time_left(2, 1.0)
    assert left.likely == pytest.approx(told.seconds / 2 + told.maps + 1.0)
    assert left.low < left.likely < left.high
    whole = extrapolated(tried, 350, whole=True, per_task=0.0)
    assert (whole.seconds, whole.unsure) == (pytest.approx(4.0), 0.0)
    sure = whole.time_left(1, 0.0)
    assert sure.high - sure.low < left.high - left.low
