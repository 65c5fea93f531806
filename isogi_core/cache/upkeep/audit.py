"""The audit of a store reads and checks every object; the repair moves damaged ones to quarantine."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from isogi_core.bake.precision import VOID
from isogi_core.cache.chunk_record import LayerFacts, facts_in, find_anomaly, unpack
from isogi_core.cache.inventory import QUARANTINE_FOLDER, Inventory, inventory_of
from isogi_core.errors import DamagedChunkError
from isogi_core.model.value_survey import Progress, no_progress
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import Entry
from isogi_core.storage.store import Store
from isogi_core.storage.zarr_codec import unwrap

AUDIT_READERS = 8
"""Objects that are read at once, as a remote store answers many at a time."""

LEFT_AFTER = 60.0
"""Age in seconds from which on a half-written object is a leftover."""


class Damage(NamedTuple):
    """An object that cannot be used, and why."""

    key: str
    why: str


class SharedChunk(NamedTuple):
    """A chunk, and its objects in all layers of the same lattice, which must agree on the texels that hold light."""

    chunk: Index
    objects: tuple[tuple[str, Entry], ...]


@dataclass(eq=False)
class Audit:
    """The result of an audit; ``unread`` chunks are of layers whose metadata is damaged."""

    inventory: Inventory
    facts: dict[str, LayerFacts] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)
    unread: int = 0
    whole: int = 0

    @property
    def sound(self) -> bool:
        """Whether nothing is damaged."""
        return not self.damages


class Auditor:
    """Checks the objects of a store. It only reads, so it may run beside servers and workers."""

    def __init__(self, store: Store) -> None:
        """Read nothing yet."""
        self.store = store

    def audit(self, found: Callable[[Damage], Any] = lambda _: None, progress: Progress = no_progress) -> Audit:
        """Check everything; ``found`` is called with each damage as soon as it is known. Raises StoreError."""
        audit = Audit(inventory_of(self.store.entries()))
        self._read_facts(audit)
        chunks, done = shared_chunks(audit), 0
        total = sum(len(each.objects) for each in chunks)
        progress(done, total)
        with ThreadPoolExecutor(AUDIT_READERS) as pool:
            for each, damages in zip(chunks, pool.map(lambda each: self.check(each, audit), chunks), strict=True):
                done += len(each.objects)
                audit.damages += damages
                for damage in damages:
                    found(damage)
                progress(done, total)
        audit.whole = total - sum(damage.key.split("/")[1] == "c" for damage in audit.damages)
        return audit

    def check(self, shared: SharedChunk, audit: Audit) -> list[Damage]:
        """Check the objects of a chunk: each by itself, and then against each other."""
        damages, samples = [], {}
        for digest, found in shared.objects:
            try:
                taken = self._samples(audit.facts[digest], digest, shared.chunk, found.key)
            except DamagedChunkError as error:
                damages.append(Damage(found.key, str(error)))
            else:
                samples[found.key] = taken
        return list({damage.key: damage for damage in (*damages, *contradictions(samples))}.values())

    def _read_facts(self, audit: Audit) -> None:
        for digest, files in audit.inventory.layers.items():
            stored = self.store.read(f"{digest}/zarr.json")
            try:
                if stored is None:
                    raise DamagedChunkError("it is missing")
                audit.facts[digest] = facts_in(stored)
            except DamagedChunkError as error:
                audit.damages.append(Damage(f"{digest}/zarr.json", str(error)))
                audit.unread += len(files.chunks)

    def _samples(self, facts: LayerFacts, digest: str, index: Index, key: str) -> np.ndarray:
        """The samples of a chunk's texels in an object, (texels,) int32. Raises DamagedChunkError."""
        if not facts.holds(index):
            raise DamagedChunkError("there is no such place in its lattice")
        samples, stored = np.zeros(facts.chunk_texels, np.int32), self.store.read(key)
        if stored is None:
            return samples
        record = unwrap(stored, facts.record_size)
        found = unpack(record, facts.layer, facts.chunk_texels, digest, index)
        if found is None:
            raise DamagedChunkError("it was baked for another place")
        if odd := find_anomaly(record, facts.layer, facts.chunk_texels):
            raise DamagedChunkError(odd)
        samples[found[0]] = found[1].samples
        return samples


def shared_chunks(audit: Audit) -> list[SharedChunk]:
    """All chunks of readable layers; objects that must agree are together."""
    shared: dict[tuple[Any, ...], list[tuple[str, Entry]]] = defaultdict(list)
    for digest, facts in audit.facts.items():
        for index, found in audit.inventory.layers[digest].chunks.items():
            shared[index, repr(facts.lattice_facts)].append((digest, found))
    return [SharedChunk(index, tuple(objects)) for (index, _), objects in shared.items()]


def contradictions(samples: dict[str, np.ndarray]) -> Iterator[Damage]:
    """Pairs of objects of which one calls a texel void and the other lights it: either may be wrong."""
    for one, other in combinations(samples, 2):
        both = samples[one], samples[other]
        if any(((a == VOID) & (b > 0)).any() for a, b in (both, both[::-1])):
            yield Damage(one, f"it does not agree with {other} on which texels can hold light")
            yield Damage(other, f"it does not agree with {one} on which texels can hold light")


def leftovers(inventory: Inventory, now: float) -> Sequence[Entry]:
    """Half-written objects older than LEFT_AFTER seconds: their writers are gone."""
    return [found for found in inventory.leftovers if found.age(now) > LEFT_AFTER]


@dataclass(eq=False)
class Repair:
    """The result of a repair: ``moved`` gives the new key of each damaged object, None where it was deleted."""

    audit: Audit
    moved: dict[str, str | None] = field(default_factory=dict)
    removed: list[Entry] = field(default_factory=list)


class Repairer:
    """Audits a store and moves damaged objects to quarantine; with ``delete`` no copy of them is kept."""

    def __init__(self, store: Store, delete: bool = False) -> None:
        """Do nothing yet."""
        self.store = store
        self.delete = delete
        self._moved: dict[str, str | None] = {}

    def repair(self, progress: Progress = no_progress) -> Repair:
        """Audit the store, move or delete damaged objects, and delete leftovers. Raises StoreError."""
        audit = Auditor(self.store).audit(self._put_away, progress)
        for damage in audit.damages:
            self._put_away(damage)
        old = list(leftovers(audit.inventory, self.store.now()))
        for found in old:
            self.store.delete(found.key)
        return Repair(audit, self._moved, old)

    def _put_away(self, damage: Damage) -> None:
        """Move or delete a damaged object, once."""
        content = None if damage.key in self._moved else self.store.read(damage.key)
        if content is None:
            return
        if self.delete:
            self._moved[damage.key] = None
            self.store.delete(damage.key)
            return
        to = self._moved[damage.key] = f"{QUARANTINE_FOLDER}/{damage.key}.{sha256(content).hexdigest()[:8]}"
        self.store.move(damage.key, to)
