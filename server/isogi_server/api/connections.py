"""Connections, on top of those of uvicorn: requests have deadlines, connections are limited,
and slow or broken clients are closed without errors in the log.
"""

import asyncio
import fcntl
import logging
import socket
import termios
from array import array
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, cast

import h11
from starlette.types import Receive, Scope, Send
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from isogi_server.api.requests import UPLOADS
from isogi_server.bearers import site_of
from isogi_server.problems import problem
from isogi_server.render.metrics import Metrics
from isogi_server.settings import Settings

NO_TEXT = 1007
"""Code with which a stream is closed if its text is not UTF-8 (RFC 6455, 7.4)."""


UNREADABLE = b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class StreamConnection(WebSocketsSansIOProtocol):
    """A WebSocket connection that logs no errors of clients, and is patient with slow links."""

    def data_received(self, data: bytes) -> None:
        """Read data. Refuse a handshake that cannot be parsed, such as one with too many
        headers.
        """
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_initiated:
            self.handshake_initiated = self.close_sent = True
            self.transport.write(UNREADABLE)
            self.transport.close()

    _written = 0
    """Bytes of messages since the client answered a ping."""

    _left = 0
    _moved = 0.0
    """Bytes that were under way when some of them were taken last, and the time of that."""

    async def send(self, message: Any) -> None:
        """Send a message. The last part of a refusal completes the handshake, which uvicorn
        would log as an error otherwise.
        """
        self._written += len(message.get("bytes") or message.get("text") or "")
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get(
            "more_body", False
        ):
            self.handshake_complete = True

    def send_keepalive_ping(self) -> None:
        """Ping the client; the ping queues behind all bytes that were sent before."""
        super().send_keepalive_ping()
        self._left = self._under_way
        self._moved = self.loop.time()

    def handle_pong(self, event: Any) -> None:
        """Take a pong: all that was sent before its ping has arrived."""
        super().handle_pong(event)
        if self.pending_ping_payload is None:
            self._written = 0

    def keepalive_timeout(self) -> None:
        """Give the client up if it answered no ping, unless bytes sent before the ping may
        still be on their way: then wait on.
        """
        now = self.loop.time()
        left = self._under_way
        # The client moves if bytes were taken at PACE at least since the last check, or new ones
        # were sent.
        if left > self._left or left <= self._left - PACE * PING:
            self._left = left
            self._moved = now
        if left:
            patience = self._moved + self.config.settings.patience.stall_seconds  # type: ignore[attr-defined]
        else:
            # A proxy has taken all bytes, and passes them on at the pace of the link beyond.
            patience = self.ping_sent_at + self._written / PACE
        if now < patience:
            self.pong_timer = self.loop.call_later(PING, self.keepalive_timeout)
        elif left:
            # A close frame would wait behind the bytes that are not taken.
            self.transport.abort()
        else:
            super().keepalive_timeout()

    @property
    def _under_way(self) -> int:
        """Return the bytes that wait for the client, in this process and in the buffer of the
        socket.
        """
        waiting = array("i", [0])
        with suppress(OSError):
            fcntl.ioctl(self.transport.get_extra_info("socket"), termios.TIOCOUTQ, waiting)
        return self.transport.get_write_buffer_size() + waiting[0]

    def send_receive_event_to_app(self) -> None:
        """Hand a whole message over; close the stream if its text is not UTF-8."""
        if self.curr_msg_data_type == "text" and not is_text(b"".join(self.frames)):
            self.conn.send_close(NO_TEXT)
            self.handle_parser_exception()
            return
        super().send_receive_event_to_app()


def is_text(data: bytes) -> bool:
    """Return True if these bytes are UTF-8."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


log = logging.getLogger("isogi.connections")

DEADLINE_CHECK_SECONDS = 0.5
"""Seconds between two checks of a connection's deadlines."""

PACE = 1024
"""Bytes per second of an answer that a client must take at least."""

PING = 5.0
"""Seconds between two pings of a stream's client, and within which it must answer each, once
all that was sent before has arrived.
"""

LINGER = 1.0
"""Seconds for which a connection is still read before it is closed: if data arrived later, the
client would get a reset instead of the answer.
"""


class ServerConfig(Config):
    """The configuration of uvicorn for an app under isogi's settings. Connections find settings
    and metrics in it.
    """

    def __init__(self, app: Any, settings: Settings, metrics: Metrics) -> None:
        """Configure ``app``; ``metrics`` count the connections that are given up."""
        super().__init__(
            app,
            http=Connection,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=bool(settings.trusted_proxies),
            forwarded_allow_ips=list(settings.trusted_proxies),
            timeout_keep_alive=settings.patience.idle_seconds,
            timeout_graceful_shutdown=settings.shutdown_seconds + 2,
            ws=StreamConnection,
            ws_max_size=settings.patience.stream_bytes,
            ws_per_message_deflate=False,  # Pictures are compressed already.
            ws_ping_interval=PING,
            ws_ping_timeout=PING,
        )
        self.settings = settings
        self.metrics = metrics


