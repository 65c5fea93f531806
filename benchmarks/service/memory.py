"""Memory of one server that is asked for much: small uploads, all of them looked at, and views that
all differ.

    python -m benchmarks.service memory [--uploads 10000] [--uploads-mb 64] [--requests 10000]
    [--views 3000]
        [--memory-mb 1024] [--json]

Volumes of eight voxels are sent, each another one, far more than the quota takes. The server is
started again, and every volume that it kept is looked at. Then come requests that Schemathesis
makes of the API's own document (none where it is not installed), those of a list that means harm,
and views of the server's own scene, none like another. Tells what was answered, and the server's
memory (RSS) each time.
"""

import random
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.service.hostile import generated, hostile

HEADER = (
    b"NRRD0004\ntype: uint16\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nendian: "
    b"little\nspacings: 1 1 1\n\n"
)
SIDE = 96
"""Pixels along each side of a view."""

AT_ONCE = 2
"""Requests at a time."""


def volume(number: int) -> bytes:
    """Eight voxels, each time others."""
    values = [0, 65535, number % 65536, number // 65536, 7, 99, 1000, 30000]
    return HEADER + b"".join(value.to_bytes(2, "little") for value in values)


def asked(ask: Callable[[int], int], numbers: Iterable[int]) -> Counter[int]:
    """How often which status came."""
    with ThreadPoolExecutor(AT_ONCE) as threads:
        return Counter(threads.map(ask, numbers))


def sent(served: Served, uploads: int) -> Counter[int]:
    """What uploads were answered."""
    return asked(
        lambda n: served.client.post("/v1/volumes", content=volume(n)).status_code, range(uploads)
    )


def looked(served: Served) -> Counter[int]:
    """What a picture of each volume was answered."""
    scenes = [each["scene"] for each in served.client.get("/v1/volumes").json()["volumes"]]
    size = {"width": SIDE, "height": SIDE}
    return asked(
        lambda n: served.client.get(f"{scenes[n]}/frame", params=size).status_code,
        range(len(scenes)),
    )


def viewed(served: Served, numbers: range) -> Counter[int]:
    """What views of the server's own scene were answered, each of another side and isovalue."""
    span = served.client.get(served.path).json()["ranges"]["isovalue"]

    def view(number: int) -> int:
        chance = random.Random(number)
        camera = {"azimuth": chance.uniform(0.0, 360.0), "elevation": chance.uniform(-60.0, 60.0)}
        isovalue = span["min"] + (span["max"] - span["min"]) * chance.uniform(0.1, 0.6)
        size = {"width": SIDE, "height": SIDE, "isovalue": isovalue}
        return served.client.get(f"{served.path}/frame", params={**camera, **size}).status_code

    return asked(view, numbers)


def told(what: str, statuses: Counter[int], served: Served) -> Figures:
    """What was answered, and the server's memory then."""
    counts = {f"{what}: answered {status}": count for status, count in sorted(statuses.items())}
    return {**counts, f"{what}: server, MiB": served.footprint()["server, MiB"]}


def measure(
    target: str, folder: Path, uploads: int, requests: int, views: int, options: Sequence[str]
) -> Figures:
    """All of it, with one server and then another. ``options`` are the servers'."""
    quota = {"ISOGI_UPLOADS": f"{folder}/volumes"}
    with serving(target, f"{folder}/light", 1, *options, environment=quota) as served:
        found = dict(told("before", Counter(), served))
        begun = time.perf_counter()
        found |= told("uploads", sent(served, uploads), served)
        found["uploads: s"] = time.perf_counter() - begun
    kept = len(list((folder / "volumes").glob("*.nrrd")))
    with serving(target, f"{folder}/light", 1, *options, environment=quota) as served:
        found |= {"kept": kept, "restart: ready after, s": served.ready_after}
        found |= told("restart", Counter(), served)
        found |= told("volumes looked at", looked(served), served)
        counts, lacking = generated(served, folder, requests)
        found |= {"Schemathesis": lacking or "ran"}
        found |= told("Schemathesis", counts, served)
        found |= told("hostile requests", hostile(served, folder), served)
        found |= told("half of the views", viewed(served, range(views // 2)), served)
        found |= told("all views", viewed(served, range(views // 2, views)), served)
    drift = (
        float(found["all views: server, MiB"]) / float(found["half of the views: server, MiB"])
        - 1.0
    )
    return {**found, "drift from half to all views": drift}


@part()
@click.argument("target", default="demo:orbital")
@click.option("--uploads", default=10_000, show_default=True, help="Volumes to send.")
@click.option("--uploads-mb", default=64, show_default=True, help="Megabytes that they may take.")
@click.option(
    "--requests",
    default=10_000,
    show_default=True,
    help="Requests that Schemathesis makes, at least.",
)
@click.option("--views", default=3000, show_default=True, help="Views, none like another.")
@click.option(
    "--memory-mb", default=1024, show_default=True, help="Megabytes that scenes keep in memory."
)
def memory(
    target: str, uploads: int, uploads_mb: int, requests: int, views: int, memory_mb: int
) -> Measurement:
    """What a server takes that is sent many small volumes and hostile requests, and asked for many
    views.
    """
    options = "--memory-mb", str(memory_mb), "--uploads-mb", str(uploads_mb)
    with tempfile.TemporaryDirectory() as folder:
        found = measure(target, Path(folder), uploads, requests, views, options)
    return Measurement(f"Memory at --memory-mb {memory_mb}, --uploads-mb {uploads_mb}", found)
