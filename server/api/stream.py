"""A stream: what goes over a WebSocket, from the first view of one client to its leaving."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from contextlib import aclosing, suppress
from typing import Annotated, Any, NoReturn

from fastapi import APIRouter, WebSocket
from pydantic import Field, StrictBool
from starlette.websockets import WebSocketDisconnect

from isogi_core.errors import IsogiError
from isogi_core.frame.tiles import Stopwatch
from isogi_core.plan.scene import Scene
from server.answers import chunks_in, coverage_schema
from server.api.lifespan import within
from server.api.service import PictureRequest, Service, ServiceDep, Shown
from server.bearers import client_of
from server.card_schemas import CardChunk
from server.errors import BusyError, ParameterError, StreamError
from server.parameters import FrameParams, NoParams, read
from server.pictures import MEDIA_TYPES, encode, format_for, smoothed
from server.problems import parameter_named, problem, problem_document, refusal, status_of
from server.render.bakes import stream_viewer
from server.render.metrics import Metrics
from server.render.scheduling import DRAFT, Place, Rank
from server.settings import Settings
from server.values import Span


def mixed(newest: float, before: float, fresh: float) -> float:
    """The mean with the ``newest``, which counts by the share ``fresh``, from that ``before``, 0
    for unknown.
    """
    return fresh * newest + (1.0 - fresh) * (before or newest)


HALF = 0.5
QUARTER = 0.25
"""Shares of the full width and height that drafts have."""

MAX_DRAFT_SECONDS = 0.045
"""Seconds that a draft may be drawn and shown for."""

PACE_MARGIN = 0.8
"""Share of that time in which larger drafts must be expected to come before they are tried."""

FRESH = 0.5
"""How much the newest draft counts in what drafts are taken to need, against all before it."""


class Drafts:
    """The ``scale`` of a connection's drafts: a half of the full width and height, or a quarter
    where that is slow.
    """

    def __init__(self, crowded: bool = False) -> None:
        """Begin with halves, or with quarters where others wait for theirs."""
        self.scale = QUARTER if crowded else HALF
        self._drawn = self._shown = 0.0

    def shown(self, seconds: float) -> None:
        """The client took so long to show a draft that it was sent, as it says itself."""
        self._shown = mixed(seconds, self._shown, FRESH)

    def drawn(self, seconds: float) -> None:
        """A draft at ``scale`` was drawn for so long: size the next."""
        self._drawn = mixed(seconds, self._drawn, FRESH)
        took = self._drawn + self._shown
        pixels = (HALF / QUARTER) ** 2
        if self.scale == HALF and took > MAX_DRAFT_SECONDS:
            self._resize(QUARTER, 1.0 / pixels)
        elif self.scale == QUARTER and pixels * took < PACE_MARGIN * MAX_DRAFT_SECONDS:
            self._resize(HALF, pixels)

    def _resize(self, scale: float, pixels: float) -> None:
        self.scale = scale
        self._drawn = pixels * self._drawn
        self._shown = pixels * self._shown


MAX_PICTURES_AHEAD = 2
"""Pictures that may be under way."""

RECEIPT_SECONDS = 1.0
"""Seconds after which a picture that was not acknowledged is taken for shown."""


class Window:
    """What was sent over one connection. Belongs to its event loop."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, float]] = deque()
        self._moved = asyncio.Event()

    def sent(self, request: int) -> None:
        """A picture for the request of this id was sent."""
        self._sent.append((request, asyncio.get_running_loop().time()))

    def shown(self, request: int) -> None:
        """The client shows the first picture under way for a request; those before it are done."""
        if any(each == request for each, _ in self._sent):
            while self._sent.popleft()[0] != request:
                pass
            self._moved.set()

    async def room(self) -> None:
        """Returns when another picture may be sent."""
        while len(self._sent) >= MAX_PICTURES_AHEAD:
            left = self._sent[0][1] + RECEIPT_SECONDS - asyncio.get_running_loop().time()
            if left <= 0.0:
                self._sent.popleft()
                continue
            self._moved.clear()
            await within(left, self._moved)


GAP = 1.0
"""Seconds after the last view of a hand that moves for which it is taken to move on."""


