import errno
import json
import os
import shutil
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import Cancelled, StoreError
from isogi_core.frame import frame as frame_module
from isogi_core.frame import view_checks
from isogi_core.frame.entry_kernels import FRAME, LOBES
from isogi_core.frame.frame import Frame
from isogi_core.kernels._compilation import Compilation, with_callees
from isogi_core.kernels.shading.framebuffer import CONVERGING
from isogi_core.kernels.shading.irradiance_ratio import carry_ratios
from isogi_core.kernels.shading.lattice import carry_light
from isogi_core.kernels.shading.local_models import shade_local
from isogi_core.kernels.tracing.stiffness import count_stiffness
from isogi_core.kernels.transport.harmonics import rotate
from isogi_core.kernels.transport.lights import project_lamps
from isogi_core.kernels.transport.transfer import measure_distances
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.prepared.shared_scenes import SharedScene
from isogi_core.storage import folder
from isogi_core.storage.backend import StoreUrl
from isogi_server.cli.render import draw_refined
from isogi_server.render.engine import RenderEngine
from isogi_server.render.picture_checks import CHECK, Picture, PictureChecks
from isogi_server.render.stores import StoreProbe, whereabouts
from isogi_worker import pool
from isogi_worker.bake_requests import GUEST_VIEWER, Viewer
from isogi_worker.errors import WorkersAwayError, WorkersError
from isogi_worker.pool import Done
from isogi_worker.tasks import BakeTask
from tests.scale import COMPILED
from tests.server.buckets import Begin
from tests.server.inline import LONG, InlinePool, chunks_in, view_of
from tests.server.sockets import wait_for

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A scene whose texels keep two layers."""
    light = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
    return load_scene(
        "demo:orbital", order=2, lattice=0.5, bounces=1, target_error=0.3, lights=[light]
    )


@pytest.fixture(scope="module")
def baked(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Frame, Path]:
    """The final frame of a view, and a store that has its light."""
    folder = tmp_path_factory.mktemp("baked")
    with (
        pytest.MonkeyPatch.context() as patch,
        closing(RenderEngine([scene], str(folder))) as engine,
    ):
        patch.setattr(pool, "start_pool", InlinePool)
        engine.start()
        return look(engine, wait=LONG), folder


@pytest.fixture
def whole(baked: tuple[Frame, Path], store: Path) -> Frame:
    """The final frame of a view whose light is in the store."""
    frame, folder = baked
    shutil.copytree(folder, store)
    return frame


def look(
    engine: RenderEngine, azimuth: float = 30.0, isovalue: float | None = None, **more: Any
) -> Frame:
    """A frame of an engine's scene."""
    (scene,) = engine.scenes.values()
    return engine.frame(scene.id, view_of(scene, azimuth, isovalue), **more)


def assert_same(a: Frame, b: Frame) -> None:
    assert a.version == b.version
    assert_same_light(a, b)


def assert_same_light(a: Frame, b: Frame) -> None:
    assert a.radiance.tobytes() == b.radiance.tobytes()
    assert a.state.tobytes() == b.state.tobytes()
    assert a.error.tobytes() == b.error.tobytes()


def assert_unlit(frame: Frame) -> None:
    """All of the frame stands in for light that is not there; none of it is black."""
    assert frame.coverage["provisional"] == 1.0
    assert (frame.radiance[frame.state > 0] > 0.0).all()


def test_a_frame_comes_at_once_and_becomes_final(begin: Begin, scene: Scene) -> None:
    engine = begin()
    first = look(engine)
    assert first.surface > 100
    assert_unlit(first)
    assert len(first.demands) == first.chunks_needed > 4
    assert len(scene.plan.layers) == 2
    final = look(engine, wait=LONG)
    assert final.coverage["final"] == 1.0
    assert (final.demands, final.chunks_final) == ((), final.chunks_needed)
    assert final.version != first.version
    assert (final.radiance[final.state > 0] > 0.0).all()
    assert 0.0 < final.noise < 0.3


@pytest.mark.slow
def test_asking_again_and_again_is_enough(begin: Begin) -> None:
    engine = begin()
    assert wait_for(lambda: not look(engine).provisional, LONG)
    assert not look(engine).demands


