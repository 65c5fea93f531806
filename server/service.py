"""What the routes share: the studio and its start, the settings, and how an order becomes pictures."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, TypeVar

from fastapi import Depends, Request
from fastapi.requests import HTTPConnection

from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.model.scene import Scene
from server.errors import StartingError, UnknownJobError, UnknownSceneError
from server.gate import Gate
from server.jobs import Job, Jobs
from server.news import News
from server.order import Order, Shown
from server.params import ViewParams
from server.renders import ASKED, REFINED, REST, Renders
from server.settings import Settings
from server.turns import Rank
from server.uploads.uploads import Uploads
from server.views import view_of
from server.visits import attended, guest
from worker.viewers import Viewer

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from isogi_core.frame.frame import Frame
    from server.studio import Studio
    from worker.outlook import TimeLeft

Result = TypeVar("Result")

LOOK = 0.02
"""Seconds between two looks at whether the service is ready."""

HEARTBEAT = 20.0
"""Seconds without news after which light is asked for again: less than the baker remembers who wants it."""

SHORTEST_PAUSE, REFINING = 0.1, 0.25
"""Seconds between two pictures of a view at rest, at least; and the share of the time that all views at rest together
may be drawn in while light is baked for them. The last picture of a view waits for neither."""


class Service:
    """One studio behind HTTP. It starts beside the event loop, so that the socket answers meanwhile."""

    def __init__(self, studio: Studio, settings: Settings) -> None:
        self.studio = studio
        self.settings = settings
        self.settled = asyncio.Event()
        self.resumed = asyncio.Event()
        self.failure: Exception | None = None
        self.connections = Gate(settings.streams, "streams are open")
        self.news: News
        self.jobs = Jobs(settings.jobs)
        self.renders = Renders(settings.render_threads)
        self.uploads = Uploads(studio, settings)
        self._requests = Gate(settings.render_threads + settings.render_queue, "frames wait")
        self._refining = 0

    async def start(self) -> None:
        """Start the studio; ``settled`` is set when it is up, or when ``failure`` says why it is not."""
        self.news = News()
        try:
            await asyncio.to_thread(self.studio.start)
            await asyncio.to_thread(self.uploads.open)
            self.studio.listen(self.news.tell)
        except Exception as error:
            self.failure = error
        self.settled.set()

    async def close(self) -> None:
        """Drop waiting work and close the studio, once its start has ended."""
        await self.jobs.close()
        await self.settled.wait()
        self.renders.close()
        self.uploads.close()
        await asyncio.to_thread(self.studio.close)

    def reasons(self) -> list[str]:
        """Why the service is not ready; empty when it is."""
        if not self.settled.is_set():
            return ["isogi is starting: kernels and workers are not up yet."]
        return [f"isogi did not start: {self.failure}"] if self.failure else self.studio.unready()

    def job(self, key: str) -> Job:
        """The job with this id. Raises UnknownJobError, and StartingError while it may still be taken up."""
        try:
            return self.jobs.find(key)
        except UnknownJobError:
            if not self.resumed.is_set():
                raise StartingError("isogi is starting, and takes up the jobs that it had: ask again.") from None
            raise

    async def ready(self) -> None:
        """Returns once the service is ready, or has failed to start."""
        while not self.failure and await asyncio.to_thread(self.reasons) != []:
            await asyncio.sleep(LOOK)

    @property
    def attended(self) -> bool:
        """Whether somebody waits for a frame, or has a stream open."""
        return bool(self._requests.open or self.connections.open)

    def scene(self, name: str) -> Scene:
        """The scene with this id; UnknownSceneError where there is none."""
        scene = self.studio.scenes.get(name)
        if scene is None:
            raise UnknownSceneError(f"There is no scene '{name[:64]}': /v1/scenes lists those there are.")
        return scene

    def order(self, scene: Scene, params: ViewParams) -> Order:
        """What the parameters ask for. Raises ViewError, and StartingError until the studio is up."""
        view = view_of(scene, params, self.settings)
        if not self.settled.is_set() or self.failure:
            raise StartingError(self.reasons()[0])
        return Order(scene.id, view, params.max_error or scene.target_error)

    async def render(
        self,
        request: Request,
        scene: Scene,
        params: ViewParams,
        finish: Callable[[Shown], Result],
        viewer: Viewer | None = None,
    ) -> Result:
        """``finish`` of what the parameters ask to be shown, both off the event loop; by default for a ``guest``.

        Raises ViewError, BusyError, StoreError, StartingError until the studio is up, and Cancelled once the client
        has left: what it alone wanted is not baked then.
        """
        order = self.order(scene, params)
        with self._requests.admitted():
            answer = self._answer(order, viewer or guest(request), params.wait_ms / 1000, finish)
            return await attended(request, answer)

    async def look(self, order: Order, viewer: Viewer, rank: Rank, watch: Stopwatch | None = None) -> Shown:
        """What there is to show for an order now; what it lacks is wanted for the ``viewer`` from then on."""
        watch, since = watch or Stopwatch(), self._newest(order)
        frame = await self.frame(order, rank, watch)

        def claim() -> Shown:
            with watch.stage("demand"):
                coming, left = self.claim(order, frame, viewer)
            return Shown(frame, left, watch, coming, since)

        return await self.renders.run(claim, rank.begun)

    def claim(self, order: Order, frame: Frame, viewer: Viewer) -> tuple[frozenset[Index], TimeLeft | None]:
        """Want what a frame lacks for a viewer; the chunks that are coming, and the time until all are. Blocks."""
        coming = self.studio.want(order.scene, frame, order.target, viewer)
        return coming, self.studio.time_left(order.scene, frame, order.target)

    async def frame(self, order: Order, rank: Rank, watch: Stopwatch) -> Frame:
        """The frame of an order, drawn once for all that order the same while it is; nothing is wanted for it.

        To those that join, all of it is time in the queue.
        """

        def work(cancelled: threading.Event) -> Frame:
            return self.studio.survey(order.scene, order.view, order.target, cancelled, watch)

        with watch.stage("queue"):
            return await self.renders.share((order, self._newest(order)), work, rank)

    async def refinements(self, order: Order, viewer: Viewer) -> AsyncGenerator[Shown, None]:
        """What there is at once, then what is better as light comes, until it is final or no more is coming.

        All such orders together are drawn for no more than a share REFINING of the time, so that the workers have
        the rest; the last picture of each comes at once. Where light was given up that comes once more, though it is
        the same as before: no more is coming then, and it is not final.
        """
        version, patience = "", REST
        while True:
            shown = await self.look(order, viewer, Rank.within(patience))
            given_up = shown.frame.provisional and not shown.coming
            if shown.frame.version != version or given_up:
                version, patience = shown.frame.version, REFINED
                yield shown
            if not shown.coming:
                return
            await self._better(order, shown)

    def leave(self, viewer: Viewer) -> None:
        """A viewer has gone: have nothing more baked for it alone, without waiting for that."""
        asyncio.get_running_loop().run_in_executor(None, self.studio.leave, viewer)

    async def _answer(self, order: Order, viewer: Viewer, wait: float, finish: Callable[[Shown], Result]) -> Result:
        """``finish`` of what there is once all that is wanted is baked, or after so many seconds of waiting for it."""
        watch, loop, rank = Stopwatch(), asyncio.get_running_loop(), Rank.within(ASKED, self.settings.queue_seconds)
        deadline = loop.time() + wait
        try:
            shown = await self.look(order, viewer, rank, watch)
            while shown.coming and (left := deadline - loop.time()) > 0:
                with watch.stage("bake"), self.news.pending(self._bake(order), shown.coming, shown.since) as pending:
                    await within(left, pending.all)
                shown = await self.look(order, viewer, rank.begun, watch)
            return await self.renders.run(lambda: finish(shown), rank.begun)
        except asyncio.CancelledError:
            self.leave(viewer)
            raise

    async def _better(self, order: Order, shown: Shown) -> None:
        """Returns when it is time to draw what was ``shown`` again."""
        self._refining += 1
        try:
            with self.news.pending(self._bake(order), shown.coming, shown.since) as pending:
                await within(HEARTBEAT, pending.some)
                pause = (1.0 / REFINING - 1.0) * work_of(shown) * self._refining
                await within(max(pause, SHORTEST_PAUSE), pending.all)
        finally:
            self._refining -= 1

    def _bake(self, order: Order) -> str:
        return self.studio.bake_of(order.scene, order.view)

    def _newest(self, order: Order) -> int:
        return self.news.newest(self._bake(order))


def work_of(shown: Shown) -> float:
    """Seconds that were worked on what was shown."""
    return sum(seconds for stage, seconds in shown.watch.seconds.items() if stage != "queue")


async def within(seconds: float, event: asyncio.Event) -> None:
    """Returns when the event is set, after so many seconds at the latest."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()


async def service_of(connection: HTTPConnection) -> Service:
    """The service of the app that the request came to; a coroutine, for anything else would have a thread started."""
    service: Service = connection.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(service_of)]


async def scene_of(scene: str, service: ServiceDep) -> Scene:
    """The scene that the path names."""
    return service.scene(scene)


SceneDep = Annotated[Scene, Depends(scene_of)]
