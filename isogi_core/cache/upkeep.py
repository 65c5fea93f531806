"""The upkeep of a store: its census, its audit with repair, and pruning."""

import logging
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from hashlib import sha256
from itertools import combinations, permutations
from typing import Any, NamedTuple, TypeVar

import numpy as np

from isogi_core.bake.texel_light import VOID, Part
from isogi_core.cache.chunk_record import LayerFacts, facts_in, find_anomaly, unpack
from isogi_core.cache.costs import Cost, costs_in
from isogi_core.cache.inventory import QUARANTINE_FOLDER, Inventory, LayerFiles, inventory_of
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.model.value_survey import Progress, digest_of, no_progress
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import Entry
from isogi_core.storage.store import Store, unwrap

AUDIT_READERS = 8
"""Objects that are read at once, as a remote store answers many at a time."""

LEFT_AFTER = 60.0
"""Age in seconds from which on a half-written object is a leftover."""

Checked = TypeVar("Checked")


class Damage(NamedTuple):
    """An object that cannot be used, and why."""

    key: str
    why: str


class SharedChunk(NamedTuple):
    """A chunk, and its objects in all layers of the same lattice, which must agree on the texels
    that hold light.
    """

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


def audit_store(
    store: Store, found: Callable[[Damage], Any] = lambda _: None, progress: Progress = no_progress
) -> Audit:
    """Check all objects of a ``store``. It only reads, so it may run beside servers and workers.
    Raises StoreError.

    ``found`` is called with each damage as soon as it is known.
    """
    result = Audit(inventory_of(store.entries()))
    _audit_facts(store, result)
    chunks = shared_chunks(result)
    done = 0
    total = sum(len(each.objects) for each in chunks)
    progress(done, total)
    with ThreadPoolExecutor(AUDIT_READERS) as pool:
        checked = pool.map(lambda each: check_chunk(store, each, result.facts), chunks)
        for each, damages in zip(chunks, checked, strict=True):
            done += len(each.objects)
            result.damages += damages
            for damage in damages:
                found(damage)
            progress(done, total)
    result.whole = total - sum(damage.key.split("/")[1] == "c" for damage in result.damages)
    return result


def check_chunk(store: Store, shared: SharedChunk, facts: Mapping[str, LayerFacts]) -> list[Damage]:
    """Check the objects of a chunk: each by itself, and then against each other."""
    damages = []
    samples = {}
    for digest, found in shared.objects:
        try:
            samples[found.key] = twice(
                partial(_sound_samples, store, facts[digest], digest, shared.chunk, found.key)
            )
        except DamagedChunkError as error:
            damages.append(Damage(found.key, str(error)))
    return list({damage.key: damage for damage in (*damages, *contradictions(samples))}.values())


def twice(check: Callable[[], Checked]) -> Checked:
    """The result of a ``check``; one that finds damage runs again, as the damage may be of one
    answer of the store and not of the object. Raises DamagedChunkError if it finds damage again.
    """
    try:
        return check()
    except DamagedChunkError:
        return check()


def _audit_facts(store: Store, result: Audit) -> None:
    """Read the metadata of all layers."""
    for digest, files in result.inventory.layers.items():
        try:
            result.facts[digest] = twice(partial(read_facts, store, digest))
        except DamagedChunkError as error:
            result.damages.append(Damage(f"{digest}/zarr.json", str(error)))
            result.unread += len(files.chunks)


def read_facts(store: Store, digest: str) -> LayerFacts:
    """The facts of a layer; DamagedChunkError where its metadata is missing or damaged."""
    stored = store.read(f"{digest}/zarr.json")
    if stored is None:
        raise DamagedChunkError("it is missing")
    return facts_in(stored)


def _sound_samples(
    store: Store, facts: LayerFacts, digest: str, index: Index, key: str
) -> np.ndarray:
    """The samples of a chunk's texels in an object, (texels,) int32. Raises DamagedChunkError."""
    if not facts.holds(index):
        raise DamagedChunkError("there is no such place in its lattice")
    samples = np.zeros(facts.chunk_texels, np.int32)
    stored = store.read(key)
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
    """Pairs of objects of which one calls a texel void and the other lights it: either may be
    wrong.
    """
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
    """The result of a repair: ``moved`` gives the new key of each damaged object, None where it was
    deleted.
    """

    audit: Audit
    moved: dict[str, str | None] = field(default_factory=dict)
    removed: list[Entry] = field(default_factory=list)


