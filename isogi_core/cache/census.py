"""The census of a store: which bakes it holds, how large they are, how far baked, what they took, when last used."""

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from isogi_core.bake.precision import VOID
from isogi_core.cache.audit import READERS, Tell
from isogi_core.cache.costs import Cost
from isogi_core.cache.facts import LayerFacts, facts_in
from isogi_core.cache.inventory import Inventory, LayerFiles, inventory_of
from isogi_core.cache.record import unpack
from isogi_core.cache.root import Root
from isogi_core.cache.wrapping import unwrap
from isogi_core.errors import DamagedChunkError
from isogi_core.model.scene import digest_of

MOST_LAYERS = 2
"""Layers that a look has at most: direct and indirect light."""


@dataclass(eq=False)
class Count:
    """One layer: its ``files`` and ``facts``, and its texels by the samples that they took, VOID among these."""

    files: LayerFiles
    facts: LayerFacts
    samples: Counter[int] = field(default_factory=Counter)
    damaged: int = 0

    @property
    def lit(self) -> int:
        """Texels with light."""
        return sum(texels for samples, texels in self.samples.items() if samples > 0)

    @property
    def void(self) -> int:
        """Texels that can hold no light."""
        return self.samples[VOID]

    @property
    def paths(self) -> int:
        """Paths that its light is of."""
        return sum(max(samples, 0) * texels for samples, texels in self.samples.items())


@dataclass(eq=False)
class Census:
    """The layers of a store that can be read, and what the bakes took that they are of, by these layers' digests."""

    inventory: Inventory
    counts: dict[str, Count]
    costs: dict[tuple[str, ...], Cost]


def census_of(root: Root, texels: bool = True, tell: Tell = lambda _, __: None) -> Census:
    """Count what a store holds; without ``texels`` no chunk is read. Raises StoreError."""
    inventory = inventory_of(root.entries())
    counts = dict(each_layer(root, inventory))
    if texels:
        count_texels(root, list(counts.values()), tell)
    return Census(inventory, counts, costs_of(root, inventory, counts))


def each_layer(root: Root, inventory: Inventory) -> list[tuple[str, Count]]:
    """The layers whose metadata can be read."""
    found = []
    for digest, files in inventory.layers.items():
        stored = root.read(f"{digest}/zarr.json")
        try:
            found.append((digest, Count(files, facts_in(stored or b""))))
        except DamagedChunkError:
            continue
    return found


def count_texels(root: Root, counts: Sequence[Count], tell: Tell) -> None:
    """Read all chunks, and count their texels."""
    chunks = [(count, index) for count in counts for index in count.files.chunks]
    with ThreadPoolExecutor(READERS) as pool:
        found = pool.map(lambda chunk: samples_in(root, *chunk), chunks)
        for number, ((count, _), samples) in enumerate(zip(chunks, found, strict=True), 1):
            count.damaged += samples is None
            values, many = np.unique(np.empty(0) if samples is None else samples, return_counts=True)
            count.samples.update(dict(zip(map(int, values), map(int, many), strict=True)))
            tell(number, len(chunks))


def samples_in(root: Root, count: Count, index: tuple[int, int, int]) -> np.ndarray | None:
    """The samples of a chunk's texels; None where it is damaged."""
    facts, files = count.facts, count.files
    stored = root.read(files.chunks[index].key)
    if stored is None:
        return np.empty(0, np.int32)
    try:
        record = unwrap(stored, facts.record_size)
    except DamagedChunkError:
        return None
    found = unpack(record, facts.layer, facts.chunk_texels, files.digest, index)
    return None if found is None else found[1].samples


def costs_of(root: Root, inventory: Inventory, counts: dict[str, Count]) -> dict[tuple[str, ...], Cost]:
    """What bakes took: the name of a look is the digest of its layers', so that these are found by trying."""
    found = {}
    for layers in looks_of(counts):
        file = inventory.costs.get(digest_of(list(layers)))
        if file is not None:
            found[layers] = cost_in(root.read(file.key) or b"")
    return found


def looks_of(counts: dict[str, Count]) -> Iterator[tuple[str, ...]]:
    """The layers that may belong together, in any order: those on the same ground."""
    grounds = defaultdict(list)
    for digest, count in counts.items():
        grounds[repr(count.facts.ground)].append(digest)
    for digests in grounds.values():
        for size in range(1, MOST_LAYERS + 1):
            yield from permutations(digests, size)


def cost_in(stored: bytes) -> Cost:
    """The sum of the costs in an object; none where that is damaged."""
    total = Cost()
    try:
        for s, p, t, f in json.loads(stored)["attributes"]["chunks"].values():
            total = total.plus(Cost(float(s), int(p), int(t), float(f)))
    except (ValueError, KeyError, TypeError, AttributeError):
        return Cost()
    return total
