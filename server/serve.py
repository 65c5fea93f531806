"""``isogi serve``: the socket first, so that a browser learns that isogi is starting; then the studio."""

import asyncio
import os
import signal
import socket
import threading
from importlib import import_module
from typing import Any

import click
import uvicorn
from fastapi import FastAPI

from isogi_core.errors import IsogiError
from isogi_core.model.scene import load_scene
from server.service import Service
from server.settings import Settings


def serve(target: str | None, settings: Settings) -> None:
    """Serve one scene until SIGTERM or SIGINT; IsogiError where the scene, the port or the studio fails.

    What takes long stands side by side: the scheduler's library is imported while the scene is read, and
    the workers come, as processes, while the rest is imported and the kernels are loaded.
    """
    threading.Thread(target=import_module, args=["distributed"], daemon=True).start()
    scene = load_scene(target)
    with listen(settings.host, settings.port) as listener:
        from server.studio import Studio  # noqa: PLC0415 (bad input is told before the rest is imported)

        studio = Studio([scene], settings.store, settings.workers, settings.scheduler, settings.memory_mb << 20)
        studio.hire()
        from server.app import create_app  # noqa: PLC0415 (the workers come meanwhile)

        asyncio.run(run(create_app(studio, settings), listener, settings))


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; IsogiError where the address cannot be had."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        raise IsogiError(
            f"Cannot listen on {host} port {port}: {os.strerror(error.errno) if error.errno else error}."
        ) from error


async def run(app: FastAPI, listener: socket.socket, settings: Settings) -> None:
    """Serve the app, say where once it is ready, and end with the studio's error where it did not start."""
    config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=settings.shutdown_seconds)
    server = uvicorn.Server(config)
    stop_on_signals(server)
    service: Service = app.state.service
    serving = asyncio.create_task(server.serve([listener]))
    watching = asyncio.create_task(service.ready())
    await asyncio.wait({serving, watching}, return_when=asyncio.FIRST_COMPLETED)
    if service.failure:
        server.should_exit = True
    elif watching.done():
        click.echo(f"isogi is ready at {address(listener)}")
    watching.cancel()
    await serving
    if service.failure:
        raise service.failure


def stop_on_signals(server: uvicorn.Server) -> None:
    """Let SIGTERM and SIGINT end the server and not the process, before uvicorn listens to them and after."""

    def stop(*_: Any) -> None:
        server.should_exit = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)


def address(listener: socket.socket) -> str:
    """The URL of a listening socket."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"
