"""What another user of the machine can do to a server's processes: nothing.

The processes of a cluster are attacked in ``tests/cluster/test_coming_and_going.py``.
"""

import os
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest

from tests.cluster.intruder import fallen, ports_of
from tests.cluster.processes import QUIET, ROOT, Cluster, end, listens, until

pytestmark = pytest.mark.slow

TOKEN = "a token of the tests"


@pytest.fixture(scope="module")
def embedded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[psutil.Process]:
    """A server of one worker, with a token in its environment, once it is ready."""
    store = tmp_path_factory.mktemp("light")
    command = ["-m", "server", "serve", "demo:orbital", "--port", "0", "--workers", "1", "--store", str(store)]
    given = {**os.environ, "ISOGI_TOKEN": TOKEN}
    with subprocess.Popen([sys.executable, *command], cwd=ROOT, env=given, stdout=subprocess.PIPE) as process:
        assert process.stdout and b"ready" in process.stdout.readline()
        try:
            yield psutil.Process(process.pid)
        finally:
            end(process)


def test_no_port_of_a_server_lets_another_user_in(embedded: psutil.Process) -> None:
    """Its own, and those of the scheduler, a nanny and a worker, with their health pages."""
    ports = ports_of(embedded)
    assert len(ports) >= 5
    assert fallen(ports) == []


def test_a_scheduler_without_tls_lets_another_user_in() -> None:
    """The attack succeeds where nothing stands in its way: the tests above would fail without certificates."""
    with Cluster() as running:
        plain = running.run("dask", "scheduler", "--host", "127.0.0.1", "--port", str(running.port), *QUIET)
        until(lambda: listens(running.port))
        assert fallen(ports_of(psutil.Process(plain.pid))) == [running.port]


def test_workers_do_not_know_the_token(embedded: psutil.Process) -> None:
    assert embedded.children(recursive=True)
    assert [each.pid for each in embedded.children(recursive=True) if "ISOGI_TOKEN" in each.environ()] == []
