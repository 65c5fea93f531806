"""The upkeep of a store: a census that counts its light,
an audit that finds damage, repair, and pruning.
"""

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
"""Age in seconds from which a half-written object is taken for a leftover."""

Checked = TypeVar("Checked")


class Damage(NamedTuple):
    """An object that cannot be used, by its ``key``, and the reason."""

    key: str
    why: str


class SharedChunk(NamedTuple):
    """A chunk, and its objects in all layers of the same lattice.

    They must agree on the texels that can hold light.
    """

    chunk: Index
    objects: tuple[tuple[str, Entry], ...]


@dataclass(eq=False)
class Audit:
    """The result of an audit.

    ``whole`` counts the objects of chunks, one for each layer, that are sound or were deleted
    meanwhile; ``unread`` those that were not checked, as their layer's metadata is damaged.
    """

    inventory: Inventory
    facts: dict[str, LayerFacts] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)
    unread: int = 0
    whole: int = 0

    @property
    def sound(self) -> bool:
        """True if nothing is damaged."""
        return not self.damages


def audit_store(
    store: Store, report: Callable[[Damage], Any] = lambda _: None, progress: Progress = no_progress
) -> Audit:
    """Check all objects of layers in a ``store``. It only reads, so servers and workers may go on.
    Raises StoreError.

    ``report`` is called with each damaged object of a chunk as soon as it is known, but not for
    damaged metadata; ``progress`` with the numbers of checked objects of chunks and of all.
    """
    result = Audit(inventory_of(store.entries()))
    _audit_facts(store, result)
    chunks = shared_chunks(result)
    done = 0
    total = sum(len(each.objects) for each in chunks)
    progress(done, total)
    # Check chunks on several threads, and report in order.
    with ThreadPoolExecutor(AUDIT_READERS) as pool:
        checked = pool.map(lambda each: check_chunk(store, each, result.facts), chunks)
        for each, damages in zip(chunks, checked, strict=True):
            done += len(each.objects)
            result.damages += damages
            for damage in damages:
                report(damage)
            progress(done, total)
    # Zarr names the objects of chunks digest/c/…, and metadata digest/zarr.json. An object has one
    # damage at most.
    result.whole = total - sum(damage.key.split("/")[1] == "c" for damage in result.damages)
    return result


def check_chunk(store: Store, shared: SharedChunk, facts: Mapping[str, LayerFacts]) -> list[Damage]:
    """Check the objects of a chunk, each by itself and then against each other; return at most one
    damage for each object.
    """
    damages = []
    samples = {}
    for digest, found in shared.objects:
        try:
            samples[found.key] = check_twice(
                partial(_sound_samples, store, facts[digest], digest, shared.chunk, found.key)
            )
        except DamagedChunkError as error:
            damages.append(Damage(found.key, str(error)))
    # An object may contradict several others: name it once.
    return list({damage.key: damage for damage in (*damages, *contradictions(samples))}.values())


def check_twice(check: Callable[[], Checked]) -> Checked:
    """Return the result of a ``check``, which runs again if it finds damage.

    The damage may be of one answer of the store and not of the object. Raises DamagedChunkError if
    the check finds damage again.
    """
    try:
        return check()
    except DamagedChunkError:
        return check()


def _audit_facts(store: Store, result: Audit) -> None:
    """Read the metadata of all layers, and count the chunks of those whose metadata is damaged."""
    for digest, files in result.inventory.layers.items():
        try:
            result.facts[digest] = check_twice(partial(read_facts, store, digest))
        except DamagedChunkError as error:
            result.damages.append(Damage(f"{digest}/zarr.json", str(error)))
            result.unread += len(files.chunks)


def read_facts(store: Store, digest: str) -> LayerFacts:
    """Return the facts of a layer.

    Raises DamagedChunkError if its metadata is missing or damaged.
    """
    stored = store.read(f"{digest}/zarr.json")
    if stored is None:
        raise DamagedChunkError("it is missing")
    return facts_in(stored)


