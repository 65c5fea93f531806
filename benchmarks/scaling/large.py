"""Volumes larger than memory: what it takes to build one, to render it and to serve it, in time,
memory and disk.

A volume is made by a formula, chunk by chunk, as a Zarr array of uint16: a gyroid in a ball, with
bumps. Then `isogi render` bakes and draws it with global illumination, and `isogi serve` shows it
with one worker, each in processes of their own with a cache of their own. Memory is that of the
process that has most at once.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np
import zarr

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import ready
from benchmarks.common.suite import part
from benchmarks.scaling.residents import MIB, Residents, limited

PERIODS = 6.0
"""Periods of the gyroid along each side."""

BUMPS = 40.0
"""Bumps along each side."""

CHUNK = (64, 128, 128)


def make_volume(folder: Path, size: int) -> Path:
    """Write the volume; no more than a layer of chunks is in memory."""
    path = folder / f"gyroid-{size}.zarr"
    array = zarr.create_array(
        path, shape=(size,) * 3, chunks=tuple(min(n, size) for n in CHUNK), dtype=np.uint16
    )
    for z in range(0, size, CHUNK[0]):
        array[z : z + CHUNK[0]] = gyroid(size, z, min(z + CHUNK[0], size))
    return path


def gyroid(size: int, first: int, last: int) -> np.ndarray:
    """Layers of the volume: 30,000 on the skin of a gyroid with bumps, cut by a ball; uint16."""
    axis = np.linspace(0.0, 1.0, size, dtype=np.float32)
    z = axis[first:last, None, None]
    y = axis[None, :, None]
    x = axis[None, None, :]
    k, b = np.float32(2.0 * np.pi * PERIODS), np.float32(2.0 * np.pi * BUMPS)
    skin = (
        np.sin(k * x) * np.cos(k * y)
        + np.sin(k * y) * np.cos(k * z)
        + np.sin(k * z) * np.cos(k * x)
    )
    bumps = np.sin(b * x) * np.sin(b * y) * np.sin(b * z)
    ball = 0.47 - np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2)
    value = np.minimum(skin / 3.0 + 0.05 * bumps, 12.0 * ball)
    return np.asarray(np.clip(30000.0 * (value + 1.0), 0.0, 65535.0), np.uint16)


def scene_file(volume: Path, lattice: float) -> Path:
    """A scene with the volume, seen at its skin in the light of a sky."""
    path = volume.with_suffix(".toml")
    path.write_text(
        f'volume = "{volume.name}"\nisovalue = 30000\nrotating = false\nlattice = {lattice}\n'
    )
    return path


def command(folder: Path, *arguments: str) -> list[str]:
    """The command line of isogi with a store in ``folder``."""
    return [
        sys.executable,
        "-m",
        "isogi_server",
        *arguments,
        "--store",
        str(folder / "store"),
        "--workers",
        "1",
    ]


def environment(folder: Path) -> dict[str, str]:
    """That of this process, with copies of volumes in ``folder``."""
    return {**os.environ, "ISOGI_VOLUME_CACHE": str(folder / "copies")}


def render(
    scene: Path, folder: Path, pixels: int, seconds: int, limit: int | None, picture: Path
) -> dict[str, Any]:
    """What `isogi render` takes, with the copy yet to be made."""
    size = ("--width", str(pixels), "--height", str(pixels), "--azimuth", "30", "--elevation", "25")
    work = ("-o", str(picture), "--time", f"{seconds}s", "--target-error", "0.2", "--json")
    begun = time.monotonic()
    with limited(limit) as within:
        told = command(folder, "render", str(scene), *size, *work)
        process = subprocess.Popen(
            [*within, *told], env=environment(folder), stdout=subprocess.PIPE
        )
        residents = Residents(process.pid)
        output, _ = process.communicate()
        residents.stop()
    if process.returncode:
        raise click.ClickException(f"isogi render ended with {process.returncode}.")
    facts = json.loads(output)
    baking = residents.most.get("worker: processor, s", 0.0)
    return {
        "seconds": time.monotonic() - begun,
        "final share": facts["final"],
        "estimated error": facts["error"],
        "paths": facts["paths"],
        "worker: a path with its share of the start, µs": 1e6 * baking / max(facts["paths"], 1),
        **residents.most,
    }


def serve(
    scene: Path, folder: Path, pixels: int, seconds: int, limit: int | None
) -> dict[str, Any]:
    """What `isogi serve` takes until its first frame, with the copy there, and while it bakes
    another view.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    begun = time.monotonic()
    with limited(limit) as within:
        told = command(folder, "serve", str(scene), "--port", str(port))
        process = subprocess.Popen(
            [*within, *told], env=environment(folder), stdout=subprocess.DEVNULL
        )
        residents = Residents(process.pid)
        try:
            figures = visit(process, f"http://127.0.0.1:{port}", begun, pixels, seconds)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(60)
            residents.stop()
    return {**figures, **residents.most}


