"""Makes a recording: bakes views of a scene, for real, on a thread of this process, and notes each task."""

import statistics
import tempfile
import time
from collections import defaultdict
from contextlib import closing
from typing import Any, cast

from benchmarks.simulator.recording import Ladder, Recording, Sight, Step
from benchmarks.stability.desk import Alone, Desk
from isogi_core.bake.recipe import Index
from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from worker.baker import Baker
from worker.pool import Done, WorkerPool
from worker.tasks import BakeResult, BakeTask
from worker.viewers import GUEST

LONG = 1e9


class Notebook(Desk):
    """A desk that notes, chunk by chunk, the tasks that it did."""

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
    """So many views of an orbit, of ``size`` pixels a side, all baked together to a ``target`` error."""
    baker, shots = Baker(), [view_of(scene, 360.0 * number / views, size) for number in range(views)]
    with (
        tempfile.TemporaryDirectory() as store,
        closing(Notebook()) as notebook,
        closing(Alone([scene], store, baker=baker)) as studio,
    ):
        studio.start()
        asked = [studio.survey(scene.id, view, target) for view in shots]
        for shot in asked:
            baker.want(scene.id, shot.demands, target, GUEST)
        baker.employ(cast(WorkerPool, notebook))
        for view in shots:
            bake(studio, baker, scene, view, target)
        frame = statistics.median(seconds_of(studio, scene, view, target) for view in shots)
        return recording_of(notebook, asked, frame, origin_of(scene, views, size, target))


def view_of(scene: Scene, azimuth: float, size: int) -> View:
    """A view from somewhat above."""
    return View(scene.isovalue, scene.camera(azimuth, 20.0, 2.5, 30.0), width=size, height=size)


def bake(studio: Alone, baker: Baker, scene: Scene, view: View, target: float) -> None:
    """Bring a view's light to the target."""
    while demands := studio.survey(scene.id, view, target).demands:
        baker.want(scene.id, demands, target, GUEST)
        baker.wait(scene.id, [demand.index for demand in demands], LONG)


def seconds_of(studio: Alone, scene: Scene, view: View, target: float) -> float:
    """Seconds that a frame takes whose surface is yet to be found."""
    studio._stages[scene.id].renderer.forget_views()
    begun = time.perf_counter()
    studio.survey(scene.id, view, target)
    return time.perf_counter() - begun


def origin_of(scene: Scene, views: int, size: int, target: float) -> dict[str, Any]:
    """What was recorded."""
    about = {"scene": scene.id, "volume": scene.volume.name, "lights": [light.name for light in scene.lights]}
    return {**about, "isovalue": scene.isovalue, "views": views, "pixels": size, "target_error": target}


def recording_of(notebook: Notebook, asked: list[Frame], frame: float, origin: dict[str, Any]) -> Recording:
    """What was noted, the chunks by number."""
    numbers = {index: number for number, index in enumerate(notebook.notes)}
    views = tuple(
        tuple(Sight(numbers[each.index], each.weight, each.offsets) for each in shot.demands if each.index in numbers)
        for shot in asked
    )
    return Recording(origin, frame, tuple(ladder_of(each) for each in notebook.notes.values()), views)


def ladder_of(notes: list[tuple[BakeTask, BakeResult]]) -> Ladder:
    """The steps of a chunk until it was final for the first time."""
    texels, steps = len(notes[0][0].offsets), []
    for _, result in notes:
        cost, effort = result.cost, result.effort
        share = result.unfinished / texels
        steps.append(Step(cost.seconds, cost.paths, result.worth, share, effort.taken, effort.left))
        if result.unfinished == 0:
            break
    return Ladder(texels, tuple(steps))
