"""A stream: the WebSocket on which a client sends views and gets pictures, the newest view
first.
"""

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
from isogi_server.answers import chunks_in, coverage_schema
from isogi_server.api.lifespan import within
from isogi_server.api.service import PictureRequest, Service, ServiceDep, Shown
from isogi_server.bearers import client_of
from isogi_server.card_schemas import CardChunk
from isogi_server.errors import BusyError, ParameterError, StreamError
from isogi_server.parameters import FrameParams, NoParams, read
from isogi_server.pictures import MEDIA_TYPES, encode, format_for, smoothed
from isogi_server.problems import parameter_named, problem, problem_document, refusal, status_of
from isogi_server.render.metrics import Metrics
from isogi_server.render.scheduling import DRAFT, Place, Rank
from isogi_server.render.viewers import stream_viewer
from isogi_server.settings import Settings
from isogi_server.values import Span


def running_mean(newest: float, before: float, fresh: float) -> float:
    """Return the running mean with the ``newest`` value, whose weight is ``fresh``; ``before``
    is the former mean, 0 if there is none.
    """
    return fresh * newest + (1.0 - fresh) * (before or newest)


HALF = 0.5
QUARTER = 0.25
"""Shares of the full width and height that drafts have."""

MAX_DRAFT_SECONDS = 0.045
"""Seconds that a draft may take to be drawn here and shown by the client. At 20 drafts a second,
0.005 s are left for encoding and sending it, which do not count.
"""

PACE_MARGIN = 0.8
"""Share of MAX_DRAFT_SECONDS that larger drafts are expected to take at most before they are
tried; less than 1, so that sizes do not alternate.
"""

FRESH = 0.5
"""Weight of the newest draft in the running mean of the time that drafts take."""


class Drafts:
    """The size of a connection's drafts: ``scale`` is a half of the full width and height, or a
    quarter if halves are slow.
    """

    def __init__(self, crowded: bool = False) -> None:
        """Begin with halves, or with quarters if other drafts wait."""
        self.scale = QUARTER if crowded else HALF
        self._drawn = self._shown = 0.0

    def shown(self, seconds: float) -> None:
        """Note the seconds that the client took to show a draft, as it reports them."""
        self._shown = running_mean(seconds, self._shown, FRESH)

    def drawn(self, seconds: float) -> None:
        """Note the seconds that a draft took to draw, those in the queue included, and choose the
        size of the next one.
        """
        self._drawn = running_mean(seconds, self._drawn, FRESH)
        took = self._drawn + self._shown
        pixels = (HALF / QUARTER) ** 2
        # Time is proportional to the number of pixels.
        if self.scale == HALF and took > MAX_DRAFT_SECONDS:
            self._resize(QUARTER, 1.0 / pixels)
        elif self.scale == QUARTER and pixels * took < PACE_MARGIN * MAX_DRAFT_SECONDS:
            self._resize(HALF, pixels)

    def _resize(self, scale: float, pixels: float) -> None:
        """Change the scale, and the expected times by the ratio of ``pixels``."""
        self.scale = scale
        self._drawn = pixels * self._drawn
        self._shown = pixels * self._shown


MAX_PICTURES_AHEAD = 2
"""Pictures that may be sent without being acknowledged."""

RECEIPT_SECONDS = 1.0
"""Seconds after which a picture without acknowledgement is taken for shown."""


