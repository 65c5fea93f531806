"""Use an installed isogi in each of its ways, and look at what comes: ``check_wheel.py`` runs this
file by the Python of an environment that has a wheel, in an empty folder.

It imports nothing but what the wheel brings.
"""

import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import nrrd
import numpy as np
from PIL import Image
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import isogi

PROGRAMS = Path(sys.executable).parent
SIDE = 64
EASY = ("--width", str(SIDE), "--height", str(SIDE), "--target-error", "0.2", "--workers", "1")
"""A picture that takes seconds once kernels are compiled."""

FRAME = f"width={SIDE}&height={SIDE}&max_error=0.2&wait_ms=1000&f=npy"
QUIET = {**os.environ, "DASK_LOGGING__DISTRIBUTED": "warning"}
"""The environment of programs; Dask's logs each step otherwise."""

PATIENCE = 600.0
"""Seconds within which a command ends on a slow machine, which compiles its kernels too."""


def command(*arguments: str) -> str:
    """What ``isogi`` prints."""
    program = str(PROGRAMS / "isogi")
    done = subprocess.run(
        [program, *arguments], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@contextmanager
def running(program: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A program of the environment, which is asked to end with the ``with`` block."""
    line = [str(PROGRAMS / program), *arguments]
    with subprocess.Popen(line, env=QUIET, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


def until(found: Callable[[], Any]) -> Any:
    """What is found, as soon as there is something."""
    deadline = time.monotonic() + PATIENCE
    while not (answer := found()):
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.2)
    return answer


def inspect_a_file() -> None:
    """A volume in an NRRD file."""
    z, y, x = np.mgrid[:12, :16, :20]
    nrrd.write("box.nrrd", (x + y + z).astype(np.uint8), index_order="C")
    facts = json.loads(command("inspect", "box.nrrd", "--json"))
    volume = facts["volume"]
    assert (volume["size"], volume["dtype"]) == ([20, 16, 12], "uint8"), volume


def render_a_picture() -> None:
    """A lit picture by workers of this machine, which keep their light."""
    command("render", "demo:casting", "-o", "frame.png", *EASY, "--store", "light")
    with Image.open("frame.png") as picture:
        assert picture.size == (SIDE, SIDE)
        assert len(set(picture.convert("L").tobytes())) > 32, "a picture has shades"
    assert any(Path("light").rglob("c/*/*/*/*")), "light is kept in chunks"


def draw_in_python() -> None:
    """The same picture by ``import isogi``, from the light that is kept."""
    with isogi.open("demo:casting", store="light", workers=1) as scene:
        picture = scene.render(width=SIDE, height=SIDE, error=0.2)
    assert picture.final and 0.0 < picture.error <= 0.2
    assert picture.radiance.shape == (SIDE, SIDE, 3) and picture.radiance[picture.mask].mean() > 0.0


def serve_frames() -> None:
    """A server's frame by HTTP, its metrics, and a picture of its only stream."""
    alone = ("--port", "0", "--streams", "1", "--uploads-mb", "0")
    options = (*alone, "--workers", "1", "--store", "light")
    with running("isogi", "serve", "demo:casting", *options) as process:
        assert process.stdout
        url = process.stdout.readline().split()[-1]
        (scene,) = json.loads(fetched(f"{url}v1/scenes"))["scenes"]
        place = f"v1/scenes/{scene['id']}"
        frame = np.load(io.BytesIO(until(lambda: final_frame(f"{url}{place}/frame"))))
        assert frame.shape == (SIDE, SIDE, 9) and frame[..., :3].max() > 0.0
        assert b"isogi_" in fetched(f"{url}metrics")
        address = f"{url.replace('http', 'ws', 1)}{place}/stream"
        with connect(address, max_size=None) as stream:
            assert refusal(address) == HTTPStatus.TOO_MANY_REQUESTS
            stream.send(json.dumps({"id": 1, "view": {"width": SIDE, "height": SIDE}}))
            assert json.loads(stream.recv(PATIENCE))["id"] == 1
            with Image.open(io.BytesIO(bytes(stream.recv(PATIENCE)))) as picture:
                assert picture.size == (SIDE, SIDE)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def refusal(address: str) -> int | None:
    """The status by which a server refuses a stream; None if it takes it."""
    try:
        connect(address).close()
    except InvalidStatus as refused:
        return refused.response.status_code
    return None


def fetched(url: str) -> bytes:
    """The body of an answer."""
    with urlopen(url, timeout=PATIENCE) as answer:
        return bytes(answer.read())


def final_frame(url: str) -> bytes | None:
    """A frame of the server, if all of it is final."""
    with urlopen(f"{url}?{FRAME}", timeout=PATIENCE) as answer:
        body = bytes(answer.read())
        return body if answer.headers["Isogi-Provisional"] == "?0" else None


def bake_on_a_cluster() -> None:
    """The same picture by a worker of a Dask scheduler, in a new store."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    no_pages = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    alone = ("--host", "127.0.0.1", "--nworkers", "1", "--nthreads", "1", "--memory-limit", "0")
    with (
        running("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), *no_pages),
        running("dask", "worker", address, *alone, *no_pages, "--preload", "isogi_worker.tasks"),
    ):
        joined = ("--scheduler", address, "--insecure-scheduler", "--store", "cluster")
        command("render", "demo:casting", "-o", "cluster.png", *EASY, *joined)
    assert any(Path("cluster").rglob("c/*/*/*/*"))


def main() -> None:
    """Take each way, and say how long it took."""
    assert Path(isogi.__file__).is_relative_to(sys.prefix), "isogi is not that of the environment"
    for use in (inspect_a_file, render_a_picture, draw_in_python, serve_frames, bake_on_a_cluster):
        began = time.monotonic()
        use()
        sys.stdout.write(f"  {use.__name__}: {time.monotonic() - began:.0f} s\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