class Motion:
    """How well a stream follows: ``drafts`` that were sent, and the ``seconds`` in which its view
    moved.

    ``since`` is when the newest view came. Belongs to its event loop.
    """

    def __init__(self) -> None:
        self.drafts = 0
        self.seconds = 0.0
        self.since = 0.0
        self._moving_since: float | None = None

    def took(self, moving: bool) -> None:
        """A view came, and it moves or rests."""
        now = asyncio.get_running_loop().time()
        if self._moving_since is not None:
            self.seconds += min(now - self._moving_since, GAP)
        self._moving_since = now if moving else None
        self.since = now

    def sent(self, came: float, draft: bool) -> float:
        """A picture is sent of the view that ``came`` then; how old it is."""
        self.drafts += draft
        return asyncio.get_running_loop().time() - came


CLOSE_TOO_BIG = 1009
CLOSE_POLICY = 1008
CLOSE_TRY_LATER = 1013
CLOSE_IDLE = 4000
"""Codes that a stream is closed with (RFC 6455, 7.4): a message is too long; too many, or no text;
another client needs the place; none for long."""


class Inbox:
    """The messages of a stream, as long as they keep within the settings."""

    def __init__(self, socket: WebSocket, settings: Settings, place: Place) -> None:
        self._socket = socket
        self._settings = settings
        self._place = place
        self._second = 0
        self._count = 0

    async def next(self) -> str | None:
        """The next message; None when the client has gone. Raises StreamError where it breaks a
        limit.
        """
        try:
            message = await asyncio.wait_for(
                self._socket.receive(), self._settings.stream_idle_seconds
            )
        except TimeoutError:
            raise StreamError(
                f"No message for {self._settings.stream_idle_seconds:g} seconds.", CLOSE_IDLE
            ) from None
        if message["type"] == "websocket.disconnect":
            return None
        self._count_one()
        self._place.use()
        text = message.get("text")
        if text is None:
            raise StreamError("Messages must be text.", CLOSE_POLICY)
        if len(text.encode()) > self._settings.stream_bytes:
            raise StreamError(
                f"A message is longer than {self._settings.stream_bytes} bytes.", CLOSE_TOO_BIG
            )
        return str(text)

    def _count_one(self) -> None:
        second = int(asyncio.get_running_loop().time())
        if second == self._second:
            self._count = self._count + 1
        else:
            self._count = 1
        self._second = second
        if self._count > self._settings.stream_rate:
            raise StreamError(
                f"More than {self._settings.stream_rate} messages in a second.", CLOSE_POLICY
            )


Id = Annotated[int, Span(0, 2**53 - 1, whole=True)]


class Receipt(NoParams):
    """The client has shown a picture of the view with this id; it ``took`` so many milliseconds
    from when it came.
    """

    shown: Id
    took: Annotated[float, Span(0.0, 60_000.0)] = 0.0


class ViewRequest(NoParams):
    """The client's view is now this one, and whether it is still ``moving``; at rest it may ask for
    ``chunks``.

    A client that draws what moves by itself wants no ``pictures`` of it.
    """

    id: Id
    view: dict[str, Any] = Field(default_factory=dict)
    moving: StrictBool = False
    chunks: StrictBool = False
    pictures: StrictBool = True

    def params(self) -> FrameParams:
        """The view's parameters; ParameterError where they are not those of a frame."""
        params = read(FrameParams, self.view.items())
        if "wait_ms" in params.model_fields_set:
            raise ParameterError(
                "wait_ms is for requests, a stream sends new pictures by itself: leave it out.",
                "wait_ms",
            )
        return params


def message_of(text: str) -> dict[str, Any]:
    """The JSON object in a message; ParameterError where there is none."""
    try:
        message = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise ParameterError("A message must be JSON, with numbers that are finite.") from None
    if not isinstance(message, dict):
        raise ParameterError(
            'A message must be an object such as {"id": 1, "view": {}} or {"shown": 1}.'
        )
    return message


def read_message(message: dict[str, Any]) -> ViewRequest | Receipt:
    """The message as what it is; ParameterError on the first thing that is wrong."""
    if "shown" in message:
        return read(Receipt, message.items())
    return read(ViewRequest, message.items())


def answer(
    request: int, shown: Shown, form: str, draft: bool, chunks: list[CardChunk] | None = None
) -> str:
    """The facts of the picture that follows, an answer to the ``request`` of this id, and the
    chunks that it reads.
    """
    frame = shown.frame
    if chunks is None:
        named = {}
    else:
        named = {"chunks": [each.model_dump() for each in chunks]}
    return json.dumps(
        {
            "id": request,
            "draft": draft,
            "final": not draft and frame.final,
            "width": frame.view.width,
            "height": frame.view.height,
            "media_type": MEDIA_TYPES[form],
            "facts": coverage_schema(frame, shown.time_left).model_dump(),
            "timing": {
                stage: round(1000.0 * seconds, 2) for stage, seconds in shown.watch.seconds.items()
            },
        }
        | named
    )


