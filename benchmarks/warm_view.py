"""A warm view, brought from the store into an empty page pool, beside plain reads of the same objects.

    python -m benchmarks.warm_view [SCENE] [--size 512] [--samples 16] [--repeats 9] [--json]

From a folder whose files the system has in memory, from one whose files it was told to forget before each reading,
and, where obstore is installed, from a small S3 on this machine, in a process of its own, as many objects at once as
isogi asks for. What decoding takes is counted apart, and of that what any reader of the Zarr arrays pays: the
checksums and Zstandard, object by object on one thread. Each round begins with nothing in isogi's memory.
"""

import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from statistics import median
from typing import Any

import click
import google_crc32c
from numcodecs.zstd import Zstd

from benchmarks.common import benchmark_scene, options, show
from isogi_core.bake.look import Look
from isogi_core.bake.recipe import Index
from isogi_core.cache.bucket import Bucket
from isogi_core.cache.loader import READERS, Loader
from isogi_core.cache.pages import PagePool
from isogi_core.cache.place import Place
from isogi_core.cache.root import Root
from isogi_core.cache.sentinel import SENTINEL
from isogi_core.cache.store import ChunkStore
from isogi_core.cache.wrapping import CRC_BYTES
from server.measure import bake_view, make_renderer, view_of

ROOT = Path(__file__).resolve().parent.parent
MEMORY = 1 << 30
BUCKET = "s3://isogi/warm"