def _sound_samples(
    store: Store, facts: LayerFacts, digest: str, index: Index, key: str
) -> np.ndarray:
    """Check the object ``key`` of the chunk ``index`` in a layer. Return the sample counts of the
    chunk's texels, (texels,) int32: 0 if a texel has no light, VOID if it cannot hold any.

    ``digest`` is the layer's. If the object was deleted after it was listed, all counts are 0.
    Raises DamagedChunkError.
    """
    if not facts.holds(index):
        raise DamagedChunkError("there is no such place in its lattice")
    samples = np.zeros(facts.chunk_texels, np.int32)
    # A deleted object is not damaged, and zeros contradict no other layer.
    stored = store.read(key)
    if stored is None:
        return samples
    # Check, in this order, that it unpacks, that it belongs here, and that its numbers make sense.
    record = unwrap(stored, facts.record_size)
    found = unpack(record, facts.layer, facts.chunk_texels, digest, index)
    if found is None:
        raise DamagedChunkError("it was baked for another place")
    if fault := find_anomaly(record, facts.layer, facts.chunk_texels):
        raise DamagedChunkError(fault)
    samples[found[0]] = found[1].samples
    return samples


def shared_chunks(audit: Audit) -> list[SharedChunk]:
    """Return all chunks of readable layers. Objects that must agree are in one SharedChunk."""
    shared: dict[tuple[Any, ...], list[tuple[str, Entry]]] = defaultdict(list)
    for digest, facts in audit.facts.items():
        for index, found in audit.inventory.layers[digest].chunks.items():
            shared[index, repr(facts.lattice_facts)].append((digest, found))
    return [SharedChunk(index, tuple(objects)) for (index, _), objects in shared.items()]


def contradictions(samples: dict[str, np.ndarray]) -> Iterator[Damage]:
    """Yield a damage for both objects of each pair of which one calls
    a texel void and the other lights it: either may be wrong.
    """
    for one, other in combinations(samples, 2):
        both = samples[one], samples[other]
        # Compare in both directions: void here and lit there.
        if any(((a == VOID) & (b > 0)).any() for a, b in (both, both[::-1])):
            yield Damage(one, f"it does not agree with {other} on which texels can hold light")
            yield Damage(other, f"it does not agree with {one} on which texels can hold light")


def leftovers(inventory: Inventory, now: float) -> Sequence[Entry]:
    """Return the half-written objects older than LEFT_AFTER seconds: their writers are gone."""
    return [found for found in inventory.leftovers if found.age(now) > LEFT_AFTER]


@dataclass(eq=False)
class Repair:
    """The result of a repair.

    ``moved`` gives the new key of each damaged object, None if it was deleted.
    """

    audit: Audit
    moved: dict[str, str | None] = field(default_factory=dict)
    removed: list[Entry] = field(default_factory=list)


def repair_store(store: Store, delete: bool = False, progress: Progress = no_progress) -> Repair:
    """Audit a ``store``, move damaged objects to its quarantine folder, and delete leftovers:
    half-written objects of processes that are gone. Raises StoreError.

    If ``delete`` is set, damaged objects are deleted, too.
    """
    moved: dict[str, str | None] = {}

    # The audit calls this as soon as it finds a damaged chunk: servers then bake the chunk again,
    # and need not wait for the end of the audit.
    def put_away(damage: Damage) -> None:
        """Move or delete a damaged object, once."""
        if damage.key in moved:
            return
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
    # The audit does so for chunks alone: put damaged metadata away now.
    for damage in found.damages:
        put_away(damage)
    # Delete half-written objects that are so old that their writers must be gone.
    old = list(leftovers(found.inventory, store.now()))
    for each in old:
        store.delete(each.key)
    return Repair(found, moved, old)


MOST_LAYERS = 3
"""Most layers of a bake: direct light, indirect light, and glow."""


