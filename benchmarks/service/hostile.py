"""Requests that no person sends: generated from the API's own document by Schemathesis, and a list
that means harm.
"""

import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from benchmarks.common.serving import Served
from isogi_server.parameters import FrameParams
from tests.server.api.guards.test_hostile import HOSTS, NUMBERS, WORDS, paths, said
from tests.server.sockets import status

PROGRAM = "schemathesis"

CONFIG = """
[parameters]
"path.scene" = "{scene}"
"query.width" = 48
"query.height" = 48
"query.samples" = 1
"query.wait_ms" = 0
"""
"""What is not generated: a scene that there is, and parameters that would have a machine render for
hours.
"""

LEFT_OUT = "/events$|^/v1/volumes$"
"""Answers that do not end by themselves, and uploads, each of which has a process of its own read
it: the part ``malformed`` sends those."""


def program() -> str | None:
    """Where Schemathesis is: beside this Python, or where the shell finds it; None where it is not
    installed.
    """
    return shutil.which(PROGRAM, path=str(Path(sys.executable).parent)) or shutil.which(PROGRAM)


def generated(served: Served, folder: Path, requests: int) -> tuple[Counter[int], str]:
    """What some ``requests`` made by Schemathesis were answered, and where it is not installed,
    that nothing was sent.

    It has as many for each operation, and some of its own that look for edges: more come than are
    asked for.
    """
    sends = program()
    if sends is None:
        return Counter(), f"{PROGRAM} is not installed"
    (folder / "schemathesis.toml").write_text(
        CONFIG.format(scene=served.path.rpartition("/")[2]), encoding="utf-8"
    )
    document = served.client.get("/openapi.json").json()
    operations = sum(
        len(methods) for path, methods in document["paths"].items() if not re.search(LEFT_OUT, path)
    )
    command = [
        sends,
        "run",
        f"{served.url}/openapi.json",
        "--max-examples",
        str(-(-requests // operations)),
    ]
    command += [
        "--checks",
        "not_a_server_error",
        "--phases",
        "coverage,fuzzing",
        "--exclude-path-regex",
        LEFT_OUT,
    ]
    command += [
        "--suppress-health-check",
        "all",
        "--request-timeout",
        "30",
        "--seed",
        "1",
        "--no-shrink",
    ]
    before = answered(served)
    subprocess.run(
        [*command, "--continue-on-failure"], cwd=folder, stdout=subprocess.DEVNULL, check=False
    )
    return answered(served) - before, ""


def answered(served: Served) -> Counter[int]:
    """Answers so far, by status."""
    counts = Counter[int]()
    for line in served.client.get("/metrics").text.splitlines():
        if found := re.match(r'isogi_requests_total\{.*status="(\d+)".*\} (\S+)', line):
            counts[int(found[1])] += int(float(found[2]))
    return counts


def hostile(served: Served, folder: Path) -> Counter[int]:
    """What was answered to numbers that are none, to ways out of the folder of files, and to other
    hosts' names.
    """
    secret = folder / "secret.txt"
    counts = Counter[int]()
    for name in FrameParams.model_fields:
        for number in () if name in WORDS else NUMBERS:
            counts[
                served.client.get(f"{served.path}/frame", params={name: number}).status_code
            ] += 1
            counts[
                served.client.get(f"{served.path}/coverage", params={name: number}).status_code
            ] += 1
    for path in paths(secret):
        counts[status(said(served.url, f"GET {path} HTTP/1.1", "Host: localhost"))] += 1
    for host in HOSTS:
        for path in ("/", "/livez", "/v1/scenes", "/metrics"):
            counts[status(said(served.url, f"GET {path} HTTP/1.1", f"Host: {host}"))] += 1
    return counts
