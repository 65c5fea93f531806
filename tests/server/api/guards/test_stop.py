"""SIGTERM to a server at work: everybody is answered, and it ends in time."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import httpx
import psutil
import pytest

from isogi_worker.fork_server import WORKER_PROCESS_NAME
from tests.cluster.processes import free_port
from tests.server.sockets import wait_for

ROOT = Path(__file__).resolve().parents[4]
CLIENTS = 6
VIEW = {"width": 64, "height": 64, "max_error": 0.0001}


@pytest.fixture
def serving(small_scene: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server process that gives its requests a second when it stops, and its address."""
    command = [
        sys.executable,
        "-m",
        "isogi_server",
        "serve",
        str(small_scene),
        "--port",
        "0",
        "--workers",
        "1",
    ]
    command += ["--store", str(tmp_path), "--shutdown-seconds", "1"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        yield process, process.stdout.readline().split()[-1]
        process.kill()


@pytest.mark.slow
def test_nobody_is_reset_or_failed(serving: tuple[subprocess.Popen[str], str]) -> None:
    """Some clients keep their connection, others open one each time; one of them waits for light
    that takes long.
    """
    (process, url) = serving
    ends = Counter[str]()

    def go_on(number: int) -> None:
        view = {**VIEW, "azimuth": 60 * number, "wait_ms": 9000 if number == 0 else 0}
        if number % 2:
            headers = {"Connection": "close"}
        else:
            headers = {}
        try:
            with httpx.Client(base_url=url, headers=headers, timeout=30) as client:
                while True:
                    ends[str(client.get("v1/scenes/small/frame", params=view).status_code)] += 1
        except Exception as error:
            ends[type(error).__name__] += 1

    threads = [threading.Thread(target=go_on, args=(number,)) for number in range(CLIENTS)]
    for thread in threads:
        thread.start()
    assert wait_for(lambda: ends["200"] > CLIENTS, 120)
    family = psutil.Process(process.pid).children(recursive=True)
    assert any(child.name() == WORKER_PROCESS_NAME for child in family)
    begun = time.monotonic()
    process.send_signal(signal.SIGTERM)
    out, error = process.communicate(timeout=30)
    for thread in threads:
        thread.join()
    assert (process.returncode, out) == (0, "") and "Traceback" not in error
    assert psutil.wait_procs(family, timeout=30)[1] == [], "no worker outlives its server"
    assert time.monotonic() - begun < 15.0
    assert set(ends) <= {"200", "503", "ConnectError"}, ends
    assert ends["ConnectError"] == CLIENTS


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
def test_a_stop_during_the_start_is_one_line(
    small_scene: Path, tmp_path: Path, compiled: bool
) -> None:
    """While workers start, or kernels are compiled: no traceback, and nothing that is left
    behind.
    """
    port = free_port()
    command = [sys.executable, "-m", "isogi_server", "serve", str(small_scene), "--port", str(port)]
    command += ["--workers", "1", "--store", str(tmp_path / "light"), "--uploads-mb", "0"]
    environment = dict(os.environ)
    if not compiled:
        environment["ISOGI_KERNEL_CACHE"] = str(tmp_path / "kernels")
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert wait_for(lambda: alive(port), 120)
        process.send_signal(signal.SIGTERM)
        out, error = process.communicate(timeout=60)
    assert (process.returncode, out) == (0, "")
    assert "isogi: stopped before it was ready" in error
    assert "Traceback" not in error and "leaked" not in error


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_before_the_socket_is_there_is_one_line(
    small_scene: Path, tmp_path: Path, number: signal.Signals
) -> None:
    """The fork server starts first; modules, the scene and its volume are loaded after it."""
    command = [sys.executable, "-m", "isogi_server", "serve", str(small_scene), "--port", "0"]
    command += ["--workers", "1", "--store", str(tmp_path / "light"), "--uploads-mb", "0"]
    # The name of a socket may be no longer than some hundred bytes, so the folder is a short one.
    with (
        tempfile.TemporaryDirectory(prefix="stop") as folder,
        subprocess.Popen(
            command,
            cwd=ROOT,
            env={**os.environ, "TMPDIR": folder},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        family = psutil.Process(process.pid)
        assert wait_for(family.children, 60)
        children = family.children(recursive=True)
        process.send_signal(number)
        out, error = process.communicate(timeout=60)
        left = list(Path(folder).iterdir())
    assert (process.returncode, out, error) == (0, "", "isogi: stopped before it was ready\n")
    assert left == [], "no socket of the fork server stays in the folder of temporary files"
    gone = psutil.wait_procs(children, timeout=30)[0]
    assert len(gone) == len(children), "no process outlives its server"


def alive(port: int) -> bool:
    """Whether a server answers at a port."""
    try:
        return httpx.get(f"http://127.0.0.1:{port}/livez", timeout=5).status_code == 200
    except httpx.TransportError:
        return False
