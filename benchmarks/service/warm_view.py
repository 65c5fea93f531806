"""A warm view, brought from the store into an empty page pool, beside plain reads of the same
objects.

    python -m benchmarks.service warm-view [SCENE] [--size 512] [--samples 16] [--repeats 9]
    [--json]

From a folder whose files the system has in memory, from one whose files it was told to forget
before each reading, and, where obstore is installed, from a small S3 on this machine, in a process
of its own, as many objects at once as isogi asks for. What decoding takes is counted apart, and of
that what any reader of the Zarr arrays pays: the checksums and Zstandard, object by object on one
thread. Each round begins with nothing in isogi's memory.
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
from statistics import median
from typing import Any

import click
import google_crc32c
from numcodecs.zstd import Zstd

from benchmarks.common.measurement import ROOT, Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.page_pool import PagePool
from isogi_core.cache.scene_caches import Loader
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.object_store import Bucket
from isogi_core.storage.store import CRC_BYTES, REMOTE_READERS, SENTINEL_KEY, Store
from isogi_report.speed import bake_view, make_renderer, view_of

MEMORY = 1 << 30
BUCKET = "s3://isogi/warm"


@part(size=512, repeats=9)
@click.argument("target", required=False)
@click.option("--samples", default=16, show_default=True, help="Paths of each texel that is baked.")
def warm_view(target: str | None, size: int, samples: int, repeats: int) -> Measurement:
    """A baked view brought from the store into an empty page pool, beside plain reads."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as folder:
        renderer = make_renderer(scene, folder)
        view = view_of(scene, size)
        bake_view(renderer, view, samples)
        spec = renderer.caches.spec("gi")
        chunks = renderer.surface.texels(view, renderer.gbuffer(view)).chunks
        measure = Timer(spec, chunks, repeats)
        figures: dict[str, Any] = {"chunks": len(chunks), **measure("folder", StoreUrl(folder))}
        figures |= measure("disk", StoreUrl(folder), forget=True)
        if importlib.util.find_spec("obstore") is None:
            figures["s3"] = "obstore is not installed"
        else:
            with bucket(Store(folder)) as place:
                figures |= measure("s3", place)
    return Measurement(f"{scene.name}, {size} × {size}", figures)


@contextmanager
def bucket(light: Store) -> Iterator[StoreUrl]:
    """A place in an S3 that runs meanwhile, with all objects of ``light``; this process has its
    keys.
    """
    command = [sys.executable, "-m", "tests.s3", "--port", "0"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            lines = takewhile(lambda line: line.startswith("export "), server.stdout)
            pairs = (line.removeprefix("export ").strip().partition("=") for line in lines)
            os.environ.update({name: value for name, _, value in pairs})
            place = StoreUrl(BUCKET)
            copy(light, Store(place))
            yield place
        finally:
            server.terminate()


def copy(light: Store, other: Store) -> None:
    """All objects of one store to another."""
    for layer in light.layers():
        for key in light.keys(layer):
            found = light.get(key)
            if found is not None:
                other.put(key, found.data, None)


class Timer:
    """Times how the ``chunks`` of a ``spec`` come from a place, so many ``repeats``."""

    def __init__(self, spec: BakeSpec, chunks: Sequence[Index], repeats: int) -> None:
        """Time nothing yet."""
        self.spec = spec
        self.chunks = chunks
        self.repeats = repeats

    def __call__(self, name: str, place: StoreUrl, forget: bool = False) -> dict[str, float]:
        """Figures of a view from a place beside plain reads, each the median of its rounds, and
        their ratios.
        """
        rounds = [self.round(place, forget) for _ in range(self.repeats + 1)][1:]
        found = {key: median(each[key] for each in rounds) for key in rounds[0]}
        plain = found["plain reads, ms"]
        view = found["view, ms"]
        ratios = {
            "view / plain reads": view / plain,
            "view / plain reads and unwrapping": view / (plain + found["unwrapping, ms"]),
            "view / plain reads, processor": found["view, processor ms"]
            / found["plain reads, processor ms"],
            "reads / plain reads": found["reads, ms"] / plain,
            "bytes / plain bytes": found["bytes"] / found["plain bytes"],
        }
        return {f"{name}: {key}": value for key, value in {**found, **ratios}.items()}

    def round(self, place: StoreUrl, forget: bool) -> dict[str, float]:
        """Open the store, bring a view, read the same objects again and plainly, and decode what is
        here by then.
        """
        store = ChunkStore(Store(place), self.spec)
        opening, _ = milliseconds(store.open)
        seen = Seen(store.store)
        loader = Loader(store, PagePool(self.spec, MEMORY))
        let_go(place, forget)
        view, worked = milliseconds(lambda: loader.ensure(self.chunks))
        keys = list(seen.objects)
        plain = Plain(place)
        anew = Store(place)
        anew.open()
        let_go(place, forget)
        reads, _ = milliseconds(lambda: read(place, anew.view, keys))
        let_go(place, forget)
        plainly, plain_worked = milliseconds(lambda: read(place, plain.get, keys))
        seen.held = True
        decoder = Loader(store, PagePool(self.spec, MEMORY))
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


def let_go(place: StoreUrl, forget: bool) -> None:
    """Have the system forget what files hold, if it should, so that it reads them from the disk
    again.
    """
    for path in place.folder.rglob("*") if forget else ():
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def unwrapped(objects: Iterable[bytes]) -> None:
    """Check and decompress objects one by one, as any reader of the arrays must."""
    codec = Zstd()
    for data in objects:
        body = data[:-CRC_BYTES]
        checksum = data[-CRC_BYTES:]
        assert google_crc32c.value(body) == int.from_bytes(checksum, "little")
        codec.decode(body)


class Seen:
    """The ``objects`` that are viewed of a root; once they are ``held``, they come from here."""

    def __init__(self, store: Store) -> None:
        """Look on from now on."""
        self.objects: dict[str, bytes] = {}
        self.held = False
        self._view = store.view
        store.view = self._seen  # type: ignore[method-assign]

    def _seen(self, key: str) -> bytes | None:
        if self.held:
            data = self.objects.get(key)
        else:
            data = self._view(key)
        if data is not None:
            self.objects[key] = data
        return data


class Plain:
    """Reads objects as anybody would: files, or the client library's own call."""

    def __init__(self, place: StoreUrl) -> None:
        """Connect."""
        self.bytes = 0
        self._shelf = Bucket(place, SENTINEL_KEY) if place.remote else None
        self._folder = place.folder

    def get(self, key: str) -> bytes:
        """An object that is there."""
        if self._shelf:
            found = self._shelf.get(key)
        else:
            found = None
        data = found.data if found else self._file(key)
        self.bytes += len(data)
        return data

    def _file(self, key: str) -> bytes:
        with open(f"{self._folder}/{key}", "rb") as file:
            return file.read()


def read(place: StoreUrl, get: Callable[[str], object], keys: Sequence[str]) -> None:
    """Read all of the keys: of a remote store as many at once as isogi does, else one by one."""
    if not place.remote:
        for key in keys:
            get(key)
        return
    with ThreadPoolExecutor(REMOTE_READERS) as readers:
        list(readers.map(get, keys))


def milliseconds(work: Callable[[], object]) -> tuple[float, float]:
    """What some work takes, and what it takes of the processor, by all threads of this process."""
    begun = time.perf_counter()
    spent = time.process_time()
    work()
    return 1000.0 * (time.perf_counter() - begun), 1000.0 * (time.process_time() - spent)
