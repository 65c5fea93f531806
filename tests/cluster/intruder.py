"""An attack on ports of this machine, by another user or by a client without the key."""

import json
import os
import subprocess
import sys

import psutil

from tests.cluster.processes import LONG, ROOT

ATTACK = """
import asyncio, json, os, sys, urllib.request
from distributed.comm import connect, get_address_host_port, listen
from tests.cluster.certificates import temporary_security

patience = float(sys.argv[2])
FORGED = temporary_security().get_connection_args("client")

async def asks(protocol, port, arguments):
    comm = await connect(f"{protocol}://127.0.0.1:{port}", timeout=patience, **arguments)
    try:
        await comm.write({"op": "identity", "reply": True})
        return "id" in await comm.read()
    finally:
        comm.abort()

async def joins(*where):
    try:
        return await asyncio.wait_for(asks(*where), patience)
    except Exception:
        return False

def looks(port):
    try:
        address = f"http://127.0.0.1:{port}/json/identity.json"
        return urllib.request.urlopen(address, timeout=patience).status == 200
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

async def attack_nobody():
    global patience
    told, patience = patience, 0.1
    await attack(1)
    patience = told

async def main(ports):
    return [port for port, fell in zip(ports, await asyncio.gather(*map(attack, ports))) if fell]

asyncio.run(rehearse())
asyncio.run(attack_nobody())  # imports all that the attack needs, which another user may not read
if os.getuid() == 0:
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
print(json.dumps(asyncio.run(main(json.loads(sys.argv[1])))), flush=True)
os._exit(0)
"""
"""Where the tests run as root, another user; else a client without the key. It tells the ports that
let it in.
"""

PATIENCE = 5
"""Seconds in which a port that lets anybody in would have said so, also on a slow machine."""


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
    told = subprocess.run(
        command, cwd="/", env=given, capture_output=True, text=True, check=True, timeout=LONG
    )
    return list(json.loads(told.stdout))
