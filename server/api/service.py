"""What the routes share: the engine and its start, the settings, and how a request becomes
pictures.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Hashable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, NamedTuple, Self, TypeVar

import numpy as np
from fastapi import Depends, Request
from fastapi.requests import HTTPConnection

from isogi_core.bake.bake_spec import SPECS
from isogi_core.errors import IsogiError, NoRoomError, StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.tiles import Stopwatch
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from server.answers import scene_schema
from server.api.lifespan import Startup, within
from server.bearers import Bearer, bearer_of, client_of
from server.errors import ForbiddenError, StartingError, UnknownJobError, UnknownSceneError
from server.parameters import LightParams, VariantParams, ViewParams
from server.render.bakes import UpdateBus, attended, request_viewer
from server.render.engine import RenderEngine
from server.render.jobs import ExportFolder, Job, Jobs
from server.render.scene_variant import Change
from server.render.scheduling import (
    DRAFT,
    REFINEMENT_PATIENCE,
    REQUEST_PATIENCE,
    REST_PATIENCE,
    AdmissionLimit,
    Entered,
    LongRenders,
    Rank,
    Renders,
    Room,
)
from server.render.variants import Variants
from server.settings import Settings
from server.uploads.uploads import Uploads
from server.views import view_of
from worker.bake_requests import Viewer
from worker.progress import TimeLeft

Result = TypeVar("Result")

STREAM = 1.0
ADDRESS = 4.0
PATIENT = 0.25
"""Weights of clients where they share the threads: a stream, all requests of an address, and work
that yields.
"""

PREVIEW = "lambert"
"""The shading of views whose light does not fit the memory, and of all while kernels of light are
compiled.
"""

SKETCHES = (PREVIEW, "lambert_fog", "phong")
"""Shadings that kernels of first pictures draw."""

HEARTBEAT = 20.0
"""Seconds without an update after which light is requested again, before the baker forgets the
request.
"""

SHORTEST_PAUSE = 0.1
REFINING = 0.25
"""Seconds between two pictures of a view at rest, at least; and the share of the time that all
views at rest together may be drawn in while light is baked for them. The last picture of a view
waits for neither, nor the first with light, nor the first that has some in every part.
"""

YOUNGER = 0.1
LONGEST_PAUSE = 5.0
"""Share of the time since a view was asked for that its next picture waits at least, up to so many
seconds: errors fall with the square root of the paths, and one that had a tenth more of them looks
the same.
"""


class Service:
    """One render engine behind HTTP. It starts beside the event loop, so that the socket answers
    meanwhile.
    """

    def __init__(self, engine: RenderEngine, settings: Settings) -> None:
        self.engine = engine
        self.settings = settings.answering
        self.startup = Startup(engine)
        self.resumed = asyncio.Event()
        self.connections = AdmissionLimit(settings.streams, "streams are open")
        self.updates: UpdateBus
        self.jobs = Jobs(settings.jobs)
        self.threads = RenderThreads(settings.render_threads)
        self.uploads = Uploads(engine, settings)
        self.exports = ExportFolder(settings.exports_mb << 20)
        self.variants = Variants(
            engine, self.uploads.environment_at, patience=settings.queue_seconds
        )
        self._requests = AdmissionLimit(
            settings.render_threads + settings.render_queue, "frames wait", work=True
        )
        self._refining = 0

    async def start(self) -> None:
        """Start the engine, and what comes with it: see ``startup``."""
        self.updates = UpdateBus()
        await self.startup.run(self._open, self._survey)

    def _open(self) -> None:
        self.uploads.open()
        self.engine.listen(self.updates.publish)

    def _survey(self, scene: Scene) -> None:
        """Work out what the document of a scene says, so that the first visitor does not wait for
        it.
        """
        with suppress(IsogiError):
            scene_schema(self.planned(scene))

    async def close(self) -> None:
        """Drop waiting work and close the engine, once its start has ended."""
        await self.jobs.close()
        await self.startup.close()
        self.threads.close()
        self.variants.close()
        self.uploads.close()
        self.exports.close()
        await asyncio.to_thread(self.engine.close)

    def job(self, key: str) -> Job:
        """The job with this id. Raises UnknownJobError, and StartingError while it may still be
        taken up.
        """
        try:
            return self.jobs.find(key)
        except UnknownJobError:
            if not self.resumed.is_set():
                raise StartingError(
                    "isogi is starting, and takes up the jobs that it had: ask again."
                ) from None
            raise

    async def dismiss(self, key: str, bearer: Bearer) -> Job:
        """End a job of this bearer's. Raises ForbiddenError, and as ``job`` does."""
        job = self.job(key)
        if not bearer.owns(job.owner):
            raise ForbiddenError(
                f"The job '{job.id}' belongs to '{job.owner}', who may dismiss it, and so may "
                "an admin."
            )
        return await self.jobs.dismiss(job.id)

    def reason(self) -> str:
        """Why light is not baked."""
        return (
            self.engine.trouble() or "Some light that the view needs cannot be baked: see /bakez."
        )

    @property
    def attended(self) -> bool:
        """Whether a client waits for a frame, or has a stream open."""
        return bool(self._requests.open or self.connections.open)

    def scene(self, name: str) -> Scene:
        """The scene with this id; UnknownSceneError where there is none."""
        scene = self.engine.scenes.get(name)
        if scene is None or self.engine.variant(name).any:
            raise UnknownSceneError(f"There is no scene '{name[:64]}': /v1/scenes lists them all.")
        return scene

    async def variant(self, scene: Scene, params: LightParams, client: Hashable) -> Scene:
        """The scene in the light, with the cut, at the time, of the material, with the surfaces and
        without the labels that the parameters of a ``client`` ask for; itself where they do not.

        Raises ParameterError where there is no such, and StartingError until the engine is up.
        """
        change = Change(params.environment)
        if isinstance(params, VariantParams):
            change = Change(**params.model_dump(include={*VariantParams.model_fields}))
        if change != Change():
            self.startup.check()
        return await self.variants.of(scene, change, client)

    def planned(self, scene: Scene) -> Scene:
        """The ``scene`` with the plan of the light that its store has, where that can be read
        now.
        """
        if not self.startup.open:
            return scene
        with suppress(StoreError):
            return self.engine.planned(scene.id)
        return scene

    def picture_of(self, scene: Scene, params: ViewParams) -> PictureRequest:
        """The picture that the parameters ask for. Raises ViewError, and StartingError until the
        engine is up.
        """
        view = view_of(scene, params, self.settings)
        self.startup.check()
        return PictureRequest(scene.id, view, params.max_error or scene.target_error)

    async def render(
        self,
        request: Request,
        scene: Scene,
        params: ViewParams,
        finish: Callable[[Shown], Result],
        viewer: Viewer | None = None,
        pixel: tuple[int, int] | None = None,
    ) -> Result:
        """``finish`` of the picture that the parameters ask for, both off the event loop; for the
        request by default. Where a ``pixel`` is given, by column and row, and what the picture's
        rays met is not kept, the picture is of that pixel alone.

        Raises ViewError, BusyError, StoreError, StartingError until the engine is up, and Cancelled
        once the client has left: light that it alone requested is not baked then.
        """
        picture = self.picture_of(scene, params)
        if pixel is not None and not self.engine.sees(picture.scene, picture.view):
            picture = replace(picture, view=picture.view.pixel(*pixel))
        with self._requests.admitted(client_of(request.scope)) as place:
            answer = self._answer(
                picture, viewer or request_viewer(request), params.wait_ms / 1000, finish
            )
            return await attended(request, place.keep(answer))

    async def compute(self, request: Request, work: Callable[[], Result]) -> Result:
        """The result of some ``work`` for a request, off the event loop. Raises as ``render``
        does.
        """
        rank = self.rank(request_viewer(request), REQUEST_PATIENCE, self.settings.queue_seconds)
        with self._requests.admitted(client_of(request.scope)) as place:
            return await attended(request, place.keep(self.threads.pictures.run(work, rank)))

    def rank(self, viewer: Viewer, patience: float, longest: float = math.inf) -> Rank:
        """Where work for a ``viewer`` stands that may wait so many seconds, and waits for
        ``longest`` at most.

        Streams and addresses are clients that share the threads, and several programs may ask from
        one address.
        """
        if viewer.patient:
            weight = PATIENT
        elif viewer.single:
            weight = STREAM
        else:
            weight = ADDRESS
        return Rank.within(patience, longest, self.threads.pictures.client(viewer.client, weight))

    def draft_rank(self, viewer: Viewer) -> Rank:
        """Where a draft of a stream's view that moves stands, among drafts alone."""
        return Rank.within(DRAFT, client=self.threads.drafts.client(viewer.client, STREAM))

    async def show(
        self, picture: PictureRequest, viewer: Viewer, rank: Rank, watch: Stopwatch | None = None
    ) -> Shown:
        """The picture with the light baked so far; the light that it lacks is requested for the
        ``viewer``.
        """
        watch = watch or Stopwatch()
        since = self._newest(picture)
        frame = await self.frame_or_preview(picture, rank, watch)

        with watch.stage("demand"):
            coming = await self.request_light(picture, frame, viewer)
            if viewer.bakes:
                left = await self._time_left(picture, frame)
            else:
                left = None
        return Shown(frame, left, watch, coming, since)

    async def request_light(
        self, picture: PictureRequest, frame: Frame, viewer: Viewer
    ) -> frozenset[Index]:
        """Request the light that a frame lacks; the chunks that are coming."""
        if not viewer.bakes:
            return frozenset()
        want = partial(self.engine.want, picture.scene, frame, picture.target, viewer)
        return await self.threads.asking.run(want, Rank.within(DRAFT))

    async def _time_left(self, picture: PictureRequest, frame: Frame) -> TimeLeft | None:
        """The time until all the light that a frame lacks is there."""
        left = partial(self.engine.time_left, picture.scene, frame, picture.target)
        return await self.threads.asking.run(left, Rank.within(DRAFT))

    async def frame(self, picture: PictureRequest, rank: Rank, watch: Stopwatch) -> Frame:
        """The frame of a picture, drawn once for all requests that come meanwhile; no light is
        requested for it.

        A request that joins another counts all of the time as time in the queue. Waits for kernels
        of light that are still compiled; raises BusyError where others are.
        """
        if picture.view.shading in SPECS:
            await self.startup.lit.wait()
        elif picture.view.shading in SKETCHES:
            smooth = picture.view.smooth and self.startup.lit.is_set()
            picture = replace(picture, view=replace(picture.view, smooth=smooth))
        else:
            await self.startup.others(picture.view.shading, self.settings.queue_seconds)

        def work(cancelled: threading.Event) -> Frame:
            frame = self.engine.survey(
                picture.scene, picture.view, picture.target, cancelled, watch
            )
            frame.tail  # noqa: B018 (found on this thread, and kept: up to 35 ms, which the event loop has not)
            return frame

        with watch.stage("queue"):
            return await self.threads.drawing(picture.view).share(
                (picture, self._newest(picture)), work, rank
            )

    async def frame_or_preview(
        self, picture: PictureRequest, rank: Rank, watch: Stopwatch
    ) -> Frame:
        """The frame of a picture; an unshadowed one, all of it provisional, while it cannot have
        light.

        That is so where its light does not fit the memory, and while kernels of light are compiled.
        """
        if picture.view.shading not in SPECS or self.startup.lit.is_set():
            with suppress(NoRoomError):
                return await self.frame(picture, rank, watch)
        preview = replace(picture, view=replace(picture.view, shading=PREVIEW))
        frame = await self.frame(preview, rank.begun, watch)
        return replace(frame, state=np.minimum(frame.state, PROVISIONAL))

    async def refinements(
        self, picture: PictureRequest, viewer: Viewer
    ) -> AsyncGenerator[Shown, None]:
        """The picture at once, then a better one as light comes, until it is final or no more light
        is coming.

        All views that refine are drawn for no more than a share REFINING of the time together, so
        that the workers have the rest. The last picture of each comes at once, and so does one in
        which what was provisional has light. Where light was given up, the same picture comes once
        more: it is not final, and no more is coming.
        """
        known = None
        patience = REST_PATIENCE
        clock = asyncio.get_running_loop().time
        begun = clock()
        if not self.startup.lit.is_set():
            yield await self.show(picture, viewer, self.rank(viewer, patience))
            await self.startup.lit.wait()
        await self._ask_ahead(picture, viewer)
        while True:
            rank = self.rank(viewer, patience)
            place = await self.threads.enter(picture.view, rank)
            try:
                shown = replace(await self.show(picture, viewer, rank), place=place)
                given_up = not (shown.frame.final or shown.coming)
                now = (shown.frame.version, shown.frame.total)
                wait = await self._wait_after(shown)
                news = [shown] if now != known or given_up else []
                del shown  # megabytes, which nobody needs while a client takes the picture
                if news:
                    known = now
                    patience = REFINEMENT_PATIENCE
                    yield news.pop()
                if wait is None:
                    return
            finally:
                place.leave()
            await self._next_update(picture, wait, min(YOUNGER * (clock() - begun), LONGEST_PAUSE))

    async def _wait_after(self, shown: Shown) -> Wait | None:
        """What the next picture of a view waits for; None where none is coming."""
        if not shown.coming:
            return None
        return await self.threads.asking.run(partial(Wait.after, shown), Rank.within(DRAFT))

    async def _ask_ahead(self, picture: PictureRequest, viewer: Viewer) -> None:
        """Request the light of a view that is new before its first picture is lit: workers bake it
        meanwhile.

        Where others wait for their turn, that picture would come later for it.
        """

        def work(cancelled: threading.Event) -> Frame | None:
            with suppress(NoRoomError):
                return self.engine.unlit_frame(
                    picture.scene, picture.view, picture.target, cancelled
                )
            return None

        threads = self.threads.of(picture.view)
        if viewer.bakes and not threads.crowded:
            rank = self.rank(viewer, REST_PATIENCE)
            async with self.threads.kept(picture.view, rank):
                frame = await threads.share(("ahead", picture), work, rank)
                if frame is not None:
                    await self.request_light(picture, frame, viewer)
                    del frame

    def make_way(self) -> None:
        """Have the workers make way for a view that moves. Does not wait for that: a thread may
        have to be started.
        """
        asyncio.get_running_loop().run_in_executor(None, self.engine.baker.make_way)

    async def check(self, picture: PictureRequest) -> None:
        """Check a picture that nobody looks at, one step further. Raises as ``render`` does.

        One at a time: the steps of many jobs leave threads to what people wait for.
        """

        def work(cancelled: threading.Event) -> bool:
            return self.engine.check(picture.scene, picture.view, picture.target, cancelled)

        await self.threads.checks.share(picture, work, Rank.within(DRAFT))

    def leave(self, viewer: Viewer) -> None:
        """A viewer has left: bake nothing more for it alone. Does not wait for that."""
        asyncio.get_running_loop().run_in_executor(None, self.engine.leave, viewer)

    async def _answer(
        self,
        picture: PictureRequest,
        viewer: Viewer,
        wait: float,
        finish: Callable[[Shown], Result],
    ) -> Result:
        """``finish`` of the picture once its light is baked, or after ``wait`` seconds."""
        watch = Stopwatch()
        loop = asyncio.get_running_loop()
        rank = self.rank(viewer, REQUEST_PATIENCE, self.settings.queue_seconds)
        deadline = loop.time() + wait
        try:
            await within(wait, self.startup.lit)
            while True:
                with watch.stage("queue"):
                    place = await self.threads.enter(picture.view, rank)
                try:
                    shown = await self.show(picture, viewer, rank, watch)
                    rank = rank.begun
                    left = deadline - loop.time()
                    if not shown.coming or left <= 0:
                        made = partial(finish, shown)
                        return await self.threads.of(picture.view).run(made, rank)
                    coming = shown.coming
                    since = shown.since
                    del shown  # megabytes, which nobody needs while light is baked
                finally:
                    place.leave()
                with (
                    watch.stage("bake"),
                    self.updates.pending(self._bake(picture), coming, since) as pending,
                ):
                    await within(left, pending.all)
        except asyncio.CancelledError:
            self.leave(viewer)
            raise

    async def _next_update(self, picture: PictureRequest, wait: Wait, least: float) -> None:
        """Returns when it is time to draw the picture again: not before the ``least`` seconds,
        where it shows light.
        """
        self._refining += 1
        try:
            with self.updates.pending(
                self._bake(picture), wait.coming, wait.since, wait.dark
            ) as pending:
                await within(HEARTBEAT, pending.some)
                if wait.work:
                    pause = max((1.0 / REFINING - 1.0) * wait.work * self._refining, least)
                else:
                    pause = 0.0
                await within(max(pause, SHORTEST_PAUSE), pending.lit)
        finally:
            self._refining -= 1

    def _bake(self, picture: PictureRequest) -> str:
        return self.engine.bake_of(picture.scene, picture.view)

    def _newest(self, picture: PictureRequest) -> int:
        return self.updates.newest(self._bake(picture))