@click.command()
@click.argument("target", required=False)
@click.option("--samples", default=16, show_default=True, help="Paths of each texel that is baked.")
@options()
def main(target: str | None, size: int, samples: int, repeats: int, as_json: bool) -> None:
    """Time how a view that is baked is brought from the store."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as folder:
        renderer, view = make_renderer(scene, folder), view_of(scene, size)
        bake_view(renderer, view, samples)
        look, chunks = renderer.caches.look("gi"), renderer.texels(view, renderer.gbuffer(view)).chunks
        measure = Measure(look, chunks, repeats)
        figures: dict[str, Any] = {"chunks": len(chunks), **measure("folder", Place(folder))}
        figures |= measure("disk", Place(folder), forget=True)
        if importlib.util.find_spec("obstore") is None:
            figures["s3"] = "obstore is not installed"
        else:
            with bucket(Root(folder)) as place:
                figures |= measure("s3", place)
    show(f"{scene.name}, {size} × {size}", figures, as_json)


@contextmanager
def bucket(light: Root) -> Iterator[Place]:
    """A place in an S3 that runs meanwhile, with all objects of ``light``; this process has its keys."""
    command = [sys.executable, "-m", "tests.s3", "--port", "0"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            lines = takewhile(lambda line: line.startswith("export "), server.stdout)
            pairs = (line.removeprefix("export ").strip().partition("=") for line in lines)
            os.environ.update({name: value for name, _, value in pairs})
            place = Place(BUCKET)
            copy(light, Root(place))
            yield place
        finally:
            server.terminate()


def copy(light: Root, other: Root) -> None:
    """All objects of one store to another."""
    for layer in light.layers():
        for key in light.keys(layer):
            found = light.get(key)
            if found is not None:
                other.put(key, found.data, None)


class Measure:
    """Times how the ``chunks`` of a ``look`` come from a place, so many ``repeats``."""

    def __init__(self, look: Look, chunks: Sequence[Index], repeats: int) -> None:
        """Time nothing yet."""
        self.look, self.chunks, self.repeats = look, chunks, repeats

    def __call__(self, name: str, place: Place, forget: bool = False) -> dict[str, float]:
        """Figures of a view from a place beside plain reads, each the median of its rounds, and their ratios."""
        rounds = [self.round(place, forget) for _ in range(self.repeats + 1)][1:]
        found = {key: median(each[key] for each in rounds) for key in rounds[0]}
        plain, view = found["plain reads, ms"], found["view, ms"]
        ratios = {
            "view / plain reads": view / plain,
            "view / plain reads and unwrapping": view / (plain + found["unwrapping, ms"]),
            "view / plain reads, processor": found["view, processor ms"] / found["plain reads, processor ms"],
            "reads / plain reads": found["reads, ms"] / plain,
            "bytes / plain bytes": found["bytes"] / found["plain bytes"],
        }
        return {f"{name}: {key}": value for key, value in {**found, **ratios}.items()}

    def round(self, place: Place, forget: bool) -> dict[str, float]:
        """Open the store, bring a view, read the same objects again and plainly, and decode what is here by then."""
        store = ChunkStore(Root(place), self.look)
        opening, _ = milliseconds(store.open)
        seen, loader = Seen(store.root), Loader(store, PagePool(self.look, MEMORY))
        let_go(place, forget)
        view, worked = milliseconds(lambda: loader.ensure(self.chunks))
        keys, plain, anew = list(seen.objects), Plain(place), Root(place)
        anew.open()
        let_go(place, forget)
        reads, _ = milliseconds(lambda: read(place, anew.view, keys))
        let_go(place, forget)
        plainly, plain_worked = milliseconds(lambda: read(place, plain.get, keys))
        seen.held = True
        decoder = Loader(store, PagePool(self.look, MEMORY))
        return {
            "open, ms": opening,
            "view, ms": view,
            "view, processor ms": worked,
            "reads, ms": reads,
            "decoding, ms": milliseconds(lambda: decoder.ensure(self.chunks))[0],
            "unwrapping, ms": milliseconds(lambda: unwrapped(seen.objects.values()))[0],
            "plain reads, ms": plainly,
            "plain reads, processor ms": plain_worked,
            "bytes": float(sum(map(len, seen.objects.values()))),
            "plain bytes": float(plain.bytes),
        }


def let_go(place: Place, forget: bool) -> None:
    """Have the system forget what files hold, if it should, so that it reads them from the disk again."""
    for path in place.folder.rglob("*") if forget else ():
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def unwrapped(objects: Iterable[bytes]) -> None:
    """Check and decompress objects one by one, as any reader of the arrays must."""
    codec = Zstd()
    for data in objects:
        body, checksum = data[:-CRC_BYTES], data[-CRC_BYTES:]
        assert google_crc32c.value(body) == int.from_bytes(checksum, "little")
        codec.decode(body)


class Seen:
    """The ``objects`` that are viewed of a root; once they are ``held``, they come from here."""

    def __init__(self, root: Root) -> None:
        """Look on from now on."""
        self.objects: dict[str, bytes] = {}
        self.held = False
        self._view = root.view
        root.view = self._seen  # type: ignore[method-assign]

    def _seen(self, key: str) -> bytes | None:
        data = self.objects.get(key) if self.held else self._view(key)
        if data is not None:
            self.objects[key] = data
        return data


class Plain:
    """Reads objects as anybody would: files, or the client library's own call."""

    def __init__(self, place: Place) -> None:
        """Connect."""
        self.bytes = 0
        self._shelf = Bucket(place, SENTINEL) if place.remote else None
        self._folder = place.folder

    def get(self, key: str) -> bytes:
        """An object that is there."""
        found = self._shelf.get(key) if self._shelf else None
        data = found.data if found else self._file(key)
        self.bytes += len(data)
        return data

    def _file(self, key: str) -> bytes:
        with open(f"{self._folder}/{key}", "rb") as file:
            return file.read()


def read(place: Place, get: Callable[[str], object], keys: Sequence[str]) -> None:
    """Read all of the keys: of a remote store as many at once as isogi does, else one by one."""
    if not place.remote:
        for key in keys:
            get(key)
        return
    with ThreadPoolExecutor(READERS) as readers:
        list(readers.map(get, keys))


def milliseconds(work: Callable[[], object]) -> tuple[float, float]:
    """What some work takes, and what it takes of the processor, by all threads of this process."""
    begun, spent = time.perf_counter(), time.process_time()
    work()
    return 1000.0 * (time.perf_counter() - begun), 1000.0 * (time.process_time() - spent)


if __name__ == "__main__":
    main()