def visit(
    process: subprocess.Popen[bytes], url: str, begun: float, pixels: int, seconds: int
) -> dict[str, Any]:
    """Look at the only scene of a server: the first frame, all facts, and more of the light for
    some time.
    """
    with httpx.Client(base_url=url, timeout=600.0) as client:
        while not ready(client):
            if process.poll() is not None:
                raise click.ClickException(f"isogi serve ended with {process.returncode}.")
            time.sleep(0.05)
        view = {"width": pixels, "height": pixels, "azimuth": 200.0}
        ready_after = time.monotonic() - begun
        path = f"/v1/scenes/{client.get('/v1/scenes').json()['scenes'][0]['id']}"
        first = client.get(f"{path}/frame", params=view).raise_for_status()
        shown_after = time.monotonic() - begun
        begun_facts = time.monotonic()
        client.get(path).raise_for_status()
        facts_took = time.monotonic() - begun_facts
        last = first
        while (
            time.monotonic() < begun_facts + seconds
            and "provisional=0.00" not in last.headers["isogi-coverage"]
        ):
            last = client.get(f"{path}/frame", params={**view, "wait_ms": 5000}).raise_for_status()
    return {
        "ready after, s": ready_after,
        "first frame after, s": shown_after,
        "facts of the scene, s": facts_took,
        "coverage": last.headers["isogi-coverage"],
    }


def disk(folder: Path) -> float:
    """MiB of the files in a folder, each counted once."""
    files = {
        (state := path.stat()).st_ino: state.st_size for path in folder.rglob("*") if path.is_file()
    }
    return sum(files.values()) / MIB


@part()
@click.option(
    "--size",
    "sizes",
    type=click.IntRange(64, 2048),
    multiple=True,
    default=[1024],
    help="Voxels a side.",
)
@click.option(
    "--pixels", type=click.IntRange(1, 4096), default=512, show_default=True, help="Pixels a side."
)
@click.option(
    "--seconds", type=click.IntRange(1), default=120, show_default=True, help="Time to bake, twice."
)
@click.option(
    "--lattice",
    type=click.FloatRange(0.125, 4),
    default=0.25,
    show_default=True,
    help="Texels per voxel.",
)
@click.option(
    "--limit-mb",
    "limit",
    type=click.IntRange(256),
    help="Memory of all processes, by a control group.",
)
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), help="Where files go and stay."
)
def large(
    sizes: tuple[int, ...], lattice: float, folder: Path | None, **given: Any
) -> Iterator[Measurement]:
    """Volumes larger than memory: what it takes to build, render and serve one."""
    for size in sizes:
        with tempfile.TemporaryDirectory() as temporary:
            place = folder or Path(temporary)
            place.mkdir(parents=True, exist_ok=True)
            yield Measurement(f"a gyroid of {size}³ voxels", measure(place, size, lattice, **given))


def measure(
    folder: Path, size: int, lattice: float, pixels: int, seconds: int, limit: int | None
) -> dict[str, Any]:
    """All figures of one size."""
    begun = time.monotonic()
    volume = folder / f"gyroid-{size}.zarr"
    if not volume.is_dir():
        make_volume(folder, size)
    built = time.monotonic() - begun
    scene = scene_file(volume, lattice)
    drawn = render(scene, folder, pixels, seconds, limit, folder / f"gyroid-{size}.png")
    served = serve(scene, folder, pixels, seconds, limit)
    disks = {name: disk(folder / name) for name in (volume.name, "copies", "store")}
    return {
        "building, s": built,
        **{f"render: {name}": value for name, value in drawn.items()},
        **{f"serve: {name}": value for name, value in served.items()},
        **{f"disk: {name}, MiB": value for name, value in disks.items()},
    }