async def service_of(connection: HTTPConnection) -> Service:
    """The service of the app that the request came to; a coroutine, for anything else would have a
    thread started.
    """
    service: Service = connection.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(service_of)]


async def scene_of(scene: str, service: ServiceDep) -> Scene:
    """The scene that the path names."""
    return service.scene(scene)


async def bearer(connection: HTTPConnection) -> Bearer:
    """Who sends the request."""
    return bearer_of(connection.scope)


BearerDep = Annotated[Bearer, Depends(bearer)]


async def client(connection: HTTPConnection) -> tuple[str, str]:
    """Who sends the request, as limits count clients."""
    return client_of(connection.scope)


ClientDep = Annotated[tuple[str, str], Depends(client)]

SceneDep = Annotated[Scene, Depends(scene_of)]


DRAFTS = 2
"""Threads for drafts alone, so that none waits for a full picture to end."""

LARGE_PICTURE_PIXELS = 1 << 20
"""Pixels beyond which there is one picture at a time, from the first ray until it is encoded: each
takes up to 150 bytes a pixel.
"""

SENT_PIXELS = 1 << 18
SENT_PICTURES = 8
SENT_LARGE_PICTURES = 2
"""Pixels beyond which pictures that are encoded while they are sent (npy) are sent in turns; and
how many at once, those that are large by themselves.
"""

