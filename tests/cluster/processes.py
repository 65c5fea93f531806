"""A cluster of real processes on loopback: a Dask scheduler, workers, and servers."""

import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import httpx
import psutil

from isogi_worker.dask_pool import show_certificate
from tests.cluster.certificates import temporary_security

ROOT = Path(__file__).resolve().parent.parent.parent
LONG = 240.0
"""Seconds within which a process has started, baked or noticed something, also on a slow
machine.
"""

HEALTH = {
    f"DASK_DISTRIBUTED__{who}__HTTP__ROUTES": '["distributed.http.health"]'
    for who in ("SCHEDULER", "WORKER")
}
"""By default Dask's health pages tell everybody of workers and tasks too."""

QUIET = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")

DASK = "--tls-ca-file", "--tls-cert", "--tls-key"
OWN = "--scheduler-ca", "--scheduler-cert", "--scheduler-key"
"""Options of Dask and of isogi for the files of certificates."""

FILES = "ca.pem", "node.pem", "node.key"

DOCUMENTED = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")

Started = subprocess.Popen[bytes]


def write_certificates(folder: Path) -> None:
    """Files of a new authority, a certificate and its key: by the commands of docs/cluster.md,
    where openssl is.
    """
    if shutil.which("openssl"):
        for command in re.findall(r"^openssl .*$", DOCUMENTED, re.MULTILINE):
            subprocess.run(shlex.split(command), cwd=folder, check=True, capture_output=True)
        return
    made = temporary_security()
    for name, own in zip(FILES, ("tls_ca_file", "tls_client_cert", "tls_client_key"), strict=True):
        (folder / name).write_text(str(getattr(made, own)), encoding="ascii")


def named(options: Sequence[str], certificates: Path) -> list[str]:
    """Options that name the certificates in a folder."""
    return [
        part
        for option, name in zip(options, FILES, strict=True)
        for part in (option, str(certificates / name))
    ]


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def until(condition: Callable[[], Any], seconds: float = LONG, pause: float = 0.1) -> Any:
    """What the condition tells once it is true; it is asked with a ``pause`` between, in
    seconds.
    """
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not come true"
        time.sleep(pause)
    return found


def end(process: Started) -> None:
    """Kill a process and what it has started."""
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    for each in family:
        if each.is_running():
            each.kill()
    process.wait()
    psutil.wait_procs(family, timeout=LONG)


class Cluster:
    """Processes that end with the ``with`` block. They speak TLS with new certificates."""

    def __init__(self) -> None:
        programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        self.environment = {**os.environ, "PATH": programs, "PYTHONPATH": str(ROOT), **HEALTH}
        self.port = free_port()
        self.address = f"tls://127.0.0.1:{self.port}"
        self._running: list[Started] = []
        self._clients = ExitStack()
        self.certificates = Path(self._clients.enter_context(tempfile.TemporaryDirectory()))
        write_certificates(self.certificates)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running:
            if process.poll() is None:
                end(process)
        self._clients.close()

    def alive(self) -> list[psutil.Process]:
        """The processes that were started and have not ended."""
        return [psutil.Process(each.pid) for each in self._running if each.poll() is None]

    def run(
        self, *command: str, environment: Mapping[str, str] | None = None, **kwargs: Any
    ) -> Started:
        """Start a command of the environment that the tests run in."""
        program = shutil.which(command[0], path=self.environment["PATH"])
        process = subprocess.Popen(
            [program or command[0], *command[1:]],
            env={**self.environment, **(environment or {})},
            **kwargs,
        )
        self._running.append(process)
        return process

    def scheduler(self) -> Started:
        """Start the scheduler."""
        where = ("--host", self.address.rpartition(":")[0], "--port", str(self.port))
        started = self.run(
            "dask",
            "scheduler",
            *where,
            *named(DASK, self.certificates),
            *QUIET,
            stderr=subprocess.DEVNULL,
        )
        until(lambda: listens(self.port))
        return started

    def worker(self, *known: str, **kwargs: Any) -> Started:
        """Start a worker; it joins when it has loaded its kernels. Others than its own options may
        say who it is.
        """
        alone = (
            "--nworkers",
            "1",
            "--nthreads",
            "1",
            "--host",
            "127.0.0.1",
            *QUIET,
            "--memory-limit",
            "0",
        )
        options = (
            *alone,
            *(known or named(DASK, self.certificates)),
            "--preload",
            "isogi_worker.tasks",
        )
        return self.run(
            "dask", "worker", self.address, *options, stderr=subprocess.DEVNULL, **kwargs
        )

    def server(self, scene: Path, store: str) -> tuple[Started, httpx.Client]:
        """Start a server, which may not be ready yet."""
        port = free_port()
        listening = (
            "--port",
            str(port),
            "--store",
            store,
            "--scheduler",
            self.address,
            *named(OWN, self.certificates),
        )
        started = self.run(
            "python", "-m", "isogi_server", "serve", str(scene), *listening, cwd=ROOT
        )
        client = self._clients.enter_context(
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0)
        )
        until(lambda: status(client, "/livez") == 200)
        return started, client


def listens(port: int) -> bool:
    """Whether something answers at a port."""
    with ExitStack() as stack:
        try:
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 1.0))
        except OSError:
            return False
        return True


def status(client: httpx.Client, path: str, **params: Any) -> int:
    """The status of an answer, 0 where there is none."""
    try:
        return client.get(path, params=params).status_code
    except httpx.TransportError:
        return 0


def reasons(client: httpx.Client) -> str:
    """Why a server bakes no light; empty where it does."""
    answer = client.get("/bakez").json()
    if answer.get("ready"):
        return ""
    return " ".join(answer.get("reasons", ()))


def metric(client: httpx.Client, name: str) -> float:
    """A figure without labels in /metrics."""
    found = re.search(rf"^{name} (\S+)$", client.get("/metrics").text, re.MULTILINE)
    assert found is not None
    return float(found[1])


def final(
    client: httpx.Client, azimuth: float = 30.0, size: int = 40, seconds: float = LONG
) -> bytes:
    """The picture of a view of the scene ``small``, once all of it is final."""
    params: dict[str, str | float] = {
        "azimuth": azimuth,
        "width": size,
        "height": size,
        "f": "npy",
        "wait_ms": 2000,
    }

    def shown() -> bytes | None:
        answer = client.get("/v1/scenes/small/frame", params=params)
        done = answer.status_code == 200 and answer.headers["Isogi-Provisional"] == "?0"
        return answer.content if done else None

    return bytes(until(shown, seconds))


@contextmanager
def cluster(workers: int = 1) -> Iterator[Cluster]:
    """A scheduler and workers, which this process may join as well."""
    with (
        Cluster() as started,
        show_certificate(*(str(started.certificates / name) for name in FILES)),
    ):
        started.scheduler()
        for _ in range(workers):
            started.worker()
        yield started
