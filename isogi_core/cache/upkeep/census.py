"""The census of a store: its bakes, with their sizes, samples, costs and times of use."""

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from isogi_core.bake.precision import VOID
from isogi_core.bake.texel_light import Part
from isogi_core.cache.chunk_record import LayerFacts, facts_in, unpack
from isogi_core.cache.costs import Cost
from isogi_core.cache.inventory import Inventory, LayerFiles, inventory_of
from isogi_core.cache.upkeep.audit import AUDIT_READERS
from isogi_core.errors import DamagedChunkError
from isogi_core.model.value_survey import Progress, digest_of, no_progress
from isogi_core.storage.store import Store
from isogi_core.storage.zarr_codec import unwrap

MOST_LAYERS = 3
"""Most layers of a bake: direct and indirect light, and glow."""


@dataclass(eq=False)
class Count:
    """One layer: its ``files`` and ``facts``, and the number of texels by their samples (VOID included)."""

    files: LayerFiles
    facts: LayerFacts
    samples: Counter[int] = field(default_factory=Counter)
    damaged: int = 0

    @property
    def lit(self) -> int:
        """Number of texels with light."""
        return sum(texels for samples, texels in self.samples.items() if samples > 0)

    @property
    def void(self) -> int:
        """Number of texels that can hold no light."""
        return self.samples[VOID]

    @property
    def paths(self) -> int:
        """Number of paths in its light."""
        return sum(max(samples, 0) * texels for samples, texels in self.samples.items())


@dataclass(eq=False)
class Census:
    """The readable layers of a store, and the costs of their bakes by the digests of the bakes' layers."""

    inventory: Inventory
    counts: dict[str, Count]
    costs: dict[tuple[str, ...], Cost]


def census_of(store: Store, texels: bool = True, progress: Progress = no_progress) -> Census:
    """Count layers, and with ``texels`` read all chunks and count their texels. Raises StoreError."""
    inventory = inventory_of(store.entries())
    counts = dict(each_layer(store, inventory))
    if texels:
        count_texels(store, list(counts.values()), progress)
    return Census(inventory, counts, costs_of(store, inventory, counts))


def each_layer(store: Store, inventory: Inventory) -> list[tuple[str, Count]]:
    """The layers with readable metadata."""
    found = []
    for digest, files in inventory.layers.items():
        stored = store.read(f"{digest}/zarr.json")
        try:
            found.append((digest, Count(files, facts_in(stored or b""))))
        except DamagedChunkError:
            continue
    return found


def count_texels(store: Store, counts: Sequence[Count], progress: Progress) -> None:
    """Read all chunks, and count their texels."""
    chunks = [(count, index) for count in counts for index in count.files.chunks]
    with ThreadPoolExecutor(AUDIT_READERS) as pool:
        found = pool.map(lambda chunk: samples_in(store, *chunk), chunks)
        for number, ((count, _), samples) in enumerate(zip(chunks, found, strict=True), 1):
            count.damaged += samples is None
            values, many = np.unique(np.empty(0) if samples is None else samples, return_counts=True)
            count.samples.update(dict(zip(map(int, values), map(int, many), strict=True)))
            progress(number, len(chunks))


def samples_in(store: Store, count: Count, index: tuple[int, int, int]) -> np.ndarray | None:
    """The samples of a chunk's texels; None where it is damaged."""
    found = texels_in(store, count, index)
    return None if found is None else found[1].samples


def texels_in(store: Store, count: Count, index: tuple[int, int, int]) -> tuple[np.ndarray, Part] | None:
    """Offsets of a chunk's texels, and their part of a layer; none where it is gone, None where it is damaged."""
    facts, files = count.facts, count.files
    stored = store.read(files.chunks[index].key)
    if stored is None:
        return np.empty(0, np.int32), Part.undefined(facts.layer, 0)
    try:
        record = unwrap(stored, facts.record_size)
    except DamagedChunkError:
        return None
    return unpack(record, facts.layer, facts.chunk_texels, files.digest, index)


def costs_of(store: Store, inventory: Inventory, counts: dict[str, Count]) -> dict[tuple[str, ...], Cost]:
    """The costs of bakes. A bake's digest is made of its layers' digests, so bakes are found by trying."""
    found = {}
    for layers in possible_bakes(counts):
        file = inventory.costs.get(digest_of(list(layers)))
        if file is not None:
            found[layers] = cost_in(store.read(file.key) or b"")
    return found


def possible_bakes(counts: dict[str, Count]) -> Iterator[tuple[str, ...]]:
    """Layers of the same lattice, which may form a bake, in any order."""
    by_lattice = defaultdict(list)
    for digest, count in counts.items():
        by_lattice[repr(count.facts.lattice_facts)].append(digest)
    for digests in by_lattice.values():
        for size in range(1, MOST_LAYERS + 1):
            yield from permutations(digests, size)


def cost_in(stored: bytes) -> Cost:
    """The sum of the costs in an object; zero where it is damaged."""
    total = Cost()
    try:
        for s, p, t, f in json.loads(stored)["attributes"]["chunks"].values():
            total = total.plus(Cost(float(s), int(p), int(t), float(f)))
    except (ValueError, KeyError, TypeError, AttributeError):
        return Cost()
    return total
