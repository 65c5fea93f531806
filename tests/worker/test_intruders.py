"""What another user of the machine can do to a server's processes: nothing.

The processes of a cluster are attacked in ``tests/cluster/test_coming_and_going.py``.
"""

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from isogi_worker.fork_server import START_METHOD
from tests.cluster.intruder import fallen, ports_of
from tests.cluster.processes import QUIET, ROOT, Cluster, end, listens, until

pytestmark = pytest.mark.cluster

TOKEN = "a token of the tests"


@pytest.fixture(scope="module")
def embedded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[psutil.Process]:
    """A server of one worker, with a token in its environment, once it is ready."""
    store = tmp_path_factory.mktemp("light")
    command = [
        "-m",
        "server",
        "serve",
        "demo:orbital",
        "--port",
        "0",
        "--workers",
        "1",
        "--store",
        str(store),
    ]
    given = {**os.environ, "ISOGI_TOKEN": TOKEN}
    with subprocess.Popen(
        [sys.executable, *command], cwd=ROOT, env=given, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout and b"ready" in process.stdout.readline()
        try:
            yield psutil.Process(process.pid)
        finally:
            end(process)


def test_no_port_of_a_server_lets_another_user_in(embedded: psutil.Process) -> None:
    """There is its own alone: workers are reached by pipes."""
    ports = ports_of(embedded)
    assert len(ports) == 1
    assert fallen(ports) == []


@pytest.mark.long
def test_a_scheduler_without_tls_lets_another_user_in() -> None:
    """The attack succeeds where nothing stands in its way: the tests above would fail without
    certificates.
    """
    with Cluster() as running:
        plain = running.run(
            "dask", "scheduler", "--host", "127.0.0.1", "--port", str(running.port), *QUIET
        )
        until(lambda: listens(running.port))
        assert fallen(ports_of(psutil.Process(plain.pid))) == [running.port]


REACH = """
import os, socket, sys
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
for path in sys.argv[1:]:
    with socket.socket(socket.AF_UNIX) as own:
        if own.connect_ex(path) == 0:
            print(path)
"""
"""Another user looks which of some Unix sockets let it in."""


@pytest.mark.skipif(
    os.getuid() != 0 or START_METHOD != "forkserver", reason="it takes root, and a fork server"
)
def test_the_fork_server_lets_no_other_user_in(embedded: psutil.Process) -> None:
    """It would run what it is told. A socket that anybody may open is reached."""
    family = [embedded, *embedded.children(recursive=True)]
    paths = {
        str(each.laddr)
        for process in family
        for each in process.net_connections("unix")
        if each.laddr
    }
    assert any("listener-" in path for path in paths)
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as public:
        own = f"{folder}/public"
        public.bind(own)
        public.listen()
        for path, mode in ((folder, 0o755), (own, 0o777)):
            Path(path).chmod(mode)
        command = [sys.executable, "-c", REACH, *sorted(paths), own]
        told = subprocess.run(command, cwd="/", capture_output=True, text=True, check=True)
    assert told.stdout.split() == [own]


def test_workers_do_not_know_the_token(embedded: psutil.Process) -> None:
    assert embedded.children(recursive=True)
    assert [
        each.pid for each in embedded.children(recursive=True) if "ISOGI_TOKEN" in each.environ()
    ] == []
