"""The service that all routes share: the engine, its start, the settings, and the way from a
request to pictures.
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
from isogi_core.bake.noise import Goal
from isogi_core.errors import IsogiError, NoRoomError, StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.tiles import Stopwatch
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View, nearest_turn
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_server.answers import scene_schema
from isogi_server.api.lifespan import Startup, within
from isogi_server.bearers import Bearer, bearer_of, client_of
from isogi_server.errors import ForbiddenError, StartingError, UnknownJobError, UnknownSceneError
from isogi_server.parameters import LightParams, VariantParams, ViewParams
from isogi_server.render.engine import RenderEngine
from isogi_server.render.jobs import ExportFolder, Job, Jobs
from isogi_server.render.picture_checks import CHECK
from isogi_server.render.scene_variant import Change
from isogi_server.render.scheduling import (
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
from isogi_server.render.update_bus import UpdateBus
from isogi_server.render.variants import Variants
from isogi_server.render.viewers import request_viewer, run_while_connected
from isogi_server.settings import Settings
from isogi_server.uploads.uploads import Uploads
from isogi_server.views import Turnable, goal_of, turn_asked, view_of
from isogi_worker.bake_requests import Viewer
from isogi_worker.progress import TimeLeft

Result = TypeVar("Result")

STREAM = 1.0
ADDRESS = 4.0
PATIENT = 0.25
"""Weights of clients that share the threads: a stream, all requests from one address, and
background work. A client of weight 4 gets four times the time of one of weight 1.
"""

PREVIEW = "lambert"
"""Shading that stands in for views whose light does not fit the memory, and for all views while
kernels of light are compiled.
"""

SKETCHES = (PREVIEW, "lambert_fog", "phong")
"""Shadings that need only the kernels compiled first."""

HEARTBEAT = 20.0
"""Seconds without an update after which light is requested again, as the baker drops requests
that are not renewed.
"""

SHORTEST_PAUSE = 0.1
REFINING = 0.25
"""Seconds between two pictures of a view at rest, at least; and the share of the time that
pictures of all views at rest together may take while light is baked. Neither holds back the
first picture with light, the first with some light everywhere, or the last.
"""

YOUNGER = 0.1
LONGEST_PAUSE = 5.0
"""Share of the time since a view was asked for that passes at least before its next picture,
and the most seconds that this may be. Errors fall with the square root of the number of paths:
a picture with a tenth more of them looks the same.
"""


class Service:
    """One render engine behind HTTP. It starts in the background, so that the socket answers
    meanwhile.
    """

    def __init__(self, engine: RenderEngine, settings: Settings) -> None:
        self.engine = engine
        self.settings = settings.answering
        self.startup = Startup(engine)
        # Set once the prewarms that the last server left open were looked for: see ``resume``.
        self.resumed = asyncio.Event()
        self.connections = AdmissionLimit(settings.streams, "streams are open")
        self.updates: UpdateBus
        self.jobs = Jobs(settings.jobs)
        self.threads = RenderThreads(settings.render_threads)
        self.uploads = Uploads(engine, settings)
        self.exports = ExportFolder(settings.exports_mb << 20)
        self.variants = Variants(
            engine, self.uploads.environment_at, patience=settings.patience.queue_seconds
        )
        self._requests = AdmissionLimit(
            settings.render_threads + settings.patience.render_queue, "frames wait", work=True
        )
        self._refining = 0

    async def start(self) -> None:
        """Start the engine, then open uploads and have updates published: see ``Startup``."""
        self.updates = UpdateBus()
        await self.startup.run(self._open, self._survey)

    def _open(self) -> None:
        """Open the uploads, and publish updates of light on the event loop."""
        self.uploads.open()
        self.engine.listen(self.updates.publish)

    def _survey(self, scene: Scene) -> None:
        """Compute the document of a scene, so that the first visitor does not wait for it."""
        with suppress(IsogiError):
            scene_schema(self.planned(scene))

    async def close(self) -> None:
        """Drop waiting work, and close the engine once its start has ended."""
        await self.jobs.close()
        await self.startup.close()
        self.threads.close()
        self.variants.close()
        self.uploads.close()
        self.exports.close()
        await asyncio.to_thread(self.engine.close)

    def job(self, key: str) -> Job:
        """Return the job with this id.

        Raises UnknownJobError if there is none, but StartingError while prewarms of the last server
        may still be resumed, as these keep their ids.
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
        """End a job, or forget it if it has ended. Raises ForbiddenError if the ``bearer``
        neither owns the job nor is an admin, and as ``job`` does.
        """
        job = self.job(key)
        if not bearer.owns(job.owner):
            raise ForbiddenError(
                f"The job '{job.id}' belongs to '{job.owner}': only the owner or an admin may "
                "dismiss it."
            )
        return await self.jobs.dismiss(job.id)

    def reason(self) -> str:
        """Return the reason why light is not baked."""
        return (
            self.engine.trouble() or "Some light that the view needs cannot be baked: see /bakez."
        )

    @property
    def attended(self) -> bool:
        """Return True if a client waits for a frame, or has a stream open."""
        return bool(self._requests.open or self.connections.open)

    def scene(self, name: str) -> Scene:
        """Return the scene with this id. Raises UnknownSceneError if there is none; a variant's
        id names no scene here.
        """
        scene = self.engine.scenes.get(name)
        if scene is None or self.engine.variant(name).any:
            raise UnknownSceneError(f"There is no scene '{name[:64]}': /v1/scenes lists them all.")
        return scene

    async def variant(self, scene: Scene, params: LightParams, client: Hashable) -> Scene:
        """Return the variant of a scene that the parameters of a ``client`` ask for: light, cut,
        time, material, surfaces, hidden labels, turn. Return the scene itself if they change
        nothing.

        Raises ParameterError if it cannot be made, ViewError for a turn without meaning, and
        StartingError until the engine is open.
        """
        change = Change(params.environment)
        if isinstance(params, VariantParams):
            change = Change(**params.model_dump(include={*VariantParams.model_fields}))
        if isinstance(params, Turnable):
            change = replace(change, turn=nearest_turn(turn_asked(params)))
        if change != Change():
            self.startup.check()
        return await self.variants.of(scene, change, client)

    def planned(self, scene: Scene) -> Scene:
        """Return the ``scene`` with the plan of the light that its store has, or as it is if
        that cannot be read now.
        """
        if not self.startup.open:
            return scene
        with suppress(StoreError):
            return self.engine.planned(scene.id)
        return scene

    def picture_of(self, scene: Scene, params: ViewParams) -> PictureRequest:
        """Return the picture request that the parameters of a query describe. Raises ViewError,
        and StartingError until the engine is open.
        """
        view = view_of(scene, params, self.settings)
        self.startup.check()
        return PictureRequest(scene.id, view, goal_of(scene, params.max_error))

    async def render(
        self,
        request: Request,
        scene: Scene,
        params: ViewParams,
        finish: Callable[[Shown], Result],
        viewer: Viewer | None = None,
        pixel: tuple[int, int] | None = None,
    ) -> Result:
        """Render the picture that the parameters ask for, and return ``finish`` of it; both run on
        threads.

        By default the light is baked for the viewer of the request. If a ``pixel`` (column, row) is
        given and the G-buffer of the view is not kept, only this pixel is drawn.

        Raises ViewError, BusyError, StoreError, StartingError until the engine is open, and
        Cancelled if the client disconnects: light that only this client requested is then not
        baked.
        """
        picture = self.picture_of(scene, params)
        if pixel is not None and not self.engine.sees(picture.scene, picture.view):
            picture = replace(picture, view=picture.view.pixel(*pixel))
        with self._requests.admitted(client_of(request.scope)) as place:
            answer = self._answer(
                picture, viewer or request_viewer(request), params.wait_ms / 1000, finish
            )
            return await run_while_connected(request, place.keep(answer))

    async def compute(self, request: Request, work: Callable[[], Result]) -> Result:
        """Return the result of some ``work`` for a request, run on a thread. Raises as
        ``render`` does.
        """
        rank = self.rank(
            request_viewer(request), REQUEST_PATIENCE, self.settings.patience.queue_seconds
        )
        with self._requests.admitted(client_of(request.scope)) as place:
            return await run_while_connected(
                request, place.keep(self.threads.pictures.run(work, rank))
            )

    def rank(self, viewer: Viewer, patience: float, longest: float = math.inf) -> Rank:
        """Return the rank of work for a ``viewer`` that can wait for ``patience`` seconds, and
        gives up after ``longest``.

        An address has a larger weight than a stream, as several programs may ask from it.
        """
        if viewer.patient:
            weight = PATIENT
        elif viewer.single:
            weight = STREAM
        else:
            weight = ADDRESS
        return Rank.within(patience, longest, self.threads.pictures.client(viewer.client, weight))

    def draft_rank(self, viewer: Viewer) -> Rank:
        """Return the rank of a draft of a moving view, among drafts only."""
        return Rank.within(DRAFT, client=self.threads.drafts.client(viewer.client, STREAM))

    async def show(
        self, picture: PictureRequest, viewer: Viewer, rank: Rank, watch: Stopwatch | None = None
    ) -> Shown:
        """Draw the picture with the light baked so far, and request the light that it lacks for the
        ``viewer``. Return the answer; the caller sends it.
        """
        watch = watch or Stopwatch()
        # Take the number before drawing: light that comes from now on may be missing in the frame,
        # and gets a higher one.
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
        """Request the light that a frame lacks. Return the chunks that will be baked, with CHECK if
        the picture will be checked: see ``RenderEngine.want``. Nothing is requested for a viewer
        that may not bake.
        """
        if not viewer.bakes:
            return frozenset()
        want = partial(self.engine.want, picture.scene, frame, picture.goal, viewer)
        return await self.threads.asking.run(want, Rank.within(DRAFT))

    async def _time_left(self, picture: PictureRequest, frame: Frame) -> TimeLeft | None:
        """Estimate the time until all light that a frame lacks is baked."""
        left = partial(self.engine.time_left, picture.scene, frame, picture.goal)
        return await self.threads.asking.run(left, Rank.within(DRAFT))

    async def frame(self, picture: PictureRequest, rank: Rank, watch: Stopwatch) -> Frame:
        """Draw the frame of a picture with the light that is there, and request none. Requests for
        the same frame that come while it is drawn get it, too.

        A request that joins another one counts its time as time in the queue. Shadings with texels
        wait until kernels of light are loaded. All others except sketches wait for kernels of their
        own; raises BusyError if these take too long.
        """
        # Wait for the kernels that this shading needs. Sketches need no wait, but their edges are
        # not smoothed before kernels of light are loaded.
        if picture.view.shading in SPECS:
            await self.startup.lit.wait()
        elif picture.view.shading in SKETCHES:
            smooth = picture.view.smooth and self.startup.lit.is_set()
            picture = replace(picture, view=replace(picture.view, smooth=smooth))
        else:
            await self.startup.others(picture.view.shading, self.settings.patience.queue_seconds)

        def work(cancelled: threading.Event) -> Frame:
            frame = self.engine.survey(picture.scene, picture.view, picture.goal, cancelled, watch)
            # Compute the tail now: it takes up to 35 ms, too long for the event loop.
            frame.tail  # noqa: B018
            return frame

        # The newest update is part of the key: a request after new light does not join a drawing
        # that began before it. Stages that ``work`` times do not count as time in the queue.
        with watch.stage("queue"):
            return await self.threads.drawing(picture.view).share(
                (picture, self._newest(picture)), work, rank
            )

    async def frame_or_preview(
        self, picture: PictureRequest, rank: Rank, watch: Stopwatch
    ) -> Frame:
        """Return the frame of a picture. If its light does not fit the memory, or if kernels of
        light are still compiled, return an unshadowed one instead, provisional everywhere.
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
        """Yield the picture at once, then better ones as light is baked, until it is final or no
        more light will come.

        Pictures of all views at rest take at most the share REFINING of the time, so that workers
        have the rest. The last picture of a view comes at once, and so does the first in which
        nothing is provisional. If light was given up, the same picture is yielded once more, with
        nothing coming.
        """
        yielded = None
        patience = REST_PATIENCE
        clock = asyncio.get_running_loop().time
        begun = clock()
        # Yield a preview if kernels of light are still being compiled, and wait for them. It lacks
        # no light of its own, but the picture comes.
        if not self.startup.lit.is_set():
            preview = await self.show(picture, viewer, self.rank(viewer, patience))
            yield replace(preview, coming=preview.coming or frozenset({CHECK}))
            del preview
            await self.startup.lit.wait()
        await self._ask_ahead(picture, viewer)
        while True:
            rank = self.rank(viewer, patience)
            place = await self.threads.enter(picture.view, rank)
            try:
                shown = replace(await self.show(picture, viewer, rank), place=place)
                given_up = not (shown.frame.final or shown.coming)
                drawn = (shown.frame.version, shown.frame.total)
                wait = await self._wait_after(shown)
                # Yield a picture only if its light or its measured error changed.
                better = [shown] if drawn != yielded or given_up else []
                # Free megabytes while the client takes the picture: only the list holds it.
                del shown
                if better:
                    yielded = drawn
                    patience = REFINEMENT_PATIENCE
                    yield better.pop()
                if wait is None:
                    return
            finally:
                place.leave()
            # The older the picture, the longer until more paths can be seen: pause for a share of
            # its age.
            await self._next_update(picture, wait, min(YOUNGER * (clock() - begun), LONGEST_PAUSE))

    async def _wait_after(self, shown: Shown) -> Wait | None:
        """Return the wait for the next picture of a view; None if none is coming."""
        if not shown.coming:
            return None
        return await self.threads.asking.run(partial(Wait.after, shown), Rank.within(DRAFT))

    async def _ask_ahead(self, picture: PictureRequest, viewer: Viewer) -> None:
        """Request the light of a new view before its first picture is lit, so that workers bake it
        meanwhile.

        Skipped if others wait for a turn, as it would delay the picture by a further turn.
        """

        def work(cancelled: threading.Event) -> Frame | None:
            with suppress(NoRoomError):
                return self.engine.unlit_frame(picture.scene, picture.view, picture.goal, cancelled)
            return None

        # Share the work among clients that open the same view.
        threads = self.threads.of(picture.view)
        if viewer.bakes and not threads.crowded:
            rank = self.rank(viewer, REST_PATIENCE)
            async with self.threads.kept(picture.view, rank):
                frame = await threads.share(("ahead", picture), work, rank)
                if frame is not None:
                    await self.request_light(picture, frame, viewer)
                    del frame

    def make_way(self) -> None:
        """Have the workers leave cores free for a view that moves. Runs on a thread, as the
        call may have to start one.
        """
        asyncio.get_running_loop().run_in_executor(None, self.engine.baker.make_way)

    async def check(self, picture: PictureRequest) -> None:
        """Take one step of the check of a picture that no client looks at. Raises as ``render``
        does. One step is taken at a time, so that jobs leave threads to people.
        """

        def work(cancelled: threading.Event) -> bool:
            return self.engine.check(picture.scene, picture.view, picture.goal, cancelled)

        await self.threads.checks.share(picture, work, Rank.within(DRAFT))

    def leave(self, viewer: Viewer) -> None:
        """Drop the requests of a viewer that has gone. Runs on a thread."""
        asyncio.get_running_loop().run_in_executor(None, self.engine.leave, viewer)

    async def _answer(
        self,
        picture: PictureRequest,
        viewer: Viewer,
        wait: float,
        finish: Callable[[Shown], Result],
    ) -> Result:
        """Return ``finish`` of the picture once its light is baked, or after ``wait`` seconds."""
        watch = Stopwatch()
        loop = asyncio.get_running_loop()
        rank = self.rank(viewer, REQUEST_PATIENCE, self.settings.patience.queue_seconds)
        deadline = loop.time() + wait
        try:
            # Draw the picture, and draw it again when all light that was coming for it has come.
            await within(wait, self.startup.lit)
            while True:
                with watch.stage("queue"):
                    place = await self.threads.enter(picture.view, rank)
                try:
                    shown = await self.show(picture, viewer, rank, watch)
                    # A picture whose work has begun does not give up any more: time spent on it
                    # would be lost.
                    rank = rank.begun
                    left = deadline - loop.time()
                    if not shown.coming or left <= 0:
                        made = partial(finish, shown)
                        return await self.threads.of(picture.view).run(made, rank)
                    # If light is coming, wait for no check of the picture as it is without it.
                    coming = shown.coming - {CHECK} or shown.coming
                    since = shown.since
                    del shown  # Free megabytes while light is baked.
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
        """Return when it is time to draw the picture again, not before ``least`` seconds if it
        shows light already.
        """
        self._refining += 1
        try:
            with self.updates.pending(
                self._bake(picture), wait.coming, wait.since, wait.dark
            ) as pending:
                await within(HEARTBEAT, pending.some)
                # Drawing takes wait.work seconds: pause so long that the pictures of all refining
                # views take a share REFINING of the time.
                if wait.work:
                    pause = max((1.0 / REFINING - 1.0) * wait.work * self._refining, least)
                else:
                    pause = 0.0
                # A picture that gets light in its last dark part ends the pause.
                await within(max(pause, SHORTEST_PAUSE), pending.lit)
        finally:
            self._refining -= 1

    def _bake(self, picture: PictureRequest) -> str:
        """Return the name of the bake that a picture reads."""
        return self.engine.bake_of(picture.scene, picture.view)

    def _newest(self, picture: PictureRequest) -> int:
        """Return the number of the newest update of light for a picture."""
        return self.updates.newest(self._bake(picture))


async def service_of(connection: HTTPConnection) -> Service:
    """Return the service of the app that a request came to. A coroutine, as FastAPI runs plain
    functions on a thread.
    """
    service: Service = connection.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(service_of)]


async def scene_of(scene: str, service: ServiceDep) -> Scene:
    """Return the scene that the path names."""
    return service.scene(scene)


async def bearer(connection: HTTPConnection) -> Bearer:
    """Return the bearer of the token that the request came with."""
    return bearer_of(connection.scope)


BearerDep = Annotated[Bearer, Depends(bearer)]


async def client(connection: HTTPConnection) -> tuple[str, str]:
    """Return the client that sends the request, as limits count clients."""
    return client_of(connection.scope)


ClientDep = Annotated[tuple[str, str], Depends(client)]

SceneDep = Annotated[Scene, Depends(scene_of)]


DRAFTS = 2
"""Threads for drafts alone, so that no draft waits for a full picture to end."""

LARGE_PICTURE_PIXELS = 1 << 20
"""Pixels above which there is one picture at a time, from its first ray until it is encoded: each
takes up to 150 bytes a pixel.
"""

SENT_PIXELS = 1 << 18
"""Pixels above which a picture that is encoded while it is sent (npy) waits for a place."""

SENT_PICTURES = 8
"""Most pictures of SENT_PIXELS up to LARGE_PICTURE_PIXELS that are sent as npy at once."""

SENT_LARGE_PICTURES = 2
"""Most pictures of more than LARGE_PICTURE_PIXELS that are sent as npy at once."""

ASKING = 2
"""Threads that request light. They wait for each other at the lock of the bake queue, and no
picture shall wait for that.
"""


class RenderThreads:
    """Threads for each kind of work, so that no kind waits for another."""

    def __init__(self, pictures: int) -> None:
        """Use ``pictures`` threads for pictures that are neither drafts nor large; one of them
        while drafts wait for their turn.
        """
        # Drafts are sized to take about the same time each, so that turns may count alike.
        self.drafts = Renders(DRAFTS, even=True)
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
        """Return the threads on which the picture of a view is drawn. Path-traced pictures take
        up to minutes and have separate places.
        """
        if view.shading != "path_traced":
            return self.of(view)
        if view.width * view.height > LARGE_PICTURE_PIXELS:
            return self.large_paths
        return self.paths

    def of(self, view: View) -> Renders:
        """Return the threads on which the picture of a view is encoded, and on which it is
        drawn if it is not path-traced.
        """
        if view.moving:
            return self.drafts
        if view.width * view.height > LARGE_PICTURE_PIXELS:
            return self.large
        return self.pictures

    async def enter(self, view: View, rank: Rank) -> Entered:
        """Take a place in memory for the picture of a view, to be left by the caller; large
        pictures share one. Raises BusyError if the rank gives up before.
        """
        if self.drawing(view) is self.large:
            return await self._large_room.enter(rank)
        return Entered()

    def sending(self, view: View) -> Room | None:
        """Return the room in which the picture of a view takes a place while it is sent, if it is
        encoded meanwhile (npy); None if it is so small that it needs no place. No place is taken
        here.
        """
        pixels = view.width * view.height
        if pixels > LARGE_PICTURE_PIXELS:
            return self._sending_large
        if pixels > SENT_PIXELS:
            return self._sending
        return None

    @asynccontextmanager
    async def kept(self, view: View, rank: Rank) -> AsyncIterator[None]:
        """Take a place in memory for the picture of a view, for the block: see ``enter``."""
        place = await self.enter(view, rank)
        try:
            yield
        finally:
            place.leave()

    def close(self) -> None:
        """Accept no more work, and drop work that still waits."""
        for each in (
            *(self.pictures, self.drafts, self.large, self.asking, self.checks),
            *(self.paths, self.large_paths),
        ):
            each.close()


ONCE = ("queue", "primary", "texels", "normals", "lobes")
"""Stages that the next pictures of a view do not repeat: their results are kept."""


@dataclass(frozen=True)
class PictureRequest:
    """A picture: a ``view`` of a scene, by its id, and the ``goal`` that it is to reach."""

    scene: str
    view: View
    goal: Goal

    def draft(self, scale: float) -> Self:
        """Return the request for a draft of this view while it moves, with ``scale`` times the
        width and height.
        """
        width, height = (
            max(round(scale * side), 1) for side in (self.view.width, self.view.height)
        )
        return replace(self, view=replace(self.view, width=width, height=height, moving=True))


@dataclass(frozen=True, eq=False)
class Shown:
    """The answer to a picture request: a ``frame``, the time until it is final, and the ``watch``
    that timed its stages.

    ``coming`` are the chunks that will be baked for it, with CHECK if its picture will be checked;
    ``since`` is the number of the newest update of light when the frame was begun. Its ``place`` in
    memory is left once it is encoded.
    """

    frame: Frame
    time_left: TimeLeft | None
    watch: Stopwatch
    coming: frozenset[Index]
    since: int
    place: Entered = field(default_factory=Entered)


class Wait(NamedTuple):
    """The wait of a picture for light: for the chunks ``coming``, by updates newer than ``since``.

    ``work`` are the seconds that drawing it takes, 0 if it shows no light yet. Parts of the picture
    are provisional until the ``dark`` chunks have light.
    """

    coming: frozenset[Index]
    since: int
    work: float
    dark: frozenset[Index]

    @classmethod
    def after(cls, shown: Shown) -> Self:
        """Return the wait for the picture that follows ``shown``."""
        if shown.frame.coverage["provisional"] == 1.0:
            return cls(shown.coming, shown.since, 0.0, frozenset())
        return cls(
            shown.coming, shown.since, work_of(shown), shown.frame.quality.dark & shown.coming
        )


def work_of(shown: Shown) -> float:
    """Return the seconds of drawing that the next picture of the view takes too: without the
    queue, and without stages whose results are kept.
    """
    return sum(seconds for stage, seconds in shown.watch.seconds.items() if stage not in ONCE)