def repair_store(store: Store, delete: bool = False, progress: Progress = no_progress) -> Repair:
    """Audit a store, and move damaged objects to quarantine; with ``delete`` no copy of them is
    kept.

    Leftovers are deleted, too. Raises StoreError.
    """
    moved: dict[str, str | None] = {}

    def put_away(damage: Damage) -> None:
        if damage.key in moved:
            content = None
        else:
            content = store.read(damage.key)
        if content is None:
            return
        if delete:
            moved[damage.key] = None
            store.delete(damage.key)
            return
        to = moved[damage.key] = (
            f"{QUARANTINE_FOLDER}/{damage.key}.{sha256(content).hexdigest()[:8]}"
        )
        store.move(damage.key, to)

    found = audit_store(store, put_away, progress)
    for damage in found.damages:
        put_away(damage)
    old = list(leftovers(found.inventory, store.now()))
    for each in old:
        store.delete(each.key)
    return Repair(found, moved, old)


MOST_LAYERS = 3
"""Most layers of a bake: direct and indirect light, and glow."""


@dataclass(eq=False)
class Count:
    """One layer: its ``files`` and ``facts``, and the number of texels by their samples (VOID
    included).
    """

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
    """The readable layers of a store, and the costs of their bakes by the digests of the bakes'
    layers.
    """

    inventory: Inventory
    counts: dict[str, Count]
    costs: dict[tuple[str, ...], Cost]


def census_of(store: Store, texels: bool = True, progress: Progress = no_progress) -> Census:
    """Count layers, and with ``texels`` read all chunks and count their texels. Raises
    StoreError.
    """
    inventory = inventory_of(store.entries())
    counts = dict(each_layer(store, inventory))
    if texels:
        count_texels(store, list(counts.values()), progress)
    return Census(inventory, counts, costs_of(store, inventory, counts))


def each_layer(store: Store, inventory: Inventory) -> list[tuple[str, Count]]:
    """The layers with readable metadata."""
    found = []
    for digest, files in inventory.layers.items():
        with suppress(DamagedChunkError):
            found.append((digest, Count(files, twice(partial(read_facts, store, digest)))))
    return found


def count_texels(store: Store, counts: Sequence[Count], progress: Progress) -> None:
    """Read all chunks, and count their texels."""
    chunks = [(count, index) for count in counts for index in count.files.chunks]
    with ThreadPoolExecutor(AUDIT_READERS) as pool:
        found = pool.map(lambda chunk: samples_in(store, *chunk), chunks)
        for number, ((count, _), samples) in enumerate(zip(chunks, found, strict=True), 1):
            count.damaged += samples is None
            values, many = np.unique(
                np.empty(0) if samples is None else samples, return_counts=True
            )
            count.samples.update(dict(zip(map(int, values), map(int, many), strict=True)))
            progress(number, len(chunks))


def samples_in(store: Store, count: Count, index: tuple[int, int, int]) -> np.ndarray | None:
    """The samples of a chunk's texels; None where it is damaged."""
    found = texels_in(store, count, index)
    if found is None:
        return None
    return found[1].samples


def texels_in(
    store: Store, count: Count, index: tuple[int, int, int]
) -> tuple[np.ndarray, Part] | None:
    """Offsets of a chunk's texels, and their part of a layer; none where it is gone, None where it
    is damaged.
    """
    facts = count.facts
    files = count.files
    stored = store.get_sound(files.chunks[index].key)
    if stored is None:
        return np.empty(0, np.int32), Part.undefined(facts.layer, 0)
    try:
        record = unwrap(stored.data, facts.record_size)
    except DamagedChunkError:
        return None
    return unpack(record, facts.layer, facts.chunk_texels, files.digest, index)


