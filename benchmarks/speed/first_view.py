"""The first view of a scene, from the start of the server to final light, and again after a
restart.

    python -m benchmarks.speed first-view [SCENE.toml] [--size 512] [--workers 2] [--error 0.02]
    [--warm]

Starts `isogi serve` on an empty store, looks at one view over a stream, as the page does, until its
estimated error is reached and until it is final, stops the server, starts it again and compares the
picture byte for byte.
"""

import hashlib
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import httpx
from websockets.sync.client import connect

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import scene_file
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part

VIEW = {"azimuth": 40, "elevation": 30, "distance": 3, "fov": 30}

EARLY = 0.05
"""Estimated noise of a picture in which nearly nothing moves any more."""


@part(size=512)
@click.argument("target", required=False)
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option(
    "--error", default=0.02, show_default=True, help="Estimated error of the frame to wait for."
)
@click.option(
    "--most",
    default=900.0,
    show_default=True,
    help="Seconds after which it stops waiting for final light.",
)
@click.option(
    "--warm", is_flag=True, help="Have the workers bake a small view from elsewhere before."
)
def first_view(
    target: str | None, size: int, workers: int, error: float, most: float, warm: bool
) -> Measurement:
    """From the start of a server to the final light of a view, and after a restart."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or scene_file(Path(folder))
        knobs = {**VIEW, "width": size, "height": size}
        with serving(scene, f"{folder}/light", workers) as server:
            if warm:
                frame(server, {**knobs, "azimuth": 220, "width": 32, "height": 32}, wait=10.0)
            figures = {"ready after, s": server.ready_after, **watch(server, knobs, error, most)}
            figures["chunk bytes"] = digest(Path(folder, "light"))
        with serving(scene, f"{folder}/light", workers) as server:
            figures |= {
                "restart: ready after, s": server.ready_after,
                **again(server, knobs, figures),
            }
    title = f"{Path(scene).stem}, {size} × {size}, {workers} workers"
    return Measurement(title, figures, variant="warm" if warm else "")


def frame(server: Served, knobs: dict[str, Any], wait: float = 0.0) -> httpx.Response:
    """One frame of the scene, as an array."""
    params = {**knobs, "f": "npy", "wait_ms": int(1000 * wait)}
    return server.client.get(f"{server.path}/frame", params=params).raise_for_status()


def watch(server: Served, knobs: dict[str, Any], error: float, most: float) -> dict[str, Any]:
    """Look at the view until it is final, and note when it got how good."""
    figures: dict[str, Any] = {}
    with connect(server.stream, max_size=None) as socket:
        begun = time.perf_counter()
        socket.send(json.dumps({"id": 1, "view": knobs}))
        final = False
        passed = 0.0
        while not final and passed < most:
            answer = json.loads(socket.recv())
            if "problem" in answer:
                raise click.ClickException(answer["problem"]["detail"])
            socket.recv()
            passed = time.perf_counter() - begun
            final = answer["final"]
            socket.send(json.dumps({"shown": 1}))
            facts = answer["facts"]
            figures.setdefault("first picture, s", passed)
            if facts["coverage"]["provisional"] == 0.0:
                figures.setdefault("no part provisional, s", passed)
            for noise in (EARLY, error):
                if facts["noise"] <= noise:
                    figures.setdefault(f"estimated noise {noise:g}, s", passed)
            if facts["coverage"]["final"] == 1.0:
                figures.setdefault("all light final, s", passed)
    last = frame(server, knobs)
    return figures | {
        "final, s": passed,
        "final": final and last.headers["isogi-provisional"] == "?0",
        "error at the end": last.headers["isogi-error"],
        "picture": hashlib.sha256(last.content).hexdigest()[:16],
    }


def again(server: Served, knobs: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The same view from a server that was just started."""
    begun = time.perf_counter()
    answer = frame(server, knobs)
    return {
        "restart: first frame, s": time.perf_counter() - begun,
        "restart: final at once": answer.headers["isogi-provisional"] == "?0",
        "restart: same bytes": hashlib.sha256(answer.content).hexdigest()[:16] == before["picture"],
    }


def digest(store: Path) -> str:
    """SHA-256 over all chunk objects of a store, in the order of their names."""
    total = hashlib.sha256()
    for path in sorted(p for p in store.rglob("*") if p.is_file() and "/c/" in p.as_posix()):
        total.update(path.relative_to(store).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
