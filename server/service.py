"""What the routes share: the studio and its start, the settings, the threads that render."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

from fastapi import Depends, Request

from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.model.scene import Scene
from server.errors import StartingError, UnknownSceneError
from server.params import ViewParams
from server.renders import Renders
from server.settings import Settings
from server.views import view_of

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from server.studio import Studio
    from worker.outlook import TimeLeft

Result = TypeVar("Result")

LOOK = 0.02
"""Seconds between two looks at whether the service is ready."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What a request is answered with: a ``frame``, the time until it is final, and the ``watch`` of its stages."""

    frame: Frame
    time_left: TimeLeft | None
    watch: Stopwatch


class Service:
    """One studio behind HTTP. It starts beside the event loop, so that the socket answers meanwhile."""

    def __init__(self, studio: Studio, settings: Settings) -> None:
        self.studio = studio
        self.settings = settings
        self.settled = asyncio.Event()
        self.failure: Exception | None = None
        self._renders = Renders(settings.render_threads, settings.render_queue)

    async def start(self) -> None:
        """Start the studio; ``settled`` is set when it is up, or when ``failure`` says why it is not."""
        try:
            await asyncio.to_thread(self.studio.start)
        except Exception as error:
            self.failure = error
        self.settled.set()

    async def close(self) -> None:
        """Drop waiting work and close the studio, once its start has ended."""
        await self.settled.wait()
        self._renders.close()
        await asyncio.to_thread(self.studio.close)

    def reasons(self) -> list[str]:
        """Why the service is not ready; empty when it is."""
        if not self.settled.is_set():
            return ["isogi is starting: kernels and workers are not up yet."]
        return [f"isogi did not start: {self.failure}"] if self.failure else self.studio.unready()

    async def ready(self) -> None:
        """Returns once the service is ready, or has failed to start."""
        while not self.failure and await asyncio.to_thread(self.reasons) != []:
            await asyncio.sleep(LOOK)

    def scene(self, name: str) -> Scene:
        """The scene with this id; UnknownSceneError where there is none."""
        if name not in self.studio.scenes:
            raise UnknownSceneError(f"There is no scene '{name[:64]}': /v1/scenes lists those there are.")
        return self.studio.scenes[name]

    async def render(
        self, request: Request, scene: Scene, params: ViewParams, finish: Callable[[Shown], Result]
    ) -> Result:
        """``finish`` of what the parameters ask to be shown, both off the event loop.

        Raises ViewError, BusyError, StoreError, and StartingError until the studio is up.
        """
        watch = Stopwatch()
        view = view_of(scene, params, self.settings)
        if not self.settled.is_set() or self.failure:
            raise StartingError(self.reasons()[0])

        def work(cancelled: threading.Event) -> Result:
            watch.seconds["queue"] = watch.elapsed
            wait, target = params.wait_ms / 1000, params.max_error
            frame = self.studio.frame(scene.id, view, max_error=target, wait=wait, cancelled=cancelled, watch=watch)
            with watch.stage("demand"):
                left = self.studio.time_left(scene.id, frame, target)
            return finish(Shown(frame, left, watch))

        return await self._renders.run(request, work)


def service_of(request: Request) -> Service:
    """The service of the app that the request came to."""
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(service_of)]


def scene_of(scene: str, service: ServiceDep) -> Scene:
    """The scene that the path names."""
    return service.scene(scene)


SceneDep = Annotated[Scene, Depends(scene_of)]
