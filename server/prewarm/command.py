"""``isogi prewarm``, alone: light is baked by workers of this process, or those of a scheduler."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from isogi_core.errors import Cancelled, SceneError
from isogi_core.model.scene import Scene
from server.jobs import Status
from server.opening import open_scene
from server.prewarm.bars import Bars
from server.prewarm.desk import Desk, Step
from server.prewarm.order import PrewarmOrder, Views
from server.prewarm.record import Record, last_unfinished
from server.prewarm.summary import Summary
from server.render import PATIENCE
from server.settings import Settings
from worker.viewers import Viewer

if TYPE_CHECKING:
    from server.studio import Studio

COMMAND = Viewer("prewarm", patient=True)

STOPPED = "This was stopped, and what is baked is kept: the same with --continue goes on."


def prewarm(target: str, order: PrewarmOrder, settings: Settings, dry: bool = False) -> Summary:
    """Bake what is asked for in a scene or a volume, and sum it up; ``dry``: what it would take.

    Raises SceneError, VolumeError, LightError and ViewError before anything is begun, StoreError and WorkersError
    later. Whatever it ends with, what is baked stays, and the record in the store says what was asked.
    """
    begun, scene = time.monotonic(), open_scene(target, settings)
    Views(order, scene, settings)
    from server.prewarm.work import carry_out, carry_out_dry, wanted  # noqa: PLC0415 (kernels, as below)
    from server.store import root_of  # noqa: PLC0415
    from server.studio import Studio  # noqa: PLC0415 (kernels: bad input is told before they are compiled)

    hired = (settings.workers, None if dry else settings.scheduler)
    root = root_of(settings)
    record = Record(root, scene, order, "command")
    with closing(Studio([scene], root, *hired, settings.memory_mb << 20)) as studio, Bars() as bars:
        studio.start(hire=not dry)
        desk = desk_of(studio, scene, order, bars.show, begun)
        what = wanted(desk, order, settings)
        if dry:
            return carry_out_dry(desk, what)
        with recorded(record, desk):
            return record.close(carry_out(desk, what, lambda ahead: record.keep(ahead=ahead)))


def go_on(target: str, settings: Settings, deadline: float | None) -> Summary:
    """``prewarm`` with the order that came to no end last. Raises SceneError where there is none."""
    from server.store import root_of  # noqa: PLC0415 (kernels, as above)

    scene, root = open_scene(target, settings), root_of(settings)
    paper = last_unfinished(root, scene)
    if paper is None:
        raise SceneError(f"There is no unfinished prewarm of {scene.name} in {root.place}: say which light to bake.")
    return prewarm(target, paper.order.model_copy(update={"deadline": deadline}), settings)


def desk_of(studio: Studio, scene: Scene, order: PrewarmOrder, tell: Callable[[Step], None], begun: float) -> Desk:
    """The desk of the command, whose time began earlier."""
    target = order.target_error or scene.target_error
    deadline = math.inf if order.deadline is None else begun + order.deadline
    return Desk(
        studio,
        scene,
        target,
        COMMAND,
        lambda view: studio.survey(scene.id, view, target),
        tell,
        deadline,
        PATIENCE,
        begun=begun,
    )


@contextmanager
def recorded(record: Record, desk: Desk) -> Iterator[None]:
    """Keep the record of what is done meanwhile, and of how it ended where that is early."""
    record.keep(status=Status.RUNNING)
    show = desk.tell

    def tell(step: Step) -> None:
        show(step)
        record.tell(step)

    desk.tell = tell
    try:
        yield
    except KeyboardInterrupt:
        record.keep(status=Status.DISMISSED, message=STOPPED)
        raise Cancelled(STOPPED) from None
    except Exception as error:
        record.keep(status=Status.FAILED, message=str(error))
        raise