def complaint(request: Any, error: IsogiError, path: str) -> str:
    """A problem with the message of this id, null where it has none."""
    document = problem_document(status_of(error), str(error), path, **parameter_named(error))
    return json.dumps({"id": request if isinstance(request, int) else None, "problem": document})


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


WANT_EVERY = 0.5
"""Seconds between two drafts of a moving view whose light is asked for: what it shows next needs
much of the same.
"""


class Session:
    """Answers the newest view that its client sent; work on an older one ends.

    A draft alone is drawn to its end while the view goes on moving: else none would be when views
    come faster.
    """

    def __init__(self, socket: WebSocket, service: Service, scene: Scene, place: Place) -> None:
        self._socket = socket
        self._service = service
        self._scene = scene
        self._lit = scene
        self._metrics: Metrics = socket.app.state.metrics
        self._viewer = stream_viewer(socket)
        self._inbox = Inbox(socket, service.settings, place)
        self._drafts = Drafts(service.threads.drafts.crowded)
        self._window = Window()
        self._motion = Motion()
        self._sending = asyncio.Lock()
        self._newest: tuple[ViewRequest, FrameParams] | None = None
        self._changed = asyncio.Event()
        self._showing: asyncio.Task[None] | None = None
        self._wanted = -WANT_EVERY
        self._still = -1
        self._shows: float | None = None

    async def run(self) -> None:
        """Returns when the client has left, or broke a limit; nothing is baked for it any more."""
        reading = asyncio.create_task(self._read())
        working = asyncio.create_task(self._work())
        try:
            await asyncio.wait({reading, working}, return_when=asyncio.FIRST_COMPLETED)
            for task in (reading, working):
                if task.done():
                    await task
        except StreamError as error:
            with suppress(
                WebSocketDisconnect, RuntimeError
            ):  # the client, or its broken frame, may have closed it
                await self._socket.close(error.code, str(error))
        except WebSocketDisconnect:
            pass
        finally:
            reading.cancel()
            working.cancel()
            await asyncio.wait({reading, working})
            self._service.leave(self._viewer)
            self._motion.took(moving=False)
            self._metrics.count_motion(self._motion.drafts, self._motion.seconds)

    async def _read(self) -> None:
        """Take in messages until the client leaves."""
        while (text := await self._inbox.next()) is not None:
            request: Any = None
            try:
                message = message_of(text)
                request = message.get("id")
                self._take(read_message(message))
            except IsogiError as error:
                await self._send(complaint(request, error, self._socket.url.path))

    def _take(self, message: ViewRequest | Receipt) -> None:
        if isinstance(message, Receipt):
            self._window.shown(message.shown)
            if message.shown != self._still:
                self._drafts.shown(message.took / 1000.0)
            return
        if not (message.moving):
            self._still = message.id
        older = self._newest
        self._newest = (message, message.params())
        self._motion.took(message.moving and message.pictures)
        self._changed.set()
        if self._showing and not (older and older[0].moving and message.moving):
            self._showing.cancel()

    async def _work(self) -> None:
        """Show the newest view, again and again."""
        while True:
            await self._changed.wait()
            await self._window.room()
            self._changed.clear()
            self._shows = self._motion.since
            assert self._newest
            self._showing = asyncio.create_task(self._show(*self._newest))
            try:
                await asyncio.wait({self._showing})
            finally:
                self._showing.cancel()
                await asyncio.wait({self._showing})
            if not self._showing.cancelled():
                self._showing.result()

    async def _show(self, request: ViewRequest, params: FrameParams) -> None:
        """Answer a view request, or send what is wrong with it."""
        if not request.pictures:
            return
        try:
            form = format_for(params, None)
            self._lit = await self._service.variant(
                self._scene, params, client_of(self._socket.scope)
            )
            picture = self._service.picture_of(self._lit, smoothed(params, form))
            await (
                self._draft(request, params, picture)
                if request.moving
                else self._rest(request, params, picture, form)
            )
        except IsogiError as error:
            if why := refusal(error):
                self._metrics.refused.labels(why).inc()
            await self._send(complaint(request.id, error, self._socket.url.path))

    async def _draft(
        self, request: ViewRequest, params: FrameParams, picture: PictureRequest
    ) -> None:
        """One picture of a view that moves, as large as it can come quickly, and coded as fast."""
        self._service.make_way()
        small = picture.draft(self._drafts.scale)
        watch = Stopwatch()
        rank = self._service.draft_rank(self._viewer)
        frame = await self._service.frame_or_preview(small, rank, watch)
        shown = Shown(frame, None, watch, frozenset(), 0)
        self._drafts.drawn(sum(watch.seconds.values()))  # smaller ones where many wait
        await self._hand_over(request, *await self._made(request, params, shown, "jpeg", rank))
        now = asyncio.get_running_loop().time()
        if now - self._wanted >= WANT_EVERY:
            self._wanted = now
            await self._service.request_light(small, frame, self._viewer)

    async def _rest(
        self, request: ViewRequest, params: FrameParams, picture: PictureRequest, form: str
    ) -> None:
        """The full picture of a view at rest, and each better one, until it is final."""
        async with aclosing(self._service.refinements(picture, self._viewer)) as refinements:
            async for shown in refinements:
                rank = self._service.rank(self._viewer, DRAFT)
                made = await self._made(request, params, shown, form, rank)
                shown.place.leave()
                del shown  # megabytes, while the client catches up and light is baked
                await self._hand_over(request, *made)
                await self._window.room()

    async def _made(
        self, request: ViewRequest, params: FrameParams, shown: Shown, form: str, rank: Rank
    ) -> tuple[str, bytes]:
        """The facts of a picture, and its bytes."""
        if params.exposure is None:
            exposure = self._lit.default_exposure
        else:
            exposure = params.exposure

        def made() -> tuple[str, bytes]:
            with shown.watch.stage("encode"):
                picture = encode(shown.frame, form, exposure, params)
            return answer(
                request.id, shown, form, request.moving, self._chunks(request, shown)
            ), picture

        found = await self._service.threads.of(shown.frame.view).run(made, rank)
        self._metrics.count_picture(
            "draft" if request.moving else "stream", not shown.frame.final, shown.watch.seconds
        )
        return found

    async def _hand_over(self, request: ViewRequest, facts: str, picture: bytes) -> None:
        """Send a picture and its facts."""
        self._window.sent(request.id)
        if self._shows is not None:
            self._metrics.ages.observe(self._motion.sent(self._shows, request.moving))
            self._shows = None
        await self._send(facts, picture)

    def _chunks(self, request: ViewRequest, shown: Shown) -> list[CardChunk] | None:
        """The chunks that a full picture reads, where the client asks for them."""
        if request.moving or not request.chunks:
            return None
        return chunks_in(self._service.engine.renderer(self._lit.id), shown.frame)

    async def _send(self, text: str, data: bytes | None = None) -> None:
        """Send all of it or nothing, also where the sender is cancelled on the way."""
        await asyncio.shield(self._send_all(text, data))

    async def _send_all(self, text: str, data: bytes | None) -> None:
        with suppress(WebSocketDisconnect, RuntimeError):
            async with self._sending:
                await self._socket.send_text(text)
                if data is not None:
                    await self._socket.send_bytes(data)


async def kept(socket: WebSocket, session: Session, place: Place) -> None:
    """Run a session until its client leaves, or another one needs its place."""
    try:
        await place.keep(session.run())
    except BusyError as error:
        with suppress(WebSocketDisconnect, RuntimeError):
            await socket.close(CLOSE_TRY_LATER, str(error))


router = APIRouter(prefix="/v1/scenes/{scene}")


@router.websocket("/stream")
async def stream(socket: WebSocket, scene: str, service: ServiceDep) -> None:
    """The client sends views, the newest wins: drafts while it moves, the full picture at rest,
    better as light comes.

    Refused with a problem before it begins where the scene is unknown, or too many streams are
    open.
    """
    try:
        found = service.scene(scene)
        with service.connections.admitted(client_of(socket.scope)) as place:
            await socket.accept()
            await kept(socket, Session(socket, service, found, place), place)
    except IsogiError as error:
        if why := refusal(error):
            socket.app.state.metrics.refused.labels(why).inc()
        await socket.send_denial_response(problem(status_of(error), str(error), socket.url.path))