class Window:
    """Flow control: the pictures that were sent over one connection and not yet shown. Belongs
    to its event loop.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, float]] = deque()
        self._moved = asyncio.Event()

    def sent(self, request: int) -> None:
        """Note that a picture for the view request with this id was sent."""
        self._sent.append((request, asyncio.get_running_loop().time()))

    def shown(self, request: int) -> None:
        """Note that the client shows the oldest open picture of a view request; pictures sent
        before it count as shown.
        """
        if any(each == request for each, _ in self._sent):
            while self._sent.popleft()[0] != request:
                pass
            self._moved.set()

    async def room(self) -> None:
        """Return when another picture may be sent."""
        while len(self._sent) >= MAX_PICTURES_AHEAD:
            left = self._sent[0][1] + RECEIPT_SECONDS - asyncio.get_running_loop().time()
            # Do without a receipt that is overdue.
            if left <= 0.0:
                self._sent.popleft()
                continue
            self._moved.clear()
            await within(left, self._moved)


GAP = 1.0
"""Seconds after the last view of a motion for which it counts as going on."""


class Motion:
    """Measures how well a stream follows a moving view: number of ``drafts`` sent, ``seconds``
    of motion, and ``since``, the time of the newest view. Belongs to its event loop.
    """

    def __init__(self) -> None:
        self.drafts = 0
        self.seconds = 0.0
        self.since = 0.0
        self._moving_since: float | None = None

    def took(self, moving: bool) -> None:
        """Note that a view came, ``moving`` or at rest."""
        now = asyncio.get_running_loop().time()
        if self._moving_since is not None:
            self.seconds += min(now - self._moving_since, GAP)
        self._moving_since = now if moving else None
        self.since = now

    def sent(self, came: float, draft: bool) -> float:
        """Note that a picture is sent of the view that ``came`` at this time; return its age in
        seconds.
        """
        self.drafts += draft
        return asyncio.get_running_loop().time() - came


CLOSE_TOO_BIG = 1009
CLOSE_POLICY = 1008
CLOSE_TRY_LATER = 1013
CLOSE_IDLE = 4000
"""Codes with which a stream is closed (RFC 6455, 7.4): a message is too long; messages are too
many or no text; another client needs the place; no message came for long.
"""


class Inbox:
    """The messages of a stream, checked against the limits of the settings."""

    def __init__(self, socket: WebSocket, settings: Settings, place: Place) -> None:
        self._socket = socket
        self._patience = settings.patience
        self._place = place
        self._second = 0
        self._count = 0

    async def next(self) -> str | None:
        """Return the next message; None if the client has gone. Raises StreamError if a message
        breaks a limit, or none comes for long.
        """
        try:
            message = await asyncio.wait_for(
                self._socket.receive(), self._patience.stream_idle_seconds
            )
        except TimeoutError:
            raise StreamError(
                f"No message for {self._patience.stream_idle_seconds:g} seconds.",
                CLOSE_IDLE,
            ) from None
        if message["type"] == "websocket.disconnect":
            return None
        # A message, even one that is refused, counts and keeps the stream's place.
        self._count_one()
        self._place.use()
        text = message.get("text")
        if text is None:
            raise StreamError("Messages must be text.", CLOSE_POLICY)
        if len(text.encode()) > self._patience.stream_bytes:
            raise StreamError(
                f"A message is longer than {self._patience.stream_bytes} bytes.",
                CLOSE_TOO_BIG,
            )
        return str(text)

    def _count_one(self) -> None:
        """Count a message in the present second. Raises StreamError if there are too many."""
        # Whole seconds are precise enough to stop a flood.
        second = int(asyncio.get_running_loop().time())
        if second == self._second:
            self._count = self._count + 1
        else:
            self._count = 1
        self._second = second
        if self._count > self._patience.stream_rate:
            raise StreamError(
                f"More than {self._patience.stream_rate} messages in a second.",
                CLOSE_POLICY,
            )


Id = Annotated[int, Span(0, 2**53 - 1, whole=True)]


class Receipt(NoParams):
    """A message of the client: it shows a picture of the view with this id, and ``took`` this
    many milliseconds for it.
    """

    shown: Id
    took: Annotated[float, Span(0.0, 60_000.0)] = 0.0


class ViewRequest(NoParams):
    """A message of the client: its view, ``moving`` or at rest.

    ``chunks`` asks for the chunks that a picture at rest reads. A client that draws moving views
    itself sets ``pictures`` to false.
    """

    id: Id
    view: dict[str, Any] = Field(default_factory=dict)
    moving: StrictBool = False
    chunks: StrictBool = False
    pictures: StrictBool = True

    def params(self) -> FrameParams:
        """Return the parameters of the view. Raises ParameterError if they are not those of a
        frame, or name ``wait_ms``.
        """
        params = read(FrameParams, self.view.items())
        if "wait_ms" in params.model_fields_set:
            raise ParameterError(
                "wait_ms is for requests, a stream sends new pictures by itself: leave it out.",
                "wait_ms",
            )
        return params


def message_of(text: str) -> dict[str, Any]:
    """Return the JSON object in a message. Raises ParameterError if there is none."""
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
    """Return a message as a view request or a receipt. Raises ParameterError for the first
    member that is wrong.
    """
    if "shown" in message:
        return read(Receipt, message.items())
    return read(ViewRequest, message.items())


def answer(
    request: int, shown: Shown, form: str, draft: bool, chunks: list[CardChunk] | None = None
) -> str:
    """Return the JSON facts about a picture, sent before it as the answer to the view
    ``request`` with this id; with the ``chunks`` that it reads, if these are given.
    """
    frame = shown.frame
    if chunks is None:
        named = {}
    else:
        named = {"chunks": [each.model_dump() for each in chunks]}
    # A draft is never final, though all light of its smaller picture may be there.
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


def problem_message(request: Any, error: IsogiError, path: str) -> str:
    """Return a problem document about the message with this id, null if it has none."""
    document = problem_document(status_of(error), str(error), path, **parameter_named(error))
    return json.dumps({"id": request if isinstance(request, int) else None, "problem": document})


def _refuse(constant: str) -> NoReturn:
    """Refuse constants such as NaN, which are not JSON."""
    raise ValueError(constant)


WANT_EVERY = 0.5
"""Seconds between two drafts of a moving view whose light is requested: the next views need
much of the same light.
"""


class Session:
    """The session of one stream: it answers the newest view that its client sent, and cancels work
    on older ones.

    A draft is drawn to its end even if a newer moving view has come: if views come faster than
    drafts, none would be completed otherwise.
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
        """Run until the client leaves or breaks a limit. Then drop its requests."""
        reading = asyncio.create_task(self._read())
        working = asyncio.create_task(self._work())
        try:
            await asyncio.wait({reading, working}, return_when=asyncio.FIRST_COMPLETED)
            # Raise the error of the task that ended.
            for task in (reading, working):
                if task.done():
                    await task
        except StreamError as error:
            # The client, or its broken frame, may have closed the socket already.
            with suppress(WebSocketDisconnect, RuntimeError):
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
        """Read messages until the client leaves; answer invalid ones with a problem document."""
        while (text := await self._inbox.next()) is not None:
            request: Any = None
            try:
                message = message_of(text)
                request = message.get("id")
                self._take(read_message(message))
            except IsogiError as error:
                await self._send(problem_message(request, error, self._socket.url.path))

    def _take(self, message: ViewRequest | Receipt) -> None:
        """Take in a message."""
        if isinstance(message, Receipt):
            self._window.shown(message.shown)
            # Receipts of full pictures say nothing about drafts.
            if message.shown != self._still:
                self._drafts.shown(message.took / 1000.0)
            return
        if not message.moving:
            self._still = message.id
        older = self._newest
        self._newest = (message, message.params())
        self._motion.took(message.moving and message.pictures)
        self._changed.set()
        # Cancel work on the former view, unless it is a draft and the view still moves.
        if self._showing and not (older and older[0].moving and message.moving):
            self._showing.cancel()

    async def _work(self) -> None:
        """Show the newest view whenever there is one."""
        while True:
            await self._changed.wait()
            # While the client catches up, newer views replace the one to be shown.
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
            # Raise the error of the work, if any.
            if not self._showing.cancelled():
                self._showing.result()

    async def _show(self, request: ViewRequest, params: FrameParams) -> None:
        """Answer a view request, or send a problem document about it."""
        if not request.pictures:
            return
        try:
            form = format_for(params, None)
            self._lit = await self._service.variant(
                self._scene, params, client_of(self._socket.scope)
            )
            picture = self._service.picture_of(self._lit, smoothed(params, form))
            if request.moving:
                await self._draft(request, params, picture)
            else:
                await self._rest(request, params, picture, form)
        except IsogiError as error:
            if why := refusal(error):
                self._metrics.refused.labels(why).inc()
            await self._send(problem_message(request.id, error, self._socket.url.path))

    async def _draft(
        self, request: ViewRequest, params: FrameParams, picture: PictureRequest
    ) -> None:
        """Send one picture of a moving view, of a size and format that is fast, and request its
        light now and then.
        """
        self._service.make_way()
        small = picture.draft(self._drafts.scale)
        watch = Stopwatch()
        rank = self._service.draft_rank(self._viewer)
        frame = await self._service.frame_or_preview(small, rank, watch)
        # A draft states no time left, and nothing waits for better light of it.
        shown = Shown(frame, time_left=None, watch=watch, coming=frozenset(), since=0)
        # Time in the queue counts, so that drafts become smaller if many clients wait. Encoding,
        # which follows, does not.
        self._drafts.drawn(sum(watch.seconds.values()))
        await self._hand_over(request, *await self._made(request, params, shown, "jpeg", rank))
        now = asyncio.get_running_loop().time()
        if now - self._wanted >= WANT_EVERY:
            self._wanted = now
            await self._service.request_light(small, frame, self._viewer)

    async def _rest(
        self, request: ViewRequest, params: FrameParams, picture: PictureRequest, form: str
    ) -> None:
        """Send the full picture of a view at rest, and each better one, until it is final."""
        async with aclosing(self._service.refinements(picture, self._viewer)) as refinements:
            async for shown in refinements:
                rank = self._service.rank(self._viewer, DRAFT)
                made = await self._made(request, params, shown, form, rank)
                # Free megabytes while the client catches up and light is baked.
                shown.place.leave()
                del shown
                await self._hand_over(request, *made)
                await self._window.room()

    async def _made(
        self, request: ViewRequest, params: FrameParams, shown: Shown, form: str, rank: Rank
    ) -> tuple[str, bytes]:
        """Return the facts of a picture, and the encoded picture."""
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
        # The first picture of a view measures how quickly the stream follows.
        if self._shows is not None:
            self._metrics.ages.observe(self._motion.sent(self._shows, request.moving))
            self._shows = None
        await self._send(facts, picture)

    def _chunks(self, request: ViewRequest, shown: Shown) -> list[CardChunk] | None:
        """Return the chunks that a full picture reads, if the client asks for them."""
        if request.moving or not request.chunks:
            return None
        return chunks_in(self._service.engine.renderer(self._lit.id), shown.frame)

    async def _send(self, text: str, data: bytes | None = None) -> None:
        """Send a message completely, even if the sender is cancelled meanwhile: facts without
        their picture would confuse the client.
        """
        await asyncio.shield(self._send_all(text, data))

    async def _send_all(self, text: str, data: bytes | None) -> None:
        """Send a text and its binary message without others between them; a client that has
        gone gets nothing.
        """
        with suppress(WebSocketDisconnect, RuntimeError):
            async with self._sending:
                await self._socket.send_text(text)
                if data is not None:
                    await self._socket.send_bytes(data)


async def run_session(socket: WebSocket, session: Session, place: Place) -> None:
    """Run a session until its client leaves, or until another client takes its place."""
    try:
        await place.keep(session.run())
    except BusyError as error:
        with suppress(WebSocketDisconnect, RuntimeError):
            await socket.close(CLOSE_TRY_LATER, str(error))


router = APIRouter(prefix="/v1/scenes/{scene}")


@router.websocket("/stream")
async def stream(socket: WebSocket, scene: str, service: ServiceDep) -> None:
    """Send pictures of the views that the client sends, always of the newest one: drafts while it
    moves, the full picture at rest, better ones as light is baked.

    Refused with a problem document if the scene is unknown, or if too many streams are open.
    """
    try:
        found = service.scene(scene)
        with service.connections.admitted(client_of(socket.scope)) as place:
            await socket.accept()
            await run_session(socket, Session(socket, service, found, place), place)
    except IsogiError as error:
        if why := refusal(error):
            socket.app.state.metrics.refused.labels(why).inc()
        await socket.send_denial_response(problem(status_of(error), str(error), socket.url.path))
