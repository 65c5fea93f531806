"""The services of docker-compose.yml: from nothing to a picture, each of them killed, and more
workers.

    python -m benchmarks.scaling compose [--json]

The file's own commands run as processes of this machine, without containers, over a small S3 of the
tests; what ends is started again, as the file says. One service after the other is killed while a
view is baked; then there are four workers in place of one. Tells the seconds until all is well
again: until a view is final that nobody has looked at.
"""

import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import httpx

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.suite import part
from benchmarks.scaling.visiting import small_scene
from tests.cluster.composed import Composed
from tests.cluster.processes import until
from tests.s3 import S3Server

SIDE = 48
"""Pixels along each side of a view."""

WORKERS = 4
"""Workers in the end."""

AWAY = 5.0
"""Seconds for which the store is away."""

DEGREES = 67
"""Between a view and the next."""


class Watch:
    """Looks at one view after the other of what is ``running``; ``answers`` are counted by status,
    0 for none.
    """

    def __init__(self, running: Composed, client: httpx.Client, path: str) -> None:
        """Look at nothing yet."""
        self.running = running
        self.answers = Counter[int]()
        self._client = client
        self._path = path
        self._views = 0

    def shown(self) -> bool:
        """Whether the newest view has a picture."""
        return self._look(0).status_code == 200

    def final(self) -> bytes | None:
        """The picture of the newest view, once it is final."""
        answer = self._look(1000)
        if answer.headers.get("isogi-provisional") == "?0":
            return answer.content
        return None

    def seconds(self, condition: Callable[[], object]) -> float:
        """Seconds until a condition holds; what has ended is started again meanwhile."""

        def attended() -> object:
            self.running.restart()
            return condition()

        begun = time.perf_counter()
        until(attended)
        return time.perf_counter() - begun

    def next(self) -> None:
        """Have the newest view be another one."""
        self._views += 1

    def workers(self) -> float:
        """How many workers there are."""
        lines = self._ask("/metrics").text.splitlines()
        return sum(float(line.split()[1]) for line in lines if line.startswith("isogi_workers "))

    def _look(self, wait: int) -> httpx.Response:
        view: dict[str, str | int] = {
            "azimuth": DEGREES * self._views % 360,
            "width": SIDE,
            "height": SIDE,
            "f": "npy",
            "wait_ms": wait,
        }
        answer = self._ask(f"{self._path}/frame", view)
        self.answers[answer.status_code] += 1
        return answer

    def _ask(self, path: str, params: dict[str, str | int] | None = None) -> httpx.Response:
        try:
            return self._client.get(path, params=params)
        except httpx.TransportError:
            return httpx.Response(0)


def killed(watch: Watch, service: str, kill: Callable[[], object]) -> Figures:
    """Kill a service while a view is baked."""
    watch.next()
    watch.shown()
    before = watch.answers.copy()
    kill()
    seconds = watch.seconds(watch.final)
    told = watch.answers - before
    answers = ", ".join(f"{count} × {status or 'none'}" for status, count in sorted(told.items()))
    return {f"{service} killed: s to a final view": seconds, f"{service} killed: answers": answers}


def lose(s3: S3Server) -> None:
    """Have the store end every connection, as one does that is killed, until it is there again."""
    s3.fault = lambda _: "drop"

    def come() -> None:
        s3.fault = lambda _: None

    threading.Timer(AWAY, come).start()


def measured(running: Composed, s3: S3Server, path: str) -> Figures:
    """All of it, from nothing."""
    with running.client() as client:
        watch = Watch(running, client, path)
        begun = time.perf_counter()
        running.start("scheduler")
        until(lambda: running.healthy("scheduler"))
        running.start("worker")
        running.start("server")
        until(watch.shown)
        found = {"up: s to a picture": time.perf_counter() - begun}
        first = until(watch.final)
        found["up: s to a final picture"] = time.perf_counter() - begun
        for service in ("scheduler", "worker", "server"):
            found |= killed(watch, service, lambda: running.kill(service))  # noqa: B023 (called at once)
        found |= killed(watch, "store", lambda: lose(s3))
        for _ in range(WORKERS - 1):
            running.start("worker")
        found[f"1 to {WORKERS} workers: s"] = watch.seconds(lambda: watch.workers() == WORKERS)
        watch.next()
        found[f"{WORKERS} workers: s to a final view"] = watch.seconds(watch.final)
        again = Watch(running, client, path)
        return {**found, "the first picture is the same": until(again.final) == first}


@part()
def compose() -> Measurement:
    """The compose file's services as processes: up, each killed, and more workers."""
    with tempfile.TemporaryDirectory() as folder, S3Server() as s3:
        scene = Path(small_scene(Path(folder)))
        with Composed(s3, scene) as running:
            found = measured(running, s3, "/v1/scenes/small")
    return Measurement("The compose file's services, as processes", found)
