"""Malformed uploads to a server: none may end it, none may be an error of its own, and its memory
stays.

    python -m benchmarks.service malformed [--files 800] [--seed 1] [--json]

Starts `isogi serve` with uploads on, sends it files made by hand and mutations of good ones of
every kind, two at once, and deletes what turned out to be a volume. At the end the server is killed
in the middle of an upload.
"""

import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import httpx
import psutil

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from benchmarks.service.malformed_files import by_hand, good, mutations

QUIET = (200, 201, 413, 422, 503, 507)
"""What an upload may be answered with here; 503 where the machine is too busy to read it in
time.
"""


def send(client: httpx.Client, name: str, file: bytes) -> tuple[str, int, float, str]:
    """Send a file, and delete it where it is a volume: its name, the status, seconds, and what was
    said.
    """
    begun = time.perf_counter()
    answer = client.post("/v1/volumes", content=file)
    seconds = time.perf_counter() - begun
    said = answer.json()
    if answer.status_code in (200, 201):
        client.delete(said["href"])
    return name, answer.status_code, seconds, said.get("detail", "")


def files_of(count: int, seed: int) -> dict[str, bytes]:
    """So many malformed files by name, those made by hand first."""
    hand = by_hand()
    changed = mutations(max(count - len(hand), 0), seed)
    return {
        **dict(list(hand.items())[:count]),
        **{f"mutation {n}": file for n, file in enumerate(changed)},
    }


def killed(client: httpx.Client, folder: Path, process: psutil.Process) -> list[str]:
    """What is left in the folder of uploads of a server that is killed while it takes one."""
    halfway = threading.Event()

    def slowly() -> Iterator[bytes]:
        yield bytes(1 << 22)
        time.sleep(0.5)
        halfway.set()
        time.sleep(5.0)

    def post() -> None:
        with suppress(httpx.TransportError):
            client.post("/v1/volumes", content=slowly())

    sending = threading.Thread(target=post)
    sending.start()
    halfway.wait()
    process.send_signal(signal.SIGKILL)
    sending.join()
    return [path.name for path in folder.iterdir() if path.name != "lock" and path.stat().st_size]


def measure(
    client: httpx.Client, process: psutil.Process, files: dict[str, bytes]
) -> dict[str, Any]:
    """Send all files, and tell what came of them."""
    send(client, "good", good("gzip"))
    before = process.memory_info().rss
    most = 0
    told = []
    with ThreadPoolExecutor(2) as hands:
        for each in hands.map(lambda item: send(client, *item), files.items()):
            told.append(each)
            most = max(most, process.memory_info().rss)
    name, _, slowest, _ = max(told, key=lambda each: each[2])
    statuses = Counter(status for _, status, _, _ in told)
    return {
        "files": len(told),
        **{f"answered {status}": count for status, count in sorted(statuses.items())},
        "other answers": "; ".join(
            f"{name}: {status} {said}" for name, status, _, said in told if status not in QUIET
        ),
        "slowest, s": slowest,
        "slowest file": name,
        "memory before, MiB": before / 2**20,
        "growth at most, MiB": (most - before) / 2**20,
        "server alive": process.is_running() and client.get("/livez").status_code == 200,
    }


@part()
@click.option("--files", default=800, show_default=True, help="Files to send.")
@click.option("--seed", default=1, show_default=True, help="Of the mutations.")
def malformed(files: int, seed: int) -> Measurement:
    """Malformed uploads: none may end the server, or be an error of its own."""
    with tempfile.TemporaryDirectory() as folder:
        volumes = Path(folder, "volumes")
        store = f"{folder}/light"
        uploads = {"ISOGI_UPLOADS": str(volumes), "ISOGI_UPLOADS_MB": "512"}
        with serving("demo:orbital", store, workers=1, environment=uploads) as served:
            client = served.client
            process = psutil.Process(served.process.pid)
            figures = measure(client, process, files_of(files, seed))
            figures["left on the shelf"] = len(list(volumes.glob("*.nrrd")))
            figures["left after a kill"] = len(killed(client, volumes, process))
    return Measurement(f"{files} malformed uploads", figures)