@dataclass(eq=False)
class Count:
    """One layer: its ``files`` and ``facts``, and the number of texels by their number of
    ``samples``, VOID among them.

    ``damaged`` counts the chunks that cannot be read.
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
        """Number of texels that cannot hold light."""
        return self.samples[VOID]

    @property
    def paths(self) -> int:
        """Number of paths in the light."""
        return sum(max(samples, 0) * texels for samples, texels in self.samples.items())


@dataclass(eq=False)
class Census:
    """The readable layers of a store by their digests,
    and the costs of bakes by the digests of the bakes' layers.
    """

    inventory: Inventory
    counts: dict[str, Count]
    costs: dict[tuple[str, ...], Cost]


def census_of(store: Store, texels: bool = True, progress: Progress = no_progress) -> Census:
    """Count the layers of a ``store``, and with ``texels`` read all chunks and count their texels.

    Raises StoreError.
    """
    inventory = inventory_of(store.entries())
    counts = dict(each_layer(store, inventory))
    if texels:
        count_texels(store, list(counts.values()), progress)
    return Census(inventory, counts, costs_of(store, inventory, counts))


def each_layer(store: Store, inventory: Inventory) -> list[tuple[str, Count]]:
    """Return the digests and empty counts of the layers with readable metadata."""
    found = []
    for digest, files in inventory.layers.items():
        with suppress(DamagedChunkError):
            found.append((digest, Count(files, check_twice(partial(read_facts, store, digest)))))
    return found


def count_texels(store: Store, counts: Sequence[Count], progress: Progress) -> None:
    """Read all chunks of the layers, and add the samples of their texels to ``counts``."""
    chunks = [(count, index) for count in counts for index in count.files.chunks]
    # Read chunks on several threads, and count them here, in order.
    with ThreadPoolExecutor(AUDIT_READERS) as pool:
        found = pool.map(lambda chunk: samples_in(store, *chunk), chunks)
        for number, ((count, _), samples) in enumerate(zip(chunks, found, strict=True), 1):
            if samples is None:
                count.damaged += 1
            else:
                values, texels = np.unique(samples, return_counts=True)
                count.samples.update(dict(zip(map(int, values), map(int, texels), strict=True)))
            progress(number, len(chunks))


def samples_in(store: Store, count: Count, index: tuple[int, int, int]) -> np.ndarray | None:
    """Return the sample counts of a chunk's texels; None if it is damaged."""
    found = texels_in(store, count, index)
    if found is None:
        return None
    return found[1].samples


