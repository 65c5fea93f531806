"""The first view of a scene, from the start of the server to final light, and again after a restart.

    python -m benchmarks.speed first-view [SCENE.toml] [--size 512] [--workers 2] [--error 0.02] [--warm]

Starts `isogi serve` on an empty store, asks for one view until its estimated error is reached and
until it is final, stops the server, starts it again and compares the picture byte for byte.
"""

import hashlib
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import httpx

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import scene_file
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from isogi_client import error_of_header

VIEW = {"azimuth": 40, "elevation": 30, "distance": 3, "fov": 30, "f": "npy"}


@part(size=512)
@click.argument("target", required=False)
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option("--error", default=0.02, show_default=True, help="Estimated error of the frame to wait for.")
@click.option("--most", default=900.0, show_default=True, help="Seconds after which it stops waiting for final light.")
@click.option("--warm", is_flag=True, help="Have the workers bake a small view from elsewhere before.")
def first_view(target: str | None, size: int, workers: int, error: float, most: float, warm: bool) -> Measurement:
    """From the start of a server to the final light of a view, and after a restart."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or scene_file(Path(folder))
        knobs = {**VIEW, "width": size, "height": size}
        with serving(scene, f"{folder}/light", workers) as server:
            if warm:
                frame(server.client, {**knobs, "azimuth": 220, "width": 32, "height": 32}, wait=10.0)
            figures = {"ready after, s": server.ready_after, **watch(server.client, knobs, error, most)}
            figures["chunk bytes"] = digest(Path(folder, "light"))
        with serving(scene, f"{folder}/light", workers) as server:
            figures |= {"restart: ready after, s": server.ready_after, **again(server.client, knobs, figures)}
    title = f"{Path(scene).stem}, {size} × {size}, {workers} workers"
    return Measurement(title, figures, variant="warm" if warm else "")


def frame(client: httpx.Client, knobs: dict[str, Any], wait: float = 0.0) -> httpx.Response:
    """One frame of the only scene."""
    (scene,) = client.get("/v1/scenes").json()["scenes"]
    answer = client.get(f"/v1/scenes/{scene['id']}/frame", params={**knobs, "wait_ms": int(1000 * wait)})
    return answer.raise_for_status()


def watch(client: httpx.Client, knobs: dict[str, Any], error: float, most: float) -> dict[str, Any]:
    """Ask for the view until it is final, and note when it got how good."""
    begun = time.perf_counter()
    answer = frame(client, knobs)
    figures: dict[str, Any] = {
        "first frame, s": time.perf_counter() - begun,
        "first frame provisional": answer.headers["isogi-provisional"] == "?1",
    }
    while answer.headers["isogi-provisional"] == "?1" and time.perf_counter() - begun < most:
        answer = frame(client, knobs, wait=1.0)
        passed = time.perf_counter() - begun
        if "provisional=0.000" in answer.headers["isogi-coverage"]:
            figures.setdefault("no part provisional, s", passed)
        if noise_of(answer) <= error:
            figures.setdefault(f"estimated noise {error:g}, s", passed)
        if "final=1.000" in answer.headers["isogi-coverage"]:
            figures.setdefault("all light final, s", passed)
    figures["final, s"] = time.perf_counter() - begun
    figures["final"] = answer.headers["isogi-provisional"] == "?0"
    figures["error at the end"] = answer.headers["isogi-error"]
    figures["picture"] = hashlib.sha256(answer.content).hexdigest()[:16]
    return figures


def noise_of(answer: httpx.Response) -> float:
    """The estimated noise of a frame."""
    return float(error_of_header(answer.headers["isogi-error"])["noise"])


def again(client: httpx.Client, knobs: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The same view from a server that was just started."""
    begun = time.perf_counter()
    answer = frame(client, knobs)
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
