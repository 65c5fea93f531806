"""Makes a recording: bakes views of a scene, for real, on a thread of this process, and notes each
task.
"""

import statistics
import tempfile
import time
from collections import defaultdict
from contextlib import closing
from typing import Any, cast

from benchmarks.scaling.simulator.recording import Ladder, Recording, Sight, Step
from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.bake_requests import GUEST_VIEWER
from isogi_worker.baker import Baker
from isogi_worker.pool import Done, WorkerPool
from isogi_worker.tasks import BakeResult, BakeTask
from tests.server.inline import EngineWithoutWorkers, InlinePool

LONG = 1e9


class Notebook(InlinePool):
    """A pool that notes, chunk by chunk, the tasks that it did."""

    def __init__(self) -> None:
        super().__init__()
        self.notes: dict[Index, list[tuple[BakeTask, BakeResult]]] = defaultdict(list)

    def submit(self, task: BakeTask, done: Done) -> None:
        """Bake, note what became of it, and tell."""

        def noted(result: BakeResult | None, error: BaseException | None) -> None:
            if result is not None:
                self.notes[task.index].append((task, result))
            done(result, error)

        super().submit(task, noted)


def record(scene: Scene, views: int, size: int, target: float) -> Recording:
    """So many views of an orbit, of ``size`` pixels a side, all baked together to a ``target``
    error.
    """
    baker = Baker()
    shots = [view_of(scene, 360.0 * number / views, size) for number in range(views)]
    with (
        tempfile.TemporaryDirectory() as store,
        closing(Notebook()) as notebook,
        closing(EngineWithoutWorkers([scene], store, baker=baker)) as engine,
    ):
        engine.start()
        goal = Goal.checked(target)
        asked = [engine.survey(scene.id, view, goal) for view in shots]
        for shot in asked:
            baker.request(scene.id, shot.demands, Goal(target), GUEST_VIEWER)
        baker.use_pool(cast(WorkerPool, notebook))
        for view in shots:
            bake(engine, baker, scene, view, goal)
        frame = statistics.median(seconds_of(engine, scene, view, goal) for view in shots)
        return recording_of(notebook, asked, frame, origin_of(scene, views, size, target))


def view_of(scene: Scene, azimuth: float, size: int) -> View:
    """A view from somewhat above."""
    return View(scene.isovalue, scene.camera(azimuth, 20.0, 2.5, 30.0), width=size, height=size)


def bake(engine: EngineWithoutWorkers, baker: Baker, scene: Scene, view: View, goal: Goal) -> None:
    """Bring a view's light to the goal."""
    while demands := engine.survey(scene.id, view, goal).demands:
        baker.request(scene.id, demands, Goal(goal.error), GUEST_VIEWER)
        baker.wait(scene.id, [demand.index for demand in demands], LONG)


def seconds_of(engine: EngineWithoutWorkers, scene: Scene, view: View, goal: Goal) -> float:
    """Seconds that a frame takes whose surface is yet to be found."""
    engine.renderer(scene.id).forget_views()
    begun = time.perf_counter()
    engine.survey(scene.id, view, goal)
    return time.perf_counter() - begun


def origin_of(scene: Scene, views: int, size: int, target: float) -> dict[str, Any]:
    """What was recorded."""
    about = {
        "scene": scene.id,
        "volume": scene.volume.name,
        "lights": [light.name for light in scene.lighting.lights],
    }
    return {
        **about,
        "isovalue": scene.isovalue,
        "views": views,
        "pixels": size,
        "target_error": target,
    }


def recording_of(
    notebook: Notebook, asked: list[Frame], frame: float, origin: dict[str, Any]
) -> Recording:
    """What was noted, the chunks by number."""
    numbers = {index: number for number, index in enumerate(notebook.notes)}
    views = tuple(
        tuple(
            Sight(numbers[each.index], each.weight, each.offsets)
            for each in shot.demands
            if each.index in numbers
        )
        for shot in asked
    )
    return Recording(
        origin, frame, tuple(ladder_of(each) for each in notebook.notes.values()), views
    )


def ladder_of(notes: list[tuple[BakeTask, BakeResult]]) -> Ladder:
    """The steps of a chunk until it was final for the first time."""
    texels = len(notes[0][0].offsets)
    steps = []
    for _, result in notes:
        cost = result.cost
        effort = result.effort
        share = result.unfinished / texels
        steps.append(
            Step(cost.seconds, cost.paths, result.priority, share, effort.taken, effort.left)
        )
        if result.unfinished == 0:
            break
    return Ladder(texels, tuple(steps))
