"""A server process of its own, as benchmarks need it: started on a free port, looked at from
outside, and stopped.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import IO

import httpx
import psutil

from isogi_worker.fork_server import WORKER_PROCESS_NAME

MIB = 1 << 20


@dataclass(frozen=True, eq=False)
class Served:
    """A server that is ready: its process, a client of it, and after how many seconds it was."""

    process: subprocess.Popen[bytes]
    client: httpx.Client
    ready_after: float

    @property
    def url(self) -> str:
        """The address, without a slash at its end."""
        return str(self.client.base_url).rstrip("/")

    @cached_property
    def path(self) -> str:
        """The path of the scene that it was started with; uploads are others."""
        scene, *_ = self.client.get("/v1/scenes").json()["scenes"]
        return f"/v1/scenes/{scene['id']}"

    @property
    def stream(self) -> str:
        """The address of the scene's stream."""
        return f"{self.url.replace('http', 'ws', 1)}{self.path}/stream"

    @property
    def workers(self) -> list[psutil.Process]:
        """The processes that bake."""
        children = psutil.Process(self.process.pid).children(recursive=True)
        return [child for child in children if name(child) == WORKER_PROCESS_NAME]

    def footprint(self) -> dict[str, float]:
        """What the server and its workers take now: memory in MiB, open files, processes."""
        own = psutil.Process(self.process.pid)
        workers = self.workers
        return {
            "server, MiB": own.memory_info().rss / MIB,
            "workers, MiB": sum(worker.memory_info().rss for worker in workers) / MIB,
            "open files": own.num_fds(),
            "child processes": len(own.children(recursive=True)),
        }

    def metric(self, name: str) -> float:
        """A figure without labels in /metrics."""
        found = re.search(rf"^{name} (\S+)$", self.client.get("/metrics").text, re.MULTILINE)
        assert found is not None, f"{name} is not among the metrics"
        return float(found[1])

    def labelled(self, name: str, **labels: str) -> float:
        """A figure with labels in /metrics; 0 where nothing was counted yet."""
        told = ",".join(f'{label}="{value}"' for label, value in labels.items())
        lines = self.client.get("/metrics").text.splitlines()
        return sum(
            float(line.split()[-1]) for line in lines if line.startswith(f"{name}{{{told}}} ")
        )

    def stop(self, seconds: float = 30.0) -> float:
        """Ask it to stop, and wait for that; the seconds it took."""
        begun = time.perf_counter()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(seconds)
        return time.perf_counter() - begun


@contextmanager
def serving(
    scene: str,
    store: str,
    workers: int,
    *options: str,
    environment: Mapping[str, str] | None = None,
    errors: IO[bytes] | None = None,
) -> Iterator[Served]:
    """A server process with a scene and a store, until the end of the block; its ``environment`` is
    added to ours.

    What it logs goes to the file ``errors``, where one is given.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "isogi_server",
        "serve",
        scene,
        "--port",
        str(port),
        "--store",
        store,
        *options,
    ]
    begun = time.perf_counter()
    surroundings = {**os.environ, **(environment or {})}
    command += ["--workers", str(workers)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, env=surroundings)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0) as client:
            while not ready(client):
                time.sleep(0.05)
            yield Served(process, client, time.perf_counter() - begun)
    finally:
        process.send_signal(signal.SIGTERM)  # nothing where it has ended
        process.wait(30)


def name(process: psutil.Process) -> str:
    """Its name; empty where it has just ended."""
    try:
        return str(process.name())
    except psutil.NoSuchProcess:
        return ""


def ready(client: httpx.Client) -> bool:
    """Whether the server says that it is ready."""
    try:
        return client.get("/bakez").status_code == 200
    except httpx.TransportError:
        return False
