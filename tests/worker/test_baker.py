import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.noise import Effort, Goal
from isogi_core.cache.costs import Cost, Costs
from isogi_core.errors import StoreAwayError, StoreError
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.demand import Demand
from isogi_core.model.scene_plan import MAX_SAMPLES, Layer, ScenePlan
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from isogi_worker.bake_requests import GUEST_VIEWER, Viewer
from isogi_worker.baker import Bake, Baker, after
from isogi_worker.errors import WorkersAwayError
from isogi_worker.pool import AllDone, Done
from isogi_worker.progress import Tally, TimeLeft
from isogi_worker.tasks import BAKED_ELSEWHERE, BakeResult, BakeTask
from tests.server.sockets import wait_for

SOURCE = SceneSource("scene", {"volume": "demo:orbital"}, Path())
PLAN = ScenePlan("transfer", (Layer("direct", 5), Layer("indirect", 3)), 5, 4, 1.0, 4096)
NEAR = ScenePlan("vicinity", (Layer("direct", 5),), 1, 0, 1.0, 4096)


def left(unfinished: int, priority: float, paths: float = 0.0) -> BakeResult:
    """What a task leaves that took 2 seconds for 100 paths of 2 texels, 0.02 seconds each."""
    return BakeResult(unfinished, priority, Effort(0, 100.0, paths), Cost(2.0, 100, 2, 0.64))


DONE = left(0, 0.0)


