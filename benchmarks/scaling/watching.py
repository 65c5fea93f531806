"""Watching a store from outside while it is written: every object is read again and again, and must
be whole.
"""

import hashlib
import threading
from collections import Counter
from pathlib import Path

import numpy as np

from isogi_core.cache.upkeep import census_of, samples_in, texels_in
from isogi_core.storage.store import SENTINEL_KEY, Store


class Watcher:
    """Reads all objects of the store at ``root`` over and over in a thread of its own, from
    ``start`` to ``stop``.

    ``reads`` were made so far; ``torn`` are the keys of those that did not find a whole object, and
    ``lost`` those of objects that were there before, or held more samples. What the store held is
    known to be acknowledged.
    """

    def __init__(self, root: str) -> None:
        """Read nothing yet."""
        self.root = Path(root)
        self.reads = 0
        self.torn: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self._seen: dict[str, int] = {}
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher")

    def __enter__(self) -> "Watcher":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()

    @property
    def objects(self) -> int:
        """Objects that were seen whole."""
        return len(self._seen)

    @property
    def progress(self) -> int:
        """Samples in all of them."""
        return sum(list(self._seen.values()))

    def spec(self) -> None:
        """Read all objects once."""
        if not (self.root / SENTINEL_KEY).is_file():
            return
        root = Store(self.root, make=False)
        counts = census_of(root, texels=False).counts
        found = {
            each.key: (count, index)
            for count in counts.values()
            for index, each in count.files.chunks.items()
        }
        for key, (count, index) in found.items():
            samples = samples_in(root, count, index)
            self.reads += 1
            if samples is None:
                self.torn[key] += 1
                continue
            taken = int(samples.clip(0).sum())
            if taken < self._seen.get(key, 0):
                self.lost[key] += 1
            self._seen[key] = taken
        for key in self._seen.keys() - found.keys():
            self.lost[key] += 1

    def _run(self) -> None:
        while not self._ends.wait(0.02):
            self.spec()


def light_in(root: str) -> dict[str, str]:
    """SHA-256 of the objects of all chunks, by their keys."""
    paths = Path(root).glob("*/c/*/*/*/0")
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in paths
    }


Light = dict[tuple[str, int], tuple[int, bytes]]
"""Samples of texels, and the bytes of their light, by the key of their chunk and their offset in
it.
"""


def texels_of(root: str) -> Light:
    """The light of all texels in a store. A damaged chunk has none."""
    store = Store(root, make=False)
    light = Light()
    for count in census_of(store, texels=False).counts.values():
        for index, each in count.files.chunks.items():
            if (found := texels_in(store, count, index)) is not None:
                offsets, part = found
                named = zip(
                    offsets.tolist(),
                    part.samples.tolist(),
                    np.asarray(part.coefficients),
                    strict=True,
                )
                light |= {
                    (each.key, offset): (samples, numbers.tobytes())
                    for offset, samples, numbers in named
                }
    return light


def altered(before: Light, after: Light) -> int:
    """Texels that are lost, or have other light than before, of as many samples."""
    both = ((light, after.get(place)) for place, light in before.items())
    return sum(now is None or (now[0] == was[0] and now[1] != was[1]) for was, now in both)