def test_a_view_at_rest_is_baked_if_a_moving_one_is_given_up(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While nobody waits."""
    engine = begin()
    request = engine.baker.request
    given_up = []

    def refused_once(bake: str, demands: Any, goal: Goal, viewer: Viewer) -> frozenset[Index]:
        if given_up:
            return request(bake, demands, goal, viewer)
        given_up.append(bake)
        return frozenset()

    monkeypatch.setattr(engine.baker, "request", refused_once)
    (scene,) = engine.scenes.values()
    lit = Picture(scene.id, view_of(scene), Goal.checked(0.3))
    bake = engine._bake_lacking(lit)
    assert given_up and bake is not None and bake.coming


def test_a_picture_is_measured_early_only_if_light_takes_long(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths of its controls would take processors from the workers that complete it."""
    engine = begin()
    unlit = look(engine)
    state = unlit.state.copy()
    state.flat[unlit.gbuffer.pixels[0]] = CONVERGING
    part = replace(unlit, state=state)
    assert part.unmeasured and not unlit.unmeasured
    delays: list[float] = []
    monkeypatch.setattr(PictureChecks, "request", lambda *given: delays.append(given[-1]))
    (scene,) = engine.scenes
    assert CHECK in engine.want(scene, part, Goal.checked(0.3), GUEST_VIEWER)
    # A store that takes nothing gets no more light: what there is is measured at once.
    monkeypatch.setattr(engine.store, "only_read", lambda: True)
    assert engine.want(scene, part, Goal.checked(0.3), GUEST_VIEWER) == {CHECK}
    part_delay, whole_delay = delays
    assert 1.0 <= part_delay <= 4.0 and whole_delay == 0.0


def test_workers_come_after_the_start(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    come = threading.Event()

    def start_pool(*given: Any) -> InlinePool:
        assert come.wait(LONG)
        return InlinePool(*given)

    monkeypatch.setattr(pool, "start_pool", start_pool)
    engine = begin()
    assert engine.unready() == [engine.workers.preparing] == ["The workers are starting."]
    assert_unlit(look(engine))
    come.set()
    assert not look(engine, wait=LONG).provisional
    assert engine.unready() == [] and engine.workers.preparing == ""


def test_workers_of_this_machine_share_the_scene(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They neither read nor survey it: see ``tests/worker/test_tasks.py``."""
    tasks = list[BakeTask]()
    submit = InlinePool.submit

    def watched(workers: InlinePool, task: BakeTask, done: Done) -> None:
        tasks.append(task)
        submit(workers, task, done)

    monkeypatch.setattr(InlinePool, "submit", watched)
    engine = begin()
    look(engine, wait=LONG)
    assert tasks and all(isinstance(task.assets, SharedScene) for task in tasks)


def test_workers_are_started_once(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    def start_pool(*given: Any) -> InlinePool:
        started.append(InlinePool(*given))
        return started[0]

    monkeypatch.setattr(pool, "start_pool", start_pool)
    engine = begin()
    engine.start_workers()
    assert not look(engine, wait=LONG).provisional
    assert len(started) == 1


def test_a_scheduler_that_comes_later_is_joined_then(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = iter((True, True, False))

    def join(*given: Any) -> InlinePool:
        if next(tries):
            raise WorkersAwayError("The scheduler is late.")
        return InlinePool(*given)

    monkeypatch.setattr("isogi_server.render.engine_workers.SCHEDULER_RETRY_SECONDS", 0.01)
    monkeypatch.setattr(pool, "start_pool", join)
    engine = begin()
    assert not look(engine, wait=LONG).provisional
    assert engine.unready() == []


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (WorkersError("No workers today."), "No workers today."),
        (
            ImportError("No module 'distributed'"),
            "Cannot start the workers: No module 'distributed'",
        ),
        (OSError("No such file"), "Cannot start the workers: No such file"),
    ],
)
def test_anything_that_keeps_workers_from_coming_is_told(
    begin: Begin, monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    def fail(*given: Any) -> None:
        raise error

    monkeypatch.setattr(pool, "start_pool", fail)
    engine = begin()
    assert_unlit(look(engine, wait=0.1))
    assert engine.unready() == [engine.trouble()] == [told]
    assert engine.workers.preparing == "", "nothing is to come"


def test_workers_that_are_lost_are_told(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = begin()
    assert not look(engine, wait=LONG).provisional
    monkeypatch.setattr(InlinePool, "trouble", "The workers are on strike.")
    assert engine.unready() == ["The workers are on strike."]


def test_after_a_restart_the_same_view_is_final_at_once(
    begin: Begin, store: Path, whole: Frame
) -> None:
    kept = chunks_in(store)
    after = look(begin())
    assert not after.provisional
    assert_same(after, whole)
    assert chunks_in(store) == kept


def test_a_path_traced_frame_lacks_no_light_whatever_its_error(begin: Begin, scene: Scene) -> None:
    engine = begin()
    view = replace(view_of(scene), shading="path_traced", samples=16)
    goal = Goal.checked(0.001)
    frame = engine.frame(scene.id, view, goal=goal, wait=LONG)
    assert frame.provisional and frame.noise > 0.001
    assert engine.lacking(scene.id, frame)[1].demands == ()
    assert draw_refined(engine, scene.id, view, goal, None).version == frame.version


@pytest.mark.slow
def test_a_stricter_error_is_worked_for(begin: Begin) -> None:
    engine = begin()
    loose = look(engine, wait=LONG)
    goal = Goal.checked(0.02)
    strict = look(engine, goal=goal)
    assert loose.final and not strict.final
    strict = look(engine, goal=goal, wait=LONG)
    assert strict.final and strict.total.likely < loose.total.likely


DAMAGES: list[Callable[[list[bytes]], list[bytes]]] = [
    *(lambda chunks: [b"" for _ in chunks], lambda chunks: [each[:-1] for each in chunks]),
    *(
        lambda chunks: [bytes(len(each)) for each in chunks],
        lambda chunks: [each + b"!" for each in chunks],
    ),
    lambda chunks: chunks[1:] + chunks[:1],
]


@pytest.mark.parametrize("damage", DAMAGES, ids=["emptied", "cut", "zeros", "longer", "swapped"])
def test_damage_on_disk_heals_to_the_same_bytes(
    begin: Begin, store: Path, whole: Frame, damage: Callable[[list[bytes]], list[bytes]]
) -> None:
    kept = chunks_in(store)
    paths = [store / name for name in sorted(kept)]
    for path, content in zip(paths, damage([path.read_bytes() for path in paths]), strict=True):
        path.write_bytes(content)
    engine = begin()
    assert_unlit(look(engine))
    assert_same(look(engine, wait=LONG), whole)
    assert chunks_in(store) == kept


@pytest.mark.slow
def test_layers_deleted_while_running_are_baked_again(
    begin: Begin, scene: Scene, store: Path
) -> None:
    engine = begin()
    views = view_of(scene), view_of(scene, isovalue=0.06)
    frames = [engine.frame(scene.id, view, wait=LONG) for view in views]
    kept = chunks_in(store)
    engine.close()
    engine = begin()
    assert_same_light(engine.frame(scene.id, views[0]), frames[0])
    for layer in {store / name.partition("/")[0] for name in kept}:
        shutil.rmtree(layer)
    assert_same_light(engine.frame(scene.id, views[0]), frames[0])
    again = engine.frame(scene.id, views[1], wait=LONG)
    assert not again.provisional
    assert_same_light(again, frames[1])
    fresh = begin()
    for view, frame in zip(views, frames, strict=True):
        assert_same_light(fresh.frame(scene.id, view, wait=LONG), frame)
    assert chunks_in(store) == kept


def test_a_chunk_deleted_while_running_is_baked_again(
    begin: Begin, store: Path, whole: Frame
) -> None:
    kept = chunks_in(store)
    engine = begin()
    lost = sorted(kept)[:3]
    for name in lost:
        (store / name).unlink()
    part = look(engine)
    assert part.chunks_final == part.chunks_needed - len(lost)
    assert 0.0 < part.coverage["provisional"] < 1.0
    assert (part.radiance[part.state > 0] > 0.0).all()
    assert_same(look(engine, wait=LONG), whole)
    assert chunks_in(store) == kept


def test_cut_metadata_stops_the_start(begin: Begin, store: Path) -> None:
    begin()
    metadata = next(store.glob("*/zarr.json"))
    metadata.write_text(metadata.read_text()[:100])
    with pytest.raises(
        StoreError,
        match=r"^Cannot open the light at .*; let `isogi store repair` repair it, "
        r"or move that folder away, .*\.$",
    ):
        begin()


def test_a_full_disk_leaves_frames_provisional_and_is_told(
    begin: Begin, scene: Scene, whole: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as full:
        full.setattr(folder, "partial_file", no_room)
        engine = begin()
        other = view_of(scene, isovalue=0.06)
        assert_same(look(engine), whole)
        frame = engine.frame(scene.id, other, wait=0.2)
        assert frame.provisional
        assert (frame.radiance[frame.state > 0] > 0.0).all()
        assert wait_for(lambda: engine.unready() != [], LONG)
        assert "No space left on device; the store is full" in engine.unready()[0]
        assert (
            engine.trouble()
            == ""
            == StoreProbe(engine.store).reasons()[0].partition("Cannot write to the store")[0]
        )
        assert engine.baker.tally().given_up == engine.baker.tally().failed == 0
    assert not engine.frame(scene.id, other, wait=LONG).provisional
    assert engine.unready() == StoreProbe(engine.store).reasons() == []


def no_room(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_view_that_does_not_fit_the_memory_is_an_error(begin: Begin) -> None:
    engine = begin(memory=20_000)
    with pytest.raises(StoreError, match="does not fit the memory"):
        look(engine, wait=LONG)


@pytest.mark.slow
def test_little_memory_serves_one_view_after_the_other(begin: Begin, scene: Scene) -> None:
    views = [view_of(scene, isovalue=isovalue) for isovalue in (0.03, 0.3, 0.5)]
    engine = begin()
    frames = [engine.frame(scene.id, view, wait=LONG) for view in views]
    little = begin(memory=2_000_000)
    for view, frame in [*zip(views, frames, strict=True)] * 2:
        assert_same_light(little.frame(scene.id, view), frame)


@pytest.mark.slow
def test_views_from_many_threads(begin: Begin, scene: Scene) -> None:
    views = [view_of(scene, azimuth) for azimuth in range(0, 360, 60)]
    engine = begin()
    with ThreadPoolExecutor(len(views)) as threads:
        frames = list(threads.map(lambda view: engine.frame(scene.id, view, wait=LONG), views))
    assert not any(frame.provisional for frame in frames)
    again = begin()
    for view, frame in zip(views, frames, strict=True):
        expected = again.frame(scene.id, view)
        assert not expected.provisional
        final = engine.frame(scene.id, view)
        assert_same(final, expected)
        np.testing.assert_array_equal(frame.state, expected.state)


def test_memory_is_set_aside_for_what_requests_read_alone(
    begin: Begin, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InlinePool, "submit", lambda *_: None)
    budget = 64 << 20
    shadings = ("lambert", "phong_shadow", "vicinity", "gi")
    views = [replace(view_of(scene), shading=shading) for shading in shadings]
    for view in views:
        begin().frame(scene.id, view)
    tracemalloc.start()
    engine = begin(memory=budget)
    taken = []
    for view in views:
        engine.frame(scene.id, view)
        taken.append(tracemalloc.get_traced_memory()[0] / budget)
    tracemalloc.stop()
    assert taken == pytest.approx([0.0, 0.0, 0.25, 0.55], abs=0.1)


@pytest.mark.slow
def test_what_a_scene_keeps_stays_within_its_memory(
    begin: Begin, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InlinePool, "submit", lambda *_: None)
    memory = 8 << 20
    grown = []
    views = [view_of(scene, azimuth, isovalue=0.2 + azimuth / 1000) for azimuth in range(0, 360, 6)]
    engine = begin(memory=memory)
    tracemalloc.start()
    for view in views:
        for shading in ("gi", "vicinity"):
            engine.survey(
                scene.id, replace(view, shading=shading, width=128, height=128), Goal.checked(0.3)
            )
        grown.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert max(grown) < 1.1 * memory


def test_nobody_waits_for_a_cancelled_frame(begin: Begin) -> None:
    cancelled = threading.Event()
    cancelled.set()
    with pytest.raises(Cancelled):
        look(begin(), cancelled=cancelled)


def test_a_engine_can_be_closed_before_it_began(scene: Scene, store: Path) -> None:
    with closing(RenderEngine([scene], str(store))):
        pass
    assert not store.exists()


def test_a_start_can_be_given_up(
    scene: Scene, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiling = threading.Event()
    stopped = threading.Event()

    def compile_for_long(work: Compilation, kernels: Any) -> None:
        compiling.set()
        assert stopped.wait(LONG)

    monkeypatch.setattr(Compilation, "wait", compile_for_long)
    with closing(RenderEngine([scene], str(store))) as engine, ThreadPoolExecutor(1) as thread:
        start = thread.submit(engine.start)
        assert compiling.wait(LONG)
        engine.stop()
        stopped.set()
        start.result(LONG)
    assert not store.exists()


START = """\
import json, sys
from contextlib import closing
from isogi_core.plan.assembly import load_scene
from isogi_core.model.view import View, quaternion_from_angles
from isogi_server.render.stores import StoreProbe
from isogi_server.render.engine import RenderEngine
from tests.compile_kernels import entry_kernels
from tests.server.buckets import Begin
from tests.server.inline import LONG, InlinePool, chunks_in, view_of
from isogi_worker import pool

class Idle:
    room, trouble, preparing, keeps_light = 0, "", "", False
    def __init__(self, *_): pass
    def on_workers_changed(self, callback): pass
    def prepare(self, work): pass
    def close(self): pass

if __name__ == "__main__":
    pool.start_pool = Idle
    scene = load_scene("demo:orbital", lattice=0.4, **json.loads(sys.argv[1]))
    with closing(RenderEngine([scene], sys.argv[2])) as engine:
        engine.start()
        turned = quaternion_from_angles(30.0, 0.0, 0.0)
        view = View(scene.isovalue, scene.camera(30, 20, 3, 30), width=20, height=20, light=turned)
        assert engine.frame(scene.id, view).provisional
    print(json.dumps([kernel.name for kernel in entry_kernels() if kernel.loaded]))
"""


@pytest.mark.slow
@COMPILED
@pytest.mark.parametrize("light", ["constant", "sky"])
def test_kernels_that_a_scene_never_calls_are_never_loaded(tmp_path: Path, light: str) -> None:
    (tmp_path / "start.py").write_text(START)
    settings = json.dumps({"lights": [{"type": light}], "projected": False})
    command = [sys.executable, str(tmp_path / "start.py"), settings, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    if light == "constant":
        uncalled = {carry_ratios, rotate, *LOBES}
    else:
        uncalled = {carry_light}
    called = {*FRAME} - uncalled - {project_lamps, measure_distances, count_stiffness}
    assert set(json.loads(done.stdout)) == {
        kernel.name for kernel in with_callees([*called, shade_local])
    }


def test_workers_are_told_absolute_paths(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert whereabouts(StoreUrl("light", 1.0, 3)) == StoreUrl(str(tmp_path / "light"), 1.0, 3)
    assert whereabouts(StoreUrl("s3://bucket/light")) == StoreUrl("s3://bucket/light")


def test_idle_workers_bake_texels_of_pictures_by_paths(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The picture is final before; views that move find their light afterwards."""
    monkeypatch.setattr(frame_module, "QUICK_TEXELS", 0)
    # Texels seem to cost more than any paths.
    monkeypatch.setattr(view_checks, "HEAVIER", 1e9)
    engine = begin()
    (name,) = engine.scenes
    scene = engine.scenes[name]
    view = view_of(scene, 30.0)
    goal = Goal.checked(scene.target_error)

    def seen() -> Frame:
        frame = engine.survey(name, view, goal)
        engine.want(name, frame, goal, GUEST_VIEWER)
        return frame

    assert wait_for(lambda: seen().final, LONG)
    frame = seen()
    assert frame.goes_without_texels and not frame.stages
    moving = replace(view, moving=True)
    assert wait_for(lambda: not engine.survey(name, moving, goal).provisional, LONG)
