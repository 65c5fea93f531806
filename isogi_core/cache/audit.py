"""The audit of a store: every object is read and checked as whoever reads it for a frame would, and more strictly."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from isogi_core.bake.precision import VOID
from isogi_core.bake.recipe import Index
from isogi_core.cache.facts import LayerFacts, facts_in
from isogi_core.cache.inventory import Inventory, inventory_of
from isogi_core.cache.record import oddity, unpack
from isogi_core.cache.root import Root
from isogi_core.cache.shelf import Entry
from isogi_core.cache.wrapping import unwrap
from isogi_core.errors import DamagedChunkError

READERS = 8
"""Objects that are read at once: a store far away answers many at a time."""

LEFT_AFTER = 60.0
"""Seconds after which what a writer did not come to the end of is left over."""

Tell = Callable[[int, int], None]
"""Is told how many objects have been looked at, and of how many."""


class Damage(NamedTuple):
    """An object that cannot be used, and why."""

    key: str
    why: str


class Spot(NamedTuple):
    """A chunk of a lattice, and the objects that layers on the same ground have of it."""

    chunk: Index
    objects: tuple[tuple[str, Entry], ...]


@dataclass(eq=False)
class Audit:
    """What was found in a store; ``unread`` chunks are of layers whose metadata is damaged."""

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
    """Checks the objects of a store. Only reads, so that it may work beside servers and workers."""

    def __init__(self, root: Root) -> None:
        """Look at nothing yet."""
        self.root = root

    def audit(self, found: Callable[[Damage], Any] = lambda _: None, tell: Tell = lambda _, __: None) -> Audit:
        """Check everything; ``found`` is called with each damage as soon as it is known. Raises StoreError."""
        audit = Audit(inventory_of(self.root.entries()))
        self._read_facts(audit)
        spots, done = spots_of(audit), 0
        total = sum(len(spot.objects) for spot in spots)
        tell(done, total)
        with ThreadPoolExecutor(READERS) as pool:
            for spot, damages in zip(spots, pool.map(lambda each: self.check(each, audit), spots), strict=True):
                done += len(spot.objects)
                audit.damages += damages
                for damage in damages:
                    found(damage)
                tell(done, total)
        audit.whole = total - sum(damage.key.split("/")[1] == "c" for damage in audit.damages)
        return audit

    def check(self, spot: Spot, audit: Audit) -> list[Damage]:
        """What is wrong with the objects of a chunk: each by itself, and then one with another."""
        damages, samples = [], {}
        for digest, found in spot.objects:
            try:
                taken = self._samples(audit.facts[digest], digest, spot.chunk, found.key)
            except DamagedChunkError as error:
                damages.append(Damage(found.key, str(error)))
            else:
                samples[found.key] = taken
        return list({damage.key: damage for damage in (*damages, *quarrels(samples))}.values())

    def _read_facts(self, audit: Audit) -> None:
        for digest, files in audit.inventory.layers.items():
            stored = self.root.read(f"{digest}/zarr.json")
            try:
                if stored is None:
                    raise DamagedChunkError("it is missing")
                audit.facts[digest] = facts_in(stored)
            except DamagedChunkError as error:
                audit.damages.append(Damage(f"{digest}/zarr.json", str(error)))
                audit.unread += len(files.chunks)

    def _samples(self, facts: LayerFacts, digest: str, index: Index, key: str) -> np.ndarray:
        """The samples of a whole chunk's texels in an object, (texels,) int32; DamagedChunkError says what is wrong."""
        if not facts.holds(index):
            raise DamagedChunkError("there is no such place in its lattice")
        samples, stored = np.zeros(facts.chunk_texels, np.int32), self.root.read(key)
        if stored is None:
            return samples
        record = unwrap(stored, facts.record_size)
        found = unpack(record, facts.layer, facts.chunk_texels, digest, index)
        if found is None:
            raise DamagedChunkError("it was baked for another place")
        if odd := oddity(record, facts.layer, facts.chunk_texels):
            raise DamagedChunkError(odd)
        samples[found[0]] = found[1].samples
        return samples


def spots_of(audit: Audit) -> list[Spot]:
    """All chunks of layers that can be read, those side by side that must agree."""
    spots: dict[tuple[Any, ...], list[tuple[str, Entry]]] = defaultdict(list)
    for digest, facts in audit.facts.items():
        for index, found in audit.inventory.layers[digest].chunks.items():
            spots[index, repr(facts.ground)].append((digest, found))
    return [Spot(index, tuple(objects)) for (index, _), objects in spots.items()]


def quarrels(samples: dict[str, np.ndarray]) -> Iterator[Damage]:
    """Objects of which one says that a texel can hold no light, and another lights it: either may be wrong."""
    for one, other in combinations(samples, 2):
        both = samples[one], samples[other]
        if any(((a == VOID) & (b > 0)).any() for a, b in (both, both[::-1])):
            yield Damage(one, f"it does not agree with {other} on which texels can hold light")
            yield Damage(other, f"it does not agree with {one} on which texels can hold light")


def leftovers(inventory: Inventory, now: float) -> Sequence[Entry]:
    """What was left over by processes that are gone: a writer is done with its own within LEFT_AFTER seconds."""
    return [found for found in inventory.leftovers if found.age(now) > LEFT_AFTER]
