"""``isogi serve``: the socket, and how the server starts and stops."""

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
from server import logs
from server.api.app import create_app
from server.api.connections import Connection, ServerConfig
from server.api.lifespan import Closing
from server.api.service import Service
from server.cli.setting_options import unknown_variables
from server.cli.stopping import SIGNALS, STOPPED, leave
from server.progress import compiling, open_scene, say
from server.render.engine import RenderEngine, engine_for
from server.settings import Settings

log = logging.getLogger("isogi.server")

EXIT_SECONDS = 3.0
"""Seconds that a stopping process has left for itself once its requests had theirs."""

HAND_OVER = 0.0005
"""Seconds after which a thread that holds the interpreter lets another have it; a tenth of what
Python has by itself.

Each step of a picture asks for it again, next to threads that load light and answer requests.
"""

UNLIT_NOTE = " (without light until all is compiled)"

EXPOSED_WARNING = (
    "Others can reach {host}, so that a token is needed: put one of 16 characters or more into "
    "ISOGI_TOKEN or the"
    " configuration file, name a file of tokens by --tokens-file, or listen on 127.0.0.1."
)


def serve(target: str | None, settings: Settings) -> None:
    """Serve one scene until SIGTERM or SIGINT. The workers start while the app is made and the
    kernels are loaded.

    Raises UsageError where others could reach it without a token, and IsogiError where the scene,
    the port or the engine fails.
    """
    if settings.exposed and not settings.bearers:
        raise click.UsageError(EXPOSED_WARNING.format(host=settings.host))
    logs.configure(settings.log_format, settings.log_level)
    for sentence in unknown_variables():
        log.warning("%s", sentence)
    sys.setswitchinterval(HAND_OVER)
    scene = open_scene(target, settings)
    with listen(settings.host, settings.port) as listener:
        engine = engine_for(scene, settings)
        if engine.kernels.progress is None:
            engine.hire()
        with bar_of(engine, settings):
            asyncio.run(run(create_app(engine, settings), listener))


def bar_of(engine: RenderEngine, settings: Settings) -> AbstractContextManager[None]:
    """A bar that shows how far kernels are compiled; none among the lines of a log of JSON."""
    if settings.log_format == "json":
        return nullcontext()
    return compiling(lambda: engine.kernels.progress)


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; IsogiError where the address cannot be had."""
    if ":" in host:
        family = socket.AF_INET6
    else:
        family = socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        raise IsogiError(f"Cannot listen on {host} port {port}: {reason(error)}.") from error


def reason(error: OSError) -> str:
    """What the system says, without the address that Python adds to it."""
    return (error.strerror or str(error)).partition(" (while")[0]


def queued(listener: socket.socket) -> Iterator[socket.socket]:
    """Connections that wait to be accepted: they would be reset when the listener is closed."""
    while True:
        try:
            yield listener.accept()[0]
        except OSError:
            return


class Server(uvicorn.Server):
    """Serves an app that ``create_app`` made; when it stops, requests come to their end first."""

    def __init__(self, app: FastAPI, stopping: Callable[[], None] = lambda: None) -> None:
        """Be ready to serve under the app's settings; ``stopping`` is called when it begins to
        stop.
        """
        settings: Settings = app.state.settings
        super().__init__(ServerConfig(app, settings, app.state.metrics))
        self.closing: Closing = app.state.closing
        self.patience = settings.shutdown_seconds
        self.stopping = stopping

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take the connections that wait and no more, answer what was asked, and then close the
        app.
        """
        self.stopping()
        self.closing.begin()
        last = [each for listener in sockets or () for each in queued(listener)]
        for server in self.servers:
            server.close()
        loop = asyncio.get_running_loop()
        for each in last:
            await loop.connect_accepted_socket(self._connection, each)
        end = asyncio.create_task(self._end())
        await super().shutdown(sockets)
        end.cancel()

    async def _end(self) -> None:
        await asyncio.sleep(self.patience)
        await self.closing.end()

    def _connection(self) -> asyncio.Protocol:
        assert isinstance(self.config, ServerConfig)
        return Connection(self.config, self.server_state, self.lifespan.state)


async def run(app: FastAPI, listener: socket.socket) -> None:
    """Serve the app, say where once it is ready, and end with the engine's error where it did not
    start.
    """
    service: Service = app.state.service

    def stopping() -> None:
        """End in time; at once where nobody was served, and no kernel need be waited for."""
        if not watching.done():
            click.echo(STOPPED, err=True)
        leave_within(EXIT_SECONDS + (app.state.settings.shutdown_seconds if watching.done() else 0))

    server = Server(app, stopping)
    stop_on_signals(server)
    serving = asyncio.create_task(server.serve([listener]))
    startup = service.startup
    watching = asyncio.create_task(startup.ready())
    await asyncio.wait({serving, watching}, return_when=asyncio.FIRST_COMPLETED)
    stopped = (
        server.should_exit
    )  # by a signal: what fails after that, such as workers that are gone, is no failure
    if startup.failure:
        server.should_exit = True
    elif watching.done() and not stopped:
        # 200,000 objects that stay: to look for garbage among them stops all threads for 0.2 s
        gc.freeze()
        say(f"isogi is ready at {address(listener)}{'' if startup.lit.is_set() else UNLIT_NOTE}")
    watching.cancel()
    await serving
    if startup.failure and not stopped:
        raise startup.failure


def leave_within(seconds: float) -> None:
    """End the process after so long at the latest: compiling and reading a slow store cannot be
    stopped.

    All clients have their answers by then, and the store is whole at any time.
    """
    timer = threading.Timer(seconds, leave)
    timer.daemon = True
    timer.start()


def stop_on_signals(server: uvicorn.Server) -> None:
    """Let SIGTERM and SIGINT end the server and not the process, before uvicorn listens to them and
    after.
    """

    def stop(*_: Any) -> None:
        server.should_exit = True

    for number in SIGNALS:
        signal.signal(number, stop)


def address(listener: socket.socket) -> str:
    """The URL of a listening socket."""
    host, port = listener.getsockname()[:2]
    if ":" in host:
        return f"http://[{host}]:{port}/"
    return f"http://{host}:{port}/"