def texels_in(
    store: Store, count: Count, index: tuple[int, int, int]
) -> tuple[np.ndarray, Part] | None:
    """Return the offsets of a chunk's texels and their part of a layer:
    no texels if the object is gone, None if it is damaged or of another place.
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
    """Return the costs of bakes by the digests of their layers.

    The digest of a bake is that of its layers' digests in order. It cannot be inverted, so all
    combinations of layers are tried.
    """
    found = {}
    for layers in possible_bakes(counts):
        file = inventory.costs.get(digest_of(list(layers)))
        if file is not None:
            found[layers] = cost_in(store.read(file.key) or b"")
    return found


def possible_bakes(counts: dict[str, Count]) -> Iterator[tuple[str, ...]]:
    """Yield the digests of all layers that may form a bake together: up to MOST_LAYERS of the same
    lattice, in every order, as the order is not known.
    """
    by_lattice = defaultdict(list)
    for digest, count in counts.items():
        by_lattice[repr(count.facts.lattice_facts)].append(digest)
    for digests in by_lattice.values():
        for size in range(1, MOST_LAYERS + 1):
            yield from permutations(digests, size)


def cost_in(stored: bytes) -> Cost:
    """Return the sum of the costs in an object; zero if it is damaged."""
    try:
        return reduce(Cost.plus, costs_in(stored).values(), Cost())
    except (ValueError, KeyError, TypeError, AttributeError):
        return Cost()


BUSY_SECONDS = 60.0
"""Seconds after its last write for which a layer counts as being written to."""


@dataclass(frozen=True)
class PruneRule:
    """A rule for choosing layers to delete.

    Layers go if they were not used for ``older_than`` seconds, and the longest unused go until at
    most ``keep`` bytes are left. With ``empty``, layers without light go, too. With ``scene``, only
    layers of the scene or volume of that name go, and all of them if no other condition is given.
    """

    older_than: float = math.inf
    keep: float = math.inf
    scene: str | None = None
    empty: bool = False


@dataclass(frozen=True, eq=False)
class PrunePlan:
    """The layers to delete, ``going``, the longest unused first,
    and ``busy`` ones, which are being written to and stay.
    """

    going: tuple[Count, ...]
    busy: tuple[Count, ...]

    @property
    def size(self) -> int:
        """Bytes that are freed."""
        return sum(count.files.size for count in self.going)


def plan_prune(census: Census, rule: PruneRule, now: float) -> PrunePlan:
    """Choose the layers to delete by a ``rule``, at the time ``now``.

    Raises StoreError if the store does not know ages.
    """
    counts = sorted(census.counts.values(), key=lambda count: count.files.used)
    if any(math.isnan(count.files.used) for count in counts):
        raise StoreError(
            "This store does not know when its objects were written, so none can be chosen by age: "
            "delete the folders of single layers, which `isogi store stats` lists."
        )
    wanted = choose_layers([count for count in counts if is_of_scene(count, rule.scene)], rule, now)
    # A bake that is going on would write its light again: leave its layers.
    busy = [count for count in wanted if now - last_write(count.files) <= BUSY_SECONDS]
    return PrunePlan(tuple(count for count in wanted if count not in busy), tuple(busy))


def choose_layers(counts: Sequence[Count], rule: PruneRule, now: float) -> list[Count]:
    """Return the layers that a rule deletes, the longest unused first."""
    total = sum(count.files.size for count in counts)
    going = []
    # A rule that names a scene and nothing else means all light of the scene.
    everything = rule.scene is not None and rule == PruneRule(scene=rule.scene)
    # ``counts`` are sorted by last use, and ``total`` is the size that is left so far.
    for count in counts:
        old = now - count.files.used > rule.older_than
        empty = rule.empty and not count.files.chunks
        if everything or old or empty or total > rule.keep:
            going.append(count)
            total -= count.files.size
    return going


def is_of_scene(count: Count, name: str | None) -> bool:
    """Return True if a layer is of the scene or volume ``name``; None stands for any."""
    return name is None or name in (
        count.facts.attributes.get("scene"),
        count.facts.attributes.get("volume"),
    )


def last_write(files: LayerFiles) -> float:
    """Return the time of the last write to a layer. Stamps of use are no writes of light."""
    return max(
        (found.written for found in files.objects if found is not files.stamp), default=-math.inf
    )


def delete_layers(store: Store, census: Census, plan: PrunePlan) -> list[Entry]:
    """Delete the layers of a plan, and the costs of their bakes; return the deleted objects.

    Raises StoreError.
    """
    gone = [found for count in plan.going for found in count.files.objects] + stale_costs(
        census, plan
    )
    for found in gone:
        store.delete(found.key)
    return gone


def stale_costs(census: Census, plan: PrunePlan) -> list[Entry]:
    """Return the cost objects of bakes that lose a layer."""
    going = {count.files.digest for count in plan.going}
    names = [digest_of(list(layers)) for layers in census.costs if going.intersection(layers)]
    return [census.inventory.costs[name] for name in names]


log = logging.getLogger("isogi.cache")


def trim_projected(store: Store, most: int) -> int:
    """Delete layers for single isovalues, the longest unused first, until at most ``most`` bytes of
    them are left.

    Such layers are of projected texels and of walls. Layers that were written to in the last minute
    stay. If the store knows no ages or takes no writes now, nothing is deleted. Return the number
    of layers deleted.
    """
    try:
        census = census_of(store, texels=False)
        # Layers with an isovalue of their own are of projected texels or of walls.
        counts = {
            digest: count
            for digest, count in census.counts.items()
            if count.facts.attributes.get("shown") is not None
        }
        plan = plan_prune(replace(census, counts=counts), PruneRule(keep=most), store.now())
        delete_layers(store, census, plan)
    except StoreError as error:
        log.info("Projected texels are not trimmed: %s", error)
        return 0
    return len(plan.going)