class Connection(H11Protocol):
    """An HTTP connection that is closed if its client is too slow, or if there are too many
    connections.

    A head must be complete ``head_seconds`` after the connection or the last answer, a body
    ``body_seconds`` after its head (``upload_seconds`` for an upload), and an answer must be taken
    at PACE. If there are too many connections, one whose request is incomplete is closed: among
    those of the client that has most connections, one that lacks a head before one that lacks a
    body, the one that waits longest first. If all requests are complete, the newcomer is answered
    with 503.
    """

    def __init__(
        self,
        config: ServerConfig,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.settings = config.settings
        self.metrics = config.metrics
        self._state: Any = h11.IDLE
        self._since = self._taken = self.loop.time()
        self._unsent = 0
        self._refused = False
        self._counted = False
        self._next_check: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place, or the place of another connection with an incomplete request."""
        # asyncio sets this only for listeners that name their protocol; without it the end of an
        # answer may wait for 40 ms.
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().connection_made(transport)
        self._since = self._taken = self.loop.time()
        self._check_later()
        crowd = too_many(self, cast(Iterable[H11Protocol], self.connections), self.settings)
        waiting = [
            each
            for each in crowd
            if isinstance(each, Connection) and each.lacks and each is not self
        ]
        if waiting:
            held = Counter(map(site_at, crowd))
            last = min(
                waiting, key=lambda each: (-held[site_at(each)], not each.waits, each._since)
            )
            last.give_up("crowd", "Others need this connection: open a new one.")
        elif crowd:
            self.app = crowded

    def connection_lost(self, exc: Exception | None) -> None:
        """Check no more."""
        self._stop_checking()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read data, and note the completion of a head or a body. Data after a refusal is
        dropped.
        """
        if not self._refused:
            super().data_received(data)
            self._note()

    def on_response_complete(self) -> None:
        """Continue, and note that the next head may come."""
        super().on_response_complete()
        self._note()

    def pause_writing(self) -> None:
        """Have the application wait. If clients together leave too many bytes unsent, close the
        one that has stalled longest.
        """
        super().pause_writing()
        if not self._unsent:
            self._taken = self.loop.time()
            self._unsent = self.unsent
        # Answers that wait for slow clients take memory from everybody. One slow client alone keeps
        # its connection: nobody else waits for memory.
        slow = [each for each in self.connections if isinstance(each, Connection) and each.unsent]
        if (
            sum(each.unsent for each in slow) > self.settings.patience.unsent_mb << 20
            and len(slow) > 1
        ):
            min(slow, key=lambda each: each._taken).drop("memory")

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to the WebSocket protocol, or refuse it if there are too
        many connections.
        """
        if self.app is crowded:
            self.refuse(503, CONNECTIONS_TAKEN)
            return
        # Pings of the stream find slow clients from now on.
        self._stop_checking()
        super().handle_websocket_upgrade(event)

    def shutdown(self) -> None:
        """Close after the present answer; close a quiet connection after LINGER seconds, in
        which a request is still answered.
        """
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.keep_alive = False
        else:
            self.loop.call_later(LINGER, self._leave)

    @property
    def waits(self) -> bool:
        """Return True if the head of the next request has not come yet."""
        return self.conn.their_state is h11.IDLE and self._heard

    @property
    def lacks(self) -> str | None:
        """Return the part of the present request that is incomplete, "head" or "body"; None if
        it is complete, or if the connection is being closed.
        """
        if self.waits:
            return "head"
        if self.conn.their_state is h11.SEND_BODY and self._heard:
            return "body"
        return None

    @property
    def _heard(self) -> bool:
        """True if more bytes of the client matter: the connection is not being closed."""
        return not self._refused and not self.transport.is_closing()

    @property
    def body_seconds(self) -> int:
        """Return the seconds allowed for the body of the present request. The rest of an upload
        that is answered early is a body like any other.
        """
        uploading = (
            self.scope["method"],
            self.scope["path"],
        ) in UPLOADS and self.conn.our_state is h11.SEND_RESPONSE
        if uploading:
            return self.settings.upload_seconds
        return self.settings.patience.body_seconds

    @property
    def unsent(self) -> int:
        """Return the bytes of answers that the client has not taken yet."""
        return self.transport.get_write_buffer_size()

    def check(self) -> None:
        """Close the connection if its client is late; else check again later."""
        now = self.loop.time()
        part = self.lacks
        if part == "body":
            patience = self.body_seconds
        else:
            patience = self.settings.patience.head_seconds
        if part is not None and now - self._since > patience:
            self.give_up(part, f"The {part} of the request was not there within {patience} s.")
        elif self._stalls(now):
            self.drop("answer")
        self._check_later()

    def drop(self, why: str) -> None:
        """Abort the connection, whatever is unsent; count it by the reason ``why``."""
        self._count(why)
        self.transport.abort()

    def give_up(self, why: str, sentence: str) -> None:
        """Close the connection, and count it by the reason ``why``. If a request has begun and has
        no answer yet, answer it with 408 and this ``sentence`` first.
        """
        self._count(why)
        answering = (
            self.cycle is not None
            and self.cycle.response_started
            and not self.cycle.response_complete
        )
        self._end_cycle()
        # Not a byte of a head has come.
        unasked = self.waits and not self.conn.trailing_data[0]
        # The request was answered before all of its body had come.
        answered = self.conn.our_state is h11.DONE
        if answering or unasked or answered:
            self.transport.close()
        else:
            self.refuse(408, sentence)

    def send_400_response(self, msg: str) -> None:
        """Answer data that is not HTTP with a problem document."""
        self.refuse(400, "This is not a request that HTTP/1.1 allows.")

    def refuse(self, status: int, sentence: str) -> None:
        """Answer with a problem document, without the app, and close after LINGER seconds."""
        # Stop the app, and write the answer to the connection.
        self._end_cycle()
        answer = problem(status, sentence, "/")
        headers = [*answer.raw_headers, (b"connection", b"close")]
        for event in (
            h11.Response(status_code=status, headers=headers),
            h11.Data(bytes(answer.body)),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self._refused = True
        # Read on for a while: closing at once would reset the connection while the client still
        # sends.
        self.transport.write_eof()
        self.loop.call_later(LINGER, self.transport.close)

    def _count(self, why: str) -> None:
        """Count the connection as closed for the reason ``why``, unless it was counted before."""
        if not self._counted:
            self._counted = True
            self.metrics.closed.labels(why).inc()

    def _end_cycle(self) -> None:
        """Tell the app that its client left, so that it answers no more."""
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()

    def _note(self) -> None:
        """Restart the deadline if the client has completed a part of its request."""
        if self.conn.their_state is not self._state:
            self._since = self.loop.time()
            self._state = self.conn.their_state

    def _stalls(self, now: float) -> bool:
        """Return True if the client has taken less than PACE of an answer for ``stall_seconds``."""
        unsent = self.unsent
        least = self._unsent - PACE * self.settings.patience.stall_seconds
        # Measure again if all is sent, more is queued, or enough was taken since the last
        # measurement.
        if not unsent or unsent > self._unsent or unsent <= least:
            self._unsent = unsent
            self._taken = now
        return unsent > 0 and now - self._taken > self.settings.patience.stall_seconds

    def _leave(self) -> None:
        """Close the connection if no request has come."""
        if self.waits:
            self.transport.close()

    def _check_later(self) -> None:
        self._next_check = self.loop.call_later(DEADLINE_CHECK_SECONDS, self.check)

    def _stop_checking(self) -> None:
        if self._next_check is not None:
            self._next_check.cancel()
            self._next_check = None


CONNECTIONS_TAKEN = "All connections that this server has are taken: come back in a second."


async def crowded(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer any request with 503: the app of a connection that has no place."""
    await problem(503, CONNECTIONS_TAKEN, scope["path"])(scope, receive, send)


def too_many(
    one: H11Protocol, connections: Iterable[H11Protocol], settings: Settings
) -> list[H11Protocol]:
    """Return the connections among which one has to go, now that ``one`` is among
    ``connections``: those of its client if that client has too many, else all if there are too many
    in all, else none.

    Connections of a trusted proxy belong to many clients, so only the limit for all connections
    holds for them.
    """
    everybody = list(connections)
    own = [each for each in everybody if site_at(each) == site_at(one)]
    # A client above its limit competes with its own connections only.
    if len(own) > settings.max_client_connections and not settings.trusts(host_of(one)):
        return own
    if len(everybody) > settings.max_connections:
        return everybody
    return []


def host_of(connection: H11Protocol) -> str:
    """Return the address of a connection's client without its port; empty if it has none."""
    if connection.client is not None:
        return connection.client[0]
    return ""


def site_at(connection: H11Protocol) -> str:
    """Return the client of a connection as limits count it: see ``site_of``."""
    return site_of(host_of(connection))