def costs_of(
    store: Store, inventory: Inventory, counts: dict[str, Count]
) -> dict[tuple[str, ...], Cost]:
    """The costs of bakes. A bake's digest is made of its layers' digests, so bakes are found by
    trying.
    """
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
    try:
        return reduce(Cost.plus, costs_in(stored).values(), Cost())
    except (ValueError, KeyError, TypeError, AttributeError):
        return Cost()


BUSY_SECONDS = 60.0
"""Seconds since its last write for which a layer counts as being written to."""


@dataclass(frozen=True)
class PruneRule:
    """Layers to delete: those not used for ``older_than`` seconds, and the longest unused beyond
    ``keep`` bytes.

    With ``scene`` only layers of the scene or volume of that name go. With ``empty`` layers without
    light go too.
    """

    older_than: float = math.inf
    keep: float = math.inf
    scene: str | None = None
    empty: bool = False


@dataclass(frozen=True, eq=False)
class PrunePlan:
    """The layers to delete, the longest unused first, and ``busy`` ones, which are being written to
    and stay.
    """

    going: tuple[Count, ...]
    busy: tuple[Count, ...]

    @property
    def size(self) -> int:
        """Bytes that are freed."""
        return sum(count.files.size for count in self.going)


def plan_prune(census: Census, rule: PruneRule, now: float) -> PrunePlan:
    """Choose the layers to delete by a ``rule``. Raises StoreError where the store does not know
    ages.
    """
    counts = sorted(census.counts.values(), key=lambda count: count.files.used)
    if any(math.isnan(count.files.used) for count in counts):
        raise StoreError(
            "This store does not know when its objects were written: name the scene whose "
            "light goes."
        )
    wanted = chosen([count for count in counts if is_of(count, rule.scene)], rule, now)
    busy = [count for count in wanted if now - newest(count.files) <= BUSY_SECONDS]
    return PrunePlan(tuple(count for count in wanted if count not in busy), tuple(busy))


def chosen(counts: Sequence[Count], rule: PruneRule, now: float) -> list[Count]:
    """The layers, the longest unused first, that a rule deletes."""
    total = sum(count.files.size for count in counts)
    going = []
    everything = rule.scene is not None and rule == PruneRule(scene=rule.scene)
    for count in counts:
        old = now - count.files.used > rule.older_than
        empty = rule.empty and not count.files.chunks
        if everything or old or empty or total > rule.keep:
            going.append(count)
            total -= count.files.size
    return going


def is_of(count: Count, name: str | None) -> bool:
    """Whether a layer is of the scene, or of the volume, of that name; None stands for any."""
    return name is None or name in (
        count.facts.attributes.get("scene"),
        count.facts.attributes.get("volume"),
    )


def newest(files: LayerFiles) -> float:
    """Time of the last write to a layer, stamps of use left out."""
    return max(
        (found.written for found in files.objects if found is not files.stamp), default=-math.inf
    )


def delete_layers(store: Store, census: Census, plan: PrunePlan) -> list[Entry]:
    """Delete the layers of a plan, and costs of their bakes; returns the deleted objects. Raises
    StoreError.
    """
    gone = [found for count in plan.going for found in count.files.objects] + stale_costs(
        census, plan
    )
    for found in gone:
        store.delete(found.key)
    return gone


def stale_costs(census: Census, plan: PrunePlan) -> list[Entry]:
    """The costs of bakes that lose a layer."""
    going = {count.files.digest for count in plan.going}
    names = [digest_of(list(layers)) for layers in census.costs if going.intersection(layers)]
    return [census.inventory.costs[name] for name in names]


log = logging.getLogger("isogi.cache")


def trim_projected(store: Store, most: int) -> int:
    """Delete layers for single isovalues, the longest unused first, beyond ``most`` bytes at
    ``store``; how many went.

    These are of projected texels, and of walls.

    What was written in the last minute stays. A store that knows no ages, or takes no writes now,
    is left as it is.
    """
    try:
        census = census_of(store, texels=False)
        counts = {
            d: count
            for d, count in census.counts.items()
            if count.facts.attributes.get("shown") is not None
        }
        plan = plan_prune(replace(census, counts=counts), PruneRule(keep=most), store.now())
        delete_layers(store, census, plan)
    except StoreError as error:
        log.info("Projected texels are not trimmed: %s", error)
        return 0
    return len(plan.going)
