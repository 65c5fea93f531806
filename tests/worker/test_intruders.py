"""What another user of the machine can do to a server's processes: nothing."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.cluster.processes import LONG, QUIET, ROOT, Cluster, end, listens, reasons, until

pytestmark = pytest.mark.slow

TOKEN = "a token of the tests"

ATTACK = """
import asyncio, json, os, sys, urllib.request
from distributed.comm import connect, get_address_host_port, listen
from worker.certificates import temporary_security

PATIENCE = float(sys.argv[2])
FORGED = temporary_security().get_connection_args("client")

async def asks(protocol, port, arguments):
    comm = await connect(f"{protocol}://127.0.0.1:{port}", timeout=PATIENCE, **arguments)
    try:
        await comm.write({"op": "identity", "reply": True})
        return "id" in await comm.read()
    finally:
        comm.abort()

async def joins(*where):
    try:
        return await asyncio.wait_for(asks(*where), PATIENCE)
    except Exception:
        return False

def looks(port):
    try:
        return urllib.request.urlopen(f"http://127.0.0.1:{port}/json/identity.json", timeout=PATIENCE).status == 200
    except Exception:
        return False

async def attack(port):
    tries = joins("tcp", port, {}), joins("tls", port, FORGED), asyncio.to_thread(looks, port)
    return any(await asyncio.gather(*tries))

async def rehearse():
    async def answer(comm):
        await comm.read()
        await comm.write({"id": "this"})
    async with await listen("tcp://127.0.0.1:0", answer) as listener:
        assert await joins("tcp", get_address_host_port(listener.contact_address)[1], {})
    await attack(1)

async def main(ports):
    return [port for port, fell in zip(ports, await asyncio.gather(*map(attack, ports))) if fell]

asyncio.run(rehearse())  # imports all that the attack needs, which another user may not read
if os.getuid() == 0:
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
print(json.dumps(asyncio.run(main(json.loads(sys.argv[1])))), flush=True)
os._exit(0)
"""
"""Where the tests run as root, another user; else a client without the key. It tells the ports that let it in."""

PATIENCE = 5
"""Seconds in which a port that lets anybody in would have said so, also on a slow machine."""


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


def ports_of(*families: psutil.Process) -> list[int]:
    """Ports at which processes and their children listen."""
    family = [each for one in families for each in (one, *one.children(recursive=True))]
    connections = [each for process in family for each in process.net_connections("inet")]
    return sorted({each.laddr.port for each in connections if each.status == psutil.CONN_LISTEN})


def fallen(ports: list[int]) -> list[int]:
    """The ports that let an intruder in."""
    command = [sys.executable, "-c", ATTACK, json.dumps(ports), str(PATIENCE)]
    paths = os.pathsep.join((str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])))
    given = {**os.environ, "PYTHONPATH": paths}
    told = subprocess.run(command, cwd="/", env=given, capture_output=True, text=True, check=True, timeout=LONG)
    return list(json.loads(told.stdout))


def test_no_port_of_a_server_lets_another_user_in(embedded: psutil.Process) -> None:
    """Its own, and those of the scheduler, a nanny and a worker, with their health pages."""
    ports = ports_of(embedded)
    assert len(ports) >= 5
    assert fallen(ports) == []


def test_no_port_of_a_cluster_lets_another_user_in(small_scene: Path, tmp_path: Path) -> None:
    with Cluster() as running:
        scheduler, worker = running.scheduler(), running.worker()
        server, client = running.server(small_scene, str(tmp_path / "light"))
        until(lambda: reasons(client) == "")
        ports = ports_of(*(psutil.Process(each.pid) for each in (scheduler, worker, server)))
        assert len(ports) >= 6
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