class FakePool:
    """Takes tasks and ends them when the test says so."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.together = 1
        self.keeps_light = False
        self.here = True
        self.workers = 2
        self.deaths = 0
        self.in_flight: list[tuple[BakeTask, Done]] = []
        self.all_in_flight: list[tuple[Sequence[BakeTask], AllDone]] = []

    def submit(self, task: BakeTask, done: Done) -> None:
        self.in_flight.append((task, done))

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        self.all_in_flight.append((tasks, done))

    def end(self, result: BakeResult | None = DONE, error: BaseException | None = None) -> BakeTask:
        task, done = self.in_flight.pop(0)
        done(result, error)
        return task

    def tasks(self) -> list[int]:
        return [task.index[2] for task, _ in self.in_flight]


BOTH = frozenset({"direct", "indirect"})


class Bench:
    """A baker with one scene, a clock that stands still, and a note of the chunks that arrived."""

    def __init__(self, workers: int | None = 1) -> None:
        self.now = 0.0
        self.arrived: list[Index] = []
        self.baker = Baker(lambda: self.now, workers)
        self.costs = Costs("memory://costs", "digest")
        self.add("scene")

    def add(
        self,
        name: str,
        digest: str = "digest",
        layers: frozenset[str] = BOTH,
        plan: ScenePlan = PLAN,
    ) -> list[Index]:
        """Add a bake; the chunks of it that arrive from now on, of all that are called ``scene`` in
        one list.
        """
        if name == "scene":
            costs = self.costs
        else:
            costs = Costs("memory://costs", name)
        arrived = self.arrived if name == "scene" else []
        self.baker.add(
            name, Bake(SOURCE, plan, digest, layers, StoreUrl("store"), arrived.append, costs)
        )
        return arrived

    def request(
        self, *chunks: int, scene: str = "scene", viewer: Viewer = GUEST_VIEWER
    ) -> frozenset[Index]:
        texels = np.array([1, 2], np.int32)
        seen = np.array([1.0, 0.5], np.float32)
        effort = Effort(2, 0.0, 0.0)
        demands = [Demand((0, 0, x), texels, 10.0 - x, effort, seen) for x in chunks]
        return self.baker.request(scene, demands, Goal(0.1), viewer)

    def use_pool(self, room: int) -> FakePool:
        pool = FakePool(room)
        self.baker.use_pool(pool)  # type: ignore[arg-type]
        return pool


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_task_holds_all_that_a_worker_must_know(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(3)
    task = pool.in_flight[0][0]
    assert (task.source, task.plan, task.digest, task.store_url) == (
        SOURCE,
        PLAN,
        "digest",
        StoreUrl("store"),
    )
    assert (task.index, task.offsets.tolist(), task.until, task.goal) == (
        (0, 0, 3),
        [1, 2],
        16,
        Goal(0.1),
    )
    assert task.footprints.tolist() == [1.0, 0.5]


def test_few_tasks_fly_and_the_newest_view_is_next(bench: Bench) -> None:
    pool = bench.use_pool(2)
    bench.request(1, 2, 3)
    assert pool.tasks() == [1, 2]
    bench.request(9)
    pool.end()
    assert pool.tasks() == [2, 9]
    pool.end()
    assert pool.tasks() == [9, 3]


def test_each_chunk_is_reported_and_refined_until_final(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1)
    assert pool.end(left(2, 0.8, 100.0)).until == 16
    assert bench.arrived == [(0, 0, 1)]
    assert pool.end().until == MAX_SAMPLES
    assert bench.arrived == [(0, 0, 1)] * 2
    assert pool.tasks() == []


def test_scenes_share_the_workers(bench: Bench) -> None:
    others = bench.add("other", "other digest", frozenset({"whole"}))
    pool = bench.use_pool(4)
    bench.request(1)
    bench.request(1, scene="other")
    assert [task.digest for task, _ in pool.in_flight] == ["digest", "other digest"]
    pool.end()
    assert (bench.arrived, others) == ([(0, 0, 1)], [])
    pool.end()
    assert others == [(0, 0, 1)]


def test_bakes_that_share_a_layer_take_turns_at_a_chunk(bench: Bench) -> None:
    bench.add("near", "near digest", frozenset({"direct"}), NEAR)
    pool = bench.use_pool(8)
    bench.request(1, 2)
    bench.request(2, 3, scene="near")
    in_flight = [(PLAN, 1), (PLAN, 2), (NEAR, 3), (NEAR, 2)]
    assert [(task.plan, task.index[2]) for task, _ in pool.in_flight] == in_flight[:3]
    pool.end()
    assert [(task.plan, task.index[2]) for task, _ in pool.in_flight] == in_flight[1:3]
    pool.end()
    assert [(task.plan, task.index[2]) for task, _ in pool.in_flight] == in_flight[2:]


def test_waiting_ends_when_the_light_is_there(bench: Bench) -> None:
    pool = bench.use_pool(4)
    bench.request(1, 2, 7)
    waiting = threading.Thread(
        target=bench.baker.wait, args=("scene", [(0, 0, 1), (0, 0, 2)], 60.0)
    )
    waiting.start()
    pool.end()
    pool.end()
    waiting.join(30.0)
    assert not waiting.is_alive()
    assert pool.tasks() == [7]


def test_waiting_ends_with_its_time(bench: Bench) -> None:
    bench.use_pool(1)
    bench.request(1)
    bench.baker.wait("scene", [(0, 0, 1)], 0.01)
    assert bench.arrived == []


def fail(bench: Bench, pool: FakePool, times: int) -> None:
    for _ in range(times):
        pool.end(None, StoreError("No space left."))


TRIES = 3
"""Tries of a chunk that fails each time (docs/faults.md)."""


def until_tried(bench: Bench, pool: FakePool, *chunks: int) -> float:
    """The seconds until a task for one of the chunks is handed out, while they are asked for."""
    begun = bench.now
    while not pool.tasks():
        assert len(bench.request(*chunks)) == len(chunks)
        bench.now += 0.125
        bench.request(*chunks)
    return bench.now - begun


def test_failed_tasks_are_tried_again(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    pool = bench.use_pool(1)
    bench.request(1)
    with caplog.at_level(logging.WARNING, "isogi.worker"):
        fail(bench, pool, TRIES - 1)
    assert "No space left." in caplog.text
    assert pool.tasks() == [1]
    pool.end()
    assert bench.arrived == [(0, 0, 1)]
    assert bench.baker.trouble() == ""


def test_a_chunk_that_fails_too_often_is_given_up_alone(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1, 2)
    fail(bench, pool, TRIES)
    assert pool.tasks() == [2]
    assert bench.baker.trouble() == "Chunk (0, 0, 1) of scene cannot be baked: No space left."
    bench.baker.wait("scene", [(0, 0, 1)], 60.0)
    assert not bench.request(1)
    assert bench.request(1, 2)
    pool.end()
    assert bench.arrived == [(0, 0, 2)]
    bench.now += 58.0
    assert bench.baker.trouble() != "" and not bench.request(1)
    bench.now += 4.0
    assert bench.baker.trouble() == ""
    assert bench.request(1)
    assert pool.tasks() == [1]


def test_a_stopped_baker_hands_out_nothing(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1, 2)
    bench.baker.stop()
    pool.end(None, StoreError("The workers were stopped."))
    bench.request(3)
    assert pool.tasks() == []
    assert bench.baker.trouble() == ""


def test_light_that_comes_after_the_stop_is_still_reported(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1)
    bench.baker.stop()
    pool.end()
    assert bench.arrived == [(0, 0, 1)]


def test_many_threads_may_request_at_once(bench: Bench) -> None:
    pool = bench.use_pool(10_000)
    threads = [threading.Thread(target=bench.request, args=range(i, i + 50)) for i in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(pool.tasks()) == list(range(69))
    while pool.in_flight:
        pool.end()
    assert len(bench.arrived) >= 69
    bench.baker.wait("scene", [(0, 0, x) for x in range(69)], 60.0)


def test_time_left_follows_from_what_the_bake_took(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1, 2, 3)
    chunks = [(0, 0, x) for x in (1, 2, 3)]
    assert bench.baker.time_left("scene", "view", chunks) is None
    pool.end(left(2, 0.8, paths=120.0))
    # 0.02 seconds a path: 120 paths here, and there of each texel as many as here, (100 + 120) / 2.
    reported = bench.baker.time_left("scene", "view", chunks)
    assert reported is not None
    assert reported.likely == pytest.approx(0.02 * (120 + 2 * 2 * 110) / 2)
    assert reported.low < reported.likely / 2 and reported.high > 2 * reported.likely
    assert bench.baker.time_left("scene", "view", [(0, 0, 9)]) == TimeLeft(0.0, 0.0, 0.0)
    assert bench.baker.paths == 100


def test_a_new_bake_is_taken_to_cost_what_another_one_does(bench: Bench) -> None:
    """As the next side of a surface, before any of its tasks is done."""
    pool = bench.use_pool(1)
    bench.request(1, 2)
    chunks = [(0, 0, 1), (0, 0, 2)]
    bench.add("side")
    bench.request(3, scene="side")
    assert bench.baker.time_left("side", "view", [(0, 0, 3)], like="scene") is None
    pool.end(left(2, 0.8, paths=120.0))
    assert bench.baker.time_left("scene", "view", chunks) is not None
    assert bench.baker.time_left("side", "view", [(0, 0, 3)]) is None
    known = bench.baker.time_left("side", "view", [(0, 0, 3)], like="scene")
    assert known is not None and known.likely > 0.0


def test_a_worker_that_leaves_has_done_no_work(bench: Bench) -> None:
    """Estimates are compared with work that was done, and not with a change of its division."""
    pool = bench.use_pool(1)
    bench.request(*range(12))
    for _ in range(10):
        pool.end()
    pool.end(left(2, 0.8, paths=120.0))
    first = bench.baker.time_left("scene", "view", [(0, 0, 11)])
    pool.workers = 1
    bench.now += 10.0
    then = bench.baker.time_left("scene", "view", [(0, 0, 11)])
    assert first is not None and then is not None
    assert then.low / then.likely == pytest.approx(first.low / first.likely)
    assert then.high / then.likely == pytest.approx(first.high / first.likely)


def test_time_left_is_unknown_without_a_number_of_workers() -> None:
    bench = Bench(workers=None)
    bench.costs.add((0, 0, 1), Cost(1.0, 100, 2, 0.5))
    bench.request(1)
    assert bench.baker.time_left("scene", "view", [(0, 0, 1)]) is None
    bench.use_pool(1)
    assert bench.baker.time_left("scene", "view", [(0, 0, 1)]) is not None


def test_costs_are_kept_when_the_baker_stops(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1)
    pool.end()
    bench.baker.stop()
    again = Costs("memory://costs", "digest")
    again.read()
    assert again.rate((0, 0, 1)) == pytest.approx(0.02)


def test_nothing_more_is_baked_for_clients_that_left(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1, 2, viewer=Viewer("Anna"))
    bench.request(9, viewer=Viewer("Bert"))
    bench.baker.leave(Viewer("Anna"))
    pool.end()
    assert pool.tasks() == [9]
    pool.end()
    assert pool.tasks() == []


def test_listeners_are_called_after_the_queue_was_updated(bench: Bench) -> None:
    heard: list[tuple[str, Index, bool]] = []
    bench.baker.listen(lambda *news: heard.append(news))
    pool = bench.use_pool(1)
    bench.request(1)
    pool.end(left(1, 0.5))
    pool.end()
    bench.request(2)
    fail(bench, pool, TRIES)
    first = ("scene", (0, 0, 1))
    second = ("scene", (0, 0, 2))
    assert heard == [
        (*first, True),
        (*first, False),
        (*second, True),
        (*second, True),
        (*second, False),
    ]


def test_half_the_workers_rest_while_a_view_moves(bench: Bench) -> None:
    pool = bench.use_pool(4)
    bench.request(*range(1, 11))
    assert len(pool.tasks()) == 4
    bench.baker.make_way()
    in_flight = []
    for _ in range(5):
        pool.end()
        in_flight.append(len(pool.tasks()))
    assert in_flight == [3, 2, 1, 1, 1]
    bench.now += 0.25
    pool.end()
    assert len(pool.tasks()) == 1, "it may move on"
    bench.now += 0.75
    pool.end()
    assert len(pool.tasks()) == 3, "all that is left, in no time"


def test_workers_that_stand_elsewhere_go_on_while_a_view_moves(bench: Bench) -> None:
    pool = bench.use_pool(4)
    pool.here = False
    bench.baker.make_way()
    bench.request(1, 2, 3, 4, 5)
    assert len(pool.tasks()) == 4


def test_tasks_for_absent_workers_wait_until_they_are_back(bench: Bench) -> None:
    pool = bench.use_pool(2)
    bench.request(1, 2, 3)
    pool.room = 0
    for _ in range(2):
        pool.end(None, WorkersAwayError("The scheduler is gone."))
    assert pool.tasks() == []
    assert bench.request(1, 2, 3) == {(0, 0, 1), (0, 0, 2), (0, 0, 3)}
    assert (bench.baker.trouble(), bench.baker.tally().failed) == ("", 0)
    pool.room = 3
    bench.baker.dispatch()
    assert pool.tasks() == [1, 2, 3]


def test_a_claimed_chunk_waits_while_others_are_baked(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    later: list[tuple[float, Callable[[], None]]] = []
    monkeypatch.setattr(
        "isogi_worker.baker.after", lambda seconds, call: later.append((seconds, call))
    )
    pool = bench.use_pool(1)
    bench.request(1, 2)
    assert pool.end(BAKED_ELSEWHERE).owner
    assert pool.tasks() == [2]
    pool.end()
    assert pool.tasks() == []
    tally = bench.baker.tally()
    assert (tally.waiting, tally.in_flight, tally.done, tally.failed) == (1, 0, 1, 0)
    assert bench.arrived == [(0, 0, 2)]
    ((seconds, resume),) = later
    assert 0.1 <= seconds <= 0.5
    bench.now += seconds
    resume()
    assert pool.tasks() == [1]


def test_a_long_wait_for_another_baker_ends(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr("isogi_worker.baker.after", lambda seconds, _: waits.append(seconds))
    pool = bench.use_pool(1)
    bench.request(1)
    while not pool.end(BAKED_ELSEWHERE).insists:
        assert bench.now < 10.0
        bench.now += waits[-1]
        bench.baker.dispatch()
    assert bench.now >= 2.5
    bench.now += waits[-1]
    bench.baker.dispatch()
    assert pool.end(left(2, 0.8)).insists and not pool.end().insists


def test_something_is_called_after_a_while() -> None:
    called = threading.Event()
    after(0.01, called.set)
    assert called.wait(30.0)


def test_a_dropped_scene_is_baked_no_more_and_waiters_learn_it(bench: Bench) -> None:
    reported: list[tuple[str, Index, bool]] = []
    bench.baker.listen(lambda *news: reported.append(news))
    pool = bench.use_pool(1)
    bench.request(1, 2)
    bench.baker.forget("scene")
    assert reported == [("scene", (0, 0, 1), False), ("scene", (0, 0, 2), False)]
    assert bench.request(3) == frozenset()
    assert bench.baker.time_left("scene", "view", [(0, 0, 1)]) is None
    pool.end(left(2, 0.8))
    assert not pool.in_flight


def test_a_scene_that_comes_again_waits_for_the_task_that_flies(bench: Bench) -> None:
    pool = bench.use_pool(2)
    bench.request(1)
    bench.baker.forget("scene")
    bench.add("scene")
    bench.request(1, 2)
    assert pool.tasks() == [1, 2]
    pool.end(left(2, 0.8))
    assert pool.tasks() == [2, 1]


@pytest.mark.parametrize("error", [None, RuntimeError("the file is gone")])
def test_a_result_after_its_scene_was_dropped_does_no_harm(
    bench: Bench, error: Exception | None
) -> None:
    bench.add("other", "other", frozenset({"whole"}))
    pool = bench.use_pool(1)
    bench.request(1)
    bench.request(1, scene="other")
    bench.baker.forget("scene")
    pool.end(None if error else DONE, error)
    assert [task.digest for task, _ in pool.in_flight] == ["other"]
    assert bench.baker.trouble() == ""


# --- a store that is away
# -----------------------------------------------------------------------------------------

GONE = StoreAwayError("The store is gone.")


def test_one_task_that_misses_the_store_delays_no_other(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    pool = bench.use_pool(2)
    bench.request(1, 2, 3)
    for _ in range(2):
        pool.end(None, GONE)
        assert bench.baker.paused() == "" and len(pool.tasks()) == 2
        pool.end(left(0, 0.0))
    assert "baking waits" not in caplog.text


def test_tasks_that_miss_the_store_together_miss_it_once(bench: Bench) -> None:
    """Baking pauses at the second failure, however many chunks the first one had."""
    bench.request(1, 2, 3)
    pool = FakePool(1)
    pool.together = 8
    bench.baker.use_pool(pool)  # type: ignore[arg-type]
    tasks, done = pool.all_in_flight.pop()
    assert len(tasks) == 3
    done([GONE] * 3)
    assert bench.baker.paused() == ""
    tasks, done = pool.all_in_flight.pop()
    done([StoreAwayError("Gone again.")] * len(tasks))
    assert bench.baker.paused() == "Gone again." and not pool.all_in_flight


def test_an_absent_store_is_tried_now_and_then_by_one_task(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    pool = bench.use_pool(2)
    bench.request(1, 2, 3)
    for _ in range(3):
        pool.end(None, GONE)
    assert pool.tasks() == [] and bench.baker.paused() == "The store is gone."
    # More often than a chunk may fail, by the seconds that docs/stores.md tells.
    for seconds in (1.0, 2.0, 4.0, 8.0, 8.0, 8.0):
        assert until_tried(bench, pool, 1, 2, 3) == seconds
        assert len(pool.tasks()) == 1, "one is tried"
        pool.end(None, GONE)
    tally = bench.baker.tally()
    assert (tally.waiting, tally.given_up, tally.failed, tally.in_flight) == (3, 0, 0, 0)
    assert bench.baker.trouble() == "" and caplog.text.count("baking waits for the store") == 1
    until_tried(bench, pool, 1, 2, 3)
    pool.end()
    assert bench.baker.paused() == "" and len(pool.tasks()) == 2
    pool.end()
    pool.end()
    assert sorted(bench.arrived) == [(0, 0, 1), (0, 0, 2), (0, 0, 3)]


def test_a_poison_chunk_is_given_up_though_the_store_was_away(bench: Bench) -> None:
    pool = bench.use_pool(1)
    bench.request(1)
    pool.end(None, GONE)
    pool.end(None, GONE)
    until_tried(bench, pool, 1)
    fail(bench, pool, TRIES)
    assert bench.baker.tally().given_up == 1


def test_baking_goes_on_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("isogi_worker.baker.SHORTEST_PAUSE", 0.01)
    bench = Bench()
    bench.baker = Baker()
    bench.add("scene", layers=frozenset())
    pool = bench.use_pool(1)
    bench.request(1)
    pool.end(None, GONE)
    assert wait_for(lambda: bool(pool.tasks()), 60.0)
    pool.end()
    assert bench.arrived == [(0, 0, 1)] and bench.baker.paused() == ""


def test_no_task_is_tried_after_a_stop_or_without_clients(bench: Bench) -> None:
    pool = bench.use_pool(1)
    alone = Viewer("somebody", single=True)
    bench.request(1, viewer=alone)
    bench.baker.leave(alone)
    pool.end(None, GONE)
    assert bench.baker.tally().waiting == 0
    bench.baker.stop()
    assert bench.baker.paused() == "" and pool.tasks() == []


def test_light_that_has_come_meanwhile_is_told_as_coming(bench: Bench) -> None:
    """Whoever asked draws the view again: nothing is open, so that nobody waits."""
    pool = bench.use_pool(1)
    assert bench.request(1) == {(0, 0, 1)}
    pool.end()
    assert bench.request(1) == {(0, 0, 1)}
    assert pool.tasks() == [] and bench.baker.open("scene", [(0, 0, 1)]) == 0
    bench.baker.wait("scene", [(0, 0, 1)], 60.0)


def test_chunks_that_are_baked_together_end_each_by_itself(bench: Bench) -> None:
    bench.request(1, 2, 3, 4)
    pool = FakePool(1)
    pool.together = 8
    bench.baker.use_pool(pool)  # type: ignore[arg-type]
    ((tasks, done),) = pool.all_in_flight
    assert [task.index[2] for task in tasks] == [1, 2, 3, 4]
    done([DONE, left(1, 1.0), RuntimeError("no"), BAKED_ELSEWHERE])
    assert bench.arrived == [(0, 0, 1), (0, 0, 2)]
    tally = bench.baker.tally()
    assert (tally.done, tally.chunks, tally.failed, tally.in_flight) == (1, 2, 1, 1)


def test_counts_of_waiting_requests_and_their_age(bench: Bench) -> None:
    assert bench.baker.tally() == Tally(0, 0, 0.0, 0, 0, 0, 0, 0, 0, 0, 0)
    bench.request(1)
    bench.now += 5.0
    bench.request(1, 2)
    bench.now += 2.0
    assert bench.baker.tally() == Tally(2, 0, 7.0, 0, 0, 0, 0, 0, 0, 0, 0)


def test_counts_of_done_failed_and_given_up_tasks(bench: Bench) -> None:
    pool = bench.use_pool(1)
    pool.deaths = 3
    bench.request(1, 2)
    pool.end(replace(DONE, healed=True))
    assert bench.baker.tally() == Tally(1, 0, 0.0, 1, 1, 0, 0, 1, 100, 2, 3, chunks=1)
    fail(bench, pool, TRIES)
    assert bench.baker.tally() == Tally(0, 1, 0.0, 0, 1, TRIES, 0, 1, 100, 2, 3, chunks=1)
