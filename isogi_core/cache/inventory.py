"""The inventory of a store, which sorts its objects by their keys alone, and claims on chunks.

A claim tells other bakers on the same store to take other chunks. It is a small object next to the
light, and a hint that saves time, never a lock: without claims, some chunks are baked twice. Claims
are made only after another baker was noticed, as a single baker has no use for them. A claim may be
taken over after a long wait, as its owner may have been killed. If claims cannot be read or
written, baking goes on without them.
"""

import logging
import math
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

from isogi_core.errors import ChangedError, StoreError
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import Entry, StoredObject
from isogi_core.storage.store import Store

QUARANTINE_FOLDER = "quarantine"
"""Folder that damaged objects are moved to."""

STAMPS_FOLDER = "used"
"""Folder of stamps of last use: see ``cache.chunk_store.UseStamps``."""

COSTS_FOLDER = "costs"
"""Folder of the costs of bakes: see ``cache.costs``."""

CLAIMS_FOLDER = "claims"
"""Folder of claims on chunks."""

CHUNK_KEY = re.compile(r"([0-9a-f]{20})/c/(\d+)/(\d+)/(\d+)/0")
"""Key of a chunk: the digest of its layer, its z, y, x, and 0, as the fourth axis of the Zarr
array, the bytes of a record, is not divided into chunks.
"""

LAYER_KEY = re.compile(r"([0-9a-f]{20})/zarr\.json")
COST_KEY = re.compile(rf"{COSTS_FOLDER}/([0-9a-f]{{20}})/zarr\.json")
STAMP_KEY = re.compile(rf"{STAMPS_FOLDER}/([0-9a-f]{{20}})")
LEFTOVER_KEY = re.compile(rf".*\.partial|{CLAIMS_FOLDER}/.*")
OTHER_KEYS = re.compile(r"isogi\.json|(jobs|costs|used|volumes|files|colours|glow|walls)/.*")
"""Other objects that isogi keeps in a store."""


@dataclass(eq=False)
class LayerFiles:
    """The objects of one layer: its metadata, None if that is missing,
    its chunks, and the stamp of its last use.
    """

    digest: str
    metadata: Entry | None = None
    chunks: dict[Index, Entry] = field(default_factory=dict)
    stamp: Entry | None = None

    @property
    def objects(self) -> list[Entry]:
        """All objects, the metadata last.

        A layer that is deleted in this order stays readable to the end.
        """
        return [*self.chunks.values(), *filter(None, (self.stamp, self.metadata))]

    @property
    def size(self) -> int:
        """Bytes of all objects."""
        return sum(found.size for found in self.objects)

    @property
    def used(self) -> float:
        """Time of the last write or read, by the store's calendar."""
        return max(found.written for found in self.objects)


@dataclass(eq=False)
class Inventory:
    """The objects of a store by kind.

    - ``layers``: by their digests.
    - ``costs``: by the digests of their bakes.
    - ``leftovers``: half-written objects and claims, of processes that were killed or are at work.
    - ``foreign``: objects that isogi has not written.
    - ``quarantined``: objects that a repair has found damaged and moved away.
    """

    layers: dict[str, LayerFiles] = field(default_factory=dict)
    costs: dict[str, Entry] = field(default_factory=dict)
    leftovers: list[Entry] = field(default_factory=list)
    foreign: list[Entry] = field(default_factory=list)
    quarantined: list[Entry] = field(default_factory=list)

    @property
    def chunks(self) -> int:
        """Number of objects that hold light."""
        return sum(len(layer.chunks) for layer in self.layers.values())

    def layer(self, digest: str) -> LayerFiles:
        """Return the objects of a layer; a new digest gets an empty entry."""
        return self.layers.setdefault(digest, LayerFiles(digest))

    def add(self, found: Entry) -> None:
        """Sort in an object that was found in the store, by its key. Other objects of isogi's, see
        OTHER_KEYS, are not noted.
        """
        # Quarantine comes first: an object there is never a leftover, whatever the end of its key.
        if found.key.startswith(f"{QUARANTINE_FOLDER}/"):
            self.quarantined.append(found)
        elif LEFTOVER_KEY.fullmatch(found.key):
            self.leftovers.append(found)
        elif match := CHUNK_KEY.fullmatch(found.key):
            z, y, x = map(int, match.groups()[1:])
            self.layer(match[1]).chunks[z, y, x] = found
        elif match := LAYER_KEY.fullmatch(found.key):
            self.layer(match[1]).metadata = found
        elif match := COST_KEY.fullmatch(found.key):
            self.costs[match[1]] = found
        elif not OTHER_KEYS.fullmatch(found.key):
            self.foreign.append(found)


def inventory_of(listed: Iterable[Entry]) -> Inventory:
    """Return the inventory of the objects in a listing of a store, each layer with the stamp of its
    last use.
    """
    inventory = Inventory()
    # Stamps are kept apart until the listing has ended, as one alone does not make a layer: its
    # layer may have been deleted.
    stamps = {}
    for found in listed:
        inventory.add(found)
        if match := STAMP_KEY.fullmatch(found.key):
            stamps[match[1]] = found
    for digest, layer in inventory.layers.items():
        layer.stamp = stamps.get(digest)
    return inventory


log = logging.getLogger("isogi.cache")

CONTENDED_SECONDS = 60.0
"""Seconds for which claims are made after another baker was noticed."""


class Claims:
    """The claims on chunks of a ``store``, as one process makes and reads them."""

    def __init__(self, store: Store, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without contention: no claims are made."""
        self._store = store
        self._clock = clock
        self._contended = -math.inf

    def note_contention(self) -> None:
        """Note that another baker worked on the same chunk,
        so that claims are made for CONTENDED_SECONDS.
        """
        self._contended = self._clock()

    @contextmanager
    def on(self, name: str, owner: str, insist: bool = False) -> Iterator[bool]:
        """Claim the chunk ``name`` for ``owner`` while the block runs; yield True if it is free to
        be baked.

        An owner takes over a claim that it left earlier, and with ``insist`` a claim of anyone. An
        empty owner claims nothing.
        """
        # A baker that has noticed no other saves the requests.
        if not owner or self._clock() - self._contended > CONTENDED_SECONDS:
            yield True
            return
        key = f"{CLAIMS_FOLDER}/{name}"
        ours = self._claim(key, owner.encode(), insist)
        try:
            yield ours
        finally:
            if ours:
                with suppress(StoreError):
                    self._store.delete(key)

    def _claim(self, key: str, mark: bytes, insist: bool) -> bool:
        """Make a claim, and return True if the chunk is free, or if the store takes no claims."""
        try:
            if self._put(key, mark, None):
                return True
            former = self._store.get(key)
            # The claim was deleted meanwhile, is ours, or is to be taken over: replace it, unless
            # someone else is faster.
            if (former is None or insist or former.data == mark) and self._put(key, mark, former):
                return True
        except StoreError as error:
            log.info("A chunk cannot be claimed: %s", error)
            return True
        self.note_contention()
        return False

    def _put(self, key: str, mark: bytes, former: StoredObject | None) -> bool:
        """Write a claim in place of ``former``;
        return False if another process has changed it meanwhile.
        """
        with suppress(ChangedError):
            self._store.put(key, mark, former)
            return True
        return False