ASKING = 2
"""Threads that ask for light alone: they wait for each other at the queue of bakes, where no
picture shall wait.
"""


class RenderThreads:
    """Threads for each kind of work, so that none of them waits for another kind."""

    def __init__(self, pictures: int) -> None:
        """So many for ``pictures`` that are neither drafts nor large; one of them while drafts wait
        for their turn.
        """
        self.drafts = Renders(DRAFTS, even=True)  # drafts are sized to take about as long
        self.pictures = Renders(pictures, lambda: self.drafts.crowded)
        self.large = Renders(1)
        self._large_room = Room(1)
        self._sending = Room(SENT_PICTURES)
        self._sending_large = Room(SENT_LARGE_PICTURES)
        self.paths = LongRenders()
        self.large_paths = LongRenders(1)
        self.asking = Renders(ASKING)
        self.checks = Renders(1)

    def drawing(self, view: View) -> Renders:
        """The threads on which the picture of a view is drawn: those of path-traced ones have
        places of their own, for each takes up to minutes.
        """
        if view.shading != "path_traced":
            return self.of(view)
        if view.width * view.height > LARGE_PICTURE_PIXELS:
            return self.large_paths
        return self.paths

    def of(self, view: View) -> Renders:
        """The threads on which the picture of a view is drawn, and written as a file."""
        if view.moving:
            return self.drafts
        if view.width * view.height > LARGE_PICTURE_PIXELS:
            return self.large
        return self.pictures

    async def enter(self, view: View, rank: Rank) -> Entered:
        """A place in memory for the picture of a view, until it is left; one of few for a large
        one. Raises BusyError where there is none until the rank gives up.
        """
        if self.drawing(view) is self.large:
            return await self._large_room.enter(rank)
        return Entered()

    def sending(self, view: View) -> Room | None:
        """The places of pictures that are encoded while they are sent; None for small ones."""
        pixels = view.width * view.height
        if pixels > LARGE_PICTURE_PIXELS:
            return self._sending_large
        return self._sending if pixels > SENT_PIXELS else None

    @asynccontextmanager
    async def kept(self, view: View, rank: Rank) -> AsyncIterator[None]:
        """A place in memory for the picture of a view, for the block: see ``enter``."""
        place = await self.enter(view, rank)
        try:
            yield
        finally:
            place.leave()

    def close(self) -> None:
        """Take no more work; what still waits is dropped."""
        for each in (
            *(self.pictures, self.drafts, self.large, self.asking, self.checks),
            *(self.paths, self.large_paths),
        ):
            each.close()


