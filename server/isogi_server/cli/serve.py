"""``isogi serve``: the socket, and the start and stop of the server."""

import asyncio
import gc
import logging
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import click
import uvicorn
from fastapi import FastAPI

from isogi_core.errors import IsogiError
from isogi_server import logs
from isogi_server.api.app import create_app
from isogi_server.api.connections import Connection, ServerConfig
from isogi_server.api.lifespan import Closing
from isogi_server.api.service import Service
from isogi_server.cli.setting_options import unknown_variables
from isogi_server.cli.stopping import SIGNALS, STOPPED, leave
from isogi_server.progress import compiling, open_scene, say
from isogi_server.render.engine import RenderEngine, engine_for
from isogi_server.settings import Settings

log = logging.getLogger("isogi.server")

EXIT_SECONDS = 3.0
"""Seconds that a stopping process has for itself after the time of its requests."""

HAND_OVER = 0.0005
"""Seconds after which a thread that holds the interpreter hands it over; a tenth of Python's
default.

Each step of a picture needs the interpreter again, while other threads load light and answer
requests.
"""

UNLIT_NOTE = " (without light until all is compiled)"

EXPOSED_WARNING = (
    "Others can reach {host}, so that a token is needed: put one of 16 characters or more into "
    "ISOGI_TOKEN or the"
    " configuration file, name a file of tokens by --tokens-file, or listen on 127.0.0.1."
)


def serve(target: str | None, settings: Settings) -> None:
    """Serve one scene until SIGTERM or SIGINT. The workers start while the app is assembled and
    kernels are loaded.

    Raises UsageError if other machines could reach the server without a token, and IsogiError if
    the scene, the port or the engine fails.
    """
    if settings.exposed and not settings.bearers:
        raise click.UsageError(EXPOSED_WARNING.format(host=settings.host))
    logs.configure(settings.log_format, settings.log_level)
    for sentence in unknown_variables():
        log.warning("%s", sentence)
    sys.setswitchinterval(HAND_OVER)
    scene = open_scene(target, settings)
    # Take the port first, so that a conflict shows before any work.
    with listen(settings.host, settings.port) as listener:
        engine = engine_for(scene, settings)
        if engine.kernels.progress is None:
            engine.start_workers()
        with bar_of(engine, settings):
            asyncio.run(run(create_app(engine, settings), listener))


def bar_of(engine: RenderEngine, settings: Settings) -> AbstractContextManager[None]:
    """Return a bar for the compilation of kernels; none if the log is JSON lines."""
    if settings.log_format == "json":
        return nullcontext()
    return compiling(lambda: engine.kernels.progress)


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket. Raises IsogiError if the address cannot be had."""
    if ":" in host:
        family = socket.AF_INET6
    else:
        family = socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        raise IsogiError(f"Cannot listen on {host} port {port}: {reason(error)}.") from error


def reason(error: OSError) -> str:
    """Return the message of the system, without the address that Python adds."""
    return (error.strerror or str(error)).partition(" (while")[0]


def queued(listener: socket.socket) -> Iterator[socket.socket]:
    """Yield connections that wait to be accepted: they would be reset if the listener was
    closed.
    """
    while True:
        try:
            yield listener.accept()[0]
        except OSError:
            return


class Server(uvicorn.Server):
    """Serves an app made by ``create_app``, and completes requests before it stops."""

    def __init__(self, app: FastAPI, stopping: Callable[[], None] = lambda: None) -> None:
        """Configure the server by the app's settings; ``stopping`` is called when it begins to
        stop.
        """
        settings: Settings = app.state.settings
        super().__init__(ServerConfig(app, settings, app.state.metrics))
        self.closing: Closing = app.state.closing
        self.patience = settings.shutdown_seconds
        self.stopping = stopping

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept the connections that wait and no more, complete requests, then close the app."""
        self.stopping()
        self.closing.begin()
        # Connections in the queue of the socket have perhaps sent a request already.
        last = [each for listener in sockets or () for each in queued(listener)]
        for server in self.servers:
            server.close()
        loop = asyncio.get_running_loop()
        for each in last:
            await loop.connect_accepted_socket(self._connection, each)
        # Requests that take longer than shutdown_seconds are ended.
        end = asyncio.create_task(self._end())
        await super().shutdown(sockets)
        end.cancel()

    async def _end(self) -> None:
        """End open requests when their time is over."""
        await asyncio.sleep(self.patience)
        await self.closing.end()

    def _connection(self) -> asyncio.Protocol:
        """Make the protocol of a new connection."""
        assert isinstance(self.config, ServerConfig)
        return Connection(self.config, self.server_state, self.lifespan.state)


async def run(app: FastAPI, listener: socket.socket) -> None:
    """Serve the app until a signal, and print its address once it is ready. Raises the engine's
    error if that did not start, unless a signal came first.
    """
    service: Service = app.state.service

    def stopping() -> None:
        """Have the process exit after EXIT_SECONDS at most, also while kernels compile; later by
        ``shutdown_seconds``, the time for open requests, if the service was ready or has failed.
        """
        # ``watching`` is made below, before the server runs.
        if not watching.done():
            click.echo(STOPPED, err=True)
        leave_within(EXIT_SECONDS + (app.state.settings.shutdown_seconds if watching.done() else 0))

    server = Server(app, stopping)
    stop_on_signals(server)
    serving = asyncio.create_task(server.serve([listener]))
    startup = service.startup
    watching = asyncio.create_task(startup.ready())
    # Wait until the service is ready or failed, or the server stops.
    await asyncio.wait({serving, watching}, return_when=asyncio.FIRST_COMPLETED)
    # After a signal, errors such as workers that are gone are no failure.
    stopped = server.should_exit
    if startup.failure:
        server.should_exit = True
    elif watching.done() and not stopped:
        # 200,000 objects stay: searching these for garbage would stop all threads for 0.2 s.
        gc.freeze()
        say(f"isogi is ready at {address(listener)}{'' if startup.lit.is_set() else UNLIT_NOTE}")
    watching.cancel()
    await serving
    if startup.failure and not stopped:
        raise startup.failure


def leave_within(seconds: float) -> None:
    """Exit the process after this number of seconds at most: compiling, and reading from a slow
    store, cannot be interrupted.

    Clients of a server that was ready have their answers by then. The store is always consistent.
    """
    timer = threading.Timer(seconds, leave)
    timer.daemon = True
    timer.start()


def stop_on_signals(server: uvicorn.Server) -> None:
    """Let SIGTERM and SIGINT stop the server in an orderly way, also before uvicorn handles
    them.
    """

    def stop(*_: Any) -> None:
        server.should_exit = True

    for number in SIGNALS:
        signal.signal(number, stop)


def address(listener: socket.socket) -> str:
    """Return the URL of a listening socket."""
    host, port = listener.getsockname()[:2]
    if ":" in host:
        return f"http://[{host}]:{port}/"
    return f"http://{host}:{port}/"