ONCE = (
    "queue",
    "primary",
    "texels",
    "normals",
    "lobes",
)  # what they find is kept for a view's next pictures


@dataclass(frozen=True)
class PictureRequest:
    """A picture: a ``view`` of a scene, by its id, which is to reach the relative error
    ``target``.
    """

    scene: str
    view: View
    target: float

    def draft(self, scale: float) -> Self:
        """The draft of this view while it moves, in a picture of ``scale`` times the width and the
        height.
        """
        width, height = (
            max(round(scale * side), 1) for side in (self.view.width, self.view.height)
        )
        return replace(self, view=replace(self.view, width=width, height=height, moving=True))


@dataclass(frozen=True, eq=False)
class Shown:
    """The answer to a picture request: a ``frame``, the time until it is final, and the ``watch``
    of its stages.

    ``coming`` are the chunks that are going to be baked for it, and ``since`` numbers the newest
    update of light when the frame was begun. Its ``place`` in memory is left once it is encoded.
    """

    frame: Frame
    time_left: TimeLeft | None
    watch: Stopwatch
    coming: frozenset[Index]
    since: int
    place: Entered = field(default_factory=Entered)


class Wait(NamedTuple):
    """What a picture waits for: the chunks that are ``coming``, newer than the update ``since``;
    and the ``work`` on it, seconds, where it shows light. Parts of it are provisional until the
    ``dark`` ones have light.
    """

    coming: frozenset[Index]
    since: int
    work: float
    dark: frozenset[Index]

    @classmethod
    def after(cls, shown: Shown) -> Self:
        """What the next picture waits for."""
        if shown.frame.coverage["provisional"] == 1.0:
            return cls(shown.coming, shown.since, 0.0, frozenset())
        return cls(
            shown.coming, shown.since, work_of(shown), shown.frame.quality.dark & shown.coming
        )


def work_of(shown: Shown) -> float:
    """Seconds of work on a picture that the next one of its view takes again, without those in the
    queue.
    """
    return sum(seconds for stage, seconds in shown.watch.seconds.items() if stage not in ONCE)
