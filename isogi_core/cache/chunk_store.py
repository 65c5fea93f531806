"""The light of a bake in the store: its layers, read and written chunk by chunk."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.texel_light import VOID, Part
from isogi_core.cache.chunk_record import Chunk, Chunks
from isogi_core.cache.fresh_light import FreshLight, fresh_light, texels_of
from isogi_core.cache.inventory import STAMPS_FOLDER
from isogi_core.cache.layer import LayerStore
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.atomic_file import user_cache
from isogi_core.storage.store import Store, StoreLike

MIN_DIRECT_ORDER = 2
"""Least order of direct light that is shown in place of a higher one: band 0 alone has no
direction.
"""


def adopt(plan: ScenePlan, prepared: PreparedScene, store: StoreLike) -> ScenePlan:
    """The plan, with layers that the ``store`` lacks replaced by the smallest larger ones that it
    has.
    """
    store = Store.of(store)
    there = frozenset(store.layers())
    return replace(
        plan, layers=tuple(adopted_layer(layer, prepared, store, there) for layer in plan.layers)
    )


def adopted_layer(layer: Layer, prepared: PreparedScene, store: Store, there: Set[str]) -> Layer:
    """The layer, or the smallest larger one where the store has light of that and none of the
    layer.

    ``there`` are the digests of layers in the ``store``.
    """
    candidates = (layer, *sorted(larger_layers(layer), key=lambda other: other.bytes_per_texel))
    return next((found.layer for found in stored_layers(candidates, prepared, store, there)), layer)


def find_fallback(
    layer: Layer, prepared: PreparedScene, store: StoreLike, shown: Isovalue | None = None
) -> LayerStore | None:
    """The largest of the smaller layers that the ``store`` has light of, for the same texels; None
    without any.
    """
    store = Store.of(store)
    return next(
        stored_layers(smaller_layers(layer), prepared, store, frozenset(store.layers()), shown),
        None,
    )


def stored_layers(
    layers: Iterable[Layer],
    prepared: PreparedScene,
    store: Store,
    there: Set[str],
    shown: Isovalue | None = None,
) -> Iterator[LayerStore]:
    """The stores of those ``layers`` that have light; only digests that are ``there`` are read."""
    layer_stores = (LayerStore(store, prepared, layer, shown) for layer in layers)
    return (each for each in layer_stores if each.digest in there and each.exists)


def larger_layers(layer: Layer) -> Iterator[Layer]:
    """Compatible layers that hold all of ``layer``, and more."""
    orders = (
        range(layer.order, MAX_ORDER + 1)
        if layer.kind in ("direct", "indirect")
        else (layer.order,)
    )
    other = (other for order in orders for other in precisions(layer, order))
    return (other for other in other if other != layer and covers(other, layer))


def smaller_layers(layer: Layer) -> Iterator[Layer]:
    """Compatible layers that hold the first bands of ``layer``, or all of them less precisely; most
    bands first.
    """
    if layer.kind == "direct":
        least = MIN_DIRECT_ORDER
    else:
        least = 1
    lower = range(layer.order - 1, least - 1, -1)
    other = (other for order in (layer.order, *lower) for other in precisions(layer, order))
    return (other for other in other if not (other.order == layer.order and covers(other, layer)))


def precisions(layer: Layer, order: int) -> Iterator[Layer]:
    """The layer at another ``order``, in every precision; the most precise first."""
    yield replace(layer, order=order, half=False, coarse=None)
    for coarse in (None, *range(order - 1, 0, -1)):
        yield replace(layer, order=order, half=True, coarse=coarse)


def covers(other: Layer, layer: Layer) -> bool:
    """Whether ``other``, of no lower order, keeps each coefficient of ``layer`` at least as
    precisely.
    """
    return other.floats >= layer.floats and (layer.half or not other.half)


log = logging.getLogger("isogi.cache")

STAMP_EVERY = 3600.0
"""Seconds after which the stamp of light that is in use is renewed."""


class UseStamps:
    """Stamps of the last use of layers, by their ``digests``, in a ``store``. Safe to use from many
    threads.
    """

    def __init__(
        self, store: Store, digests: Sequence[str], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Stamp nothing yet."""
        self._store = store
        self._digests = digests
        self._clock = clock
        self._due = clock()
        self._lock = threading.Lock()

    def touch(self) -> None:
        """Stamp the layers, as their light is read, unless that was done less than STAMP_EVERY
        seconds ago.
        """
        with self._lock:
            if self._clock() < self._due:
                return
            self._due = self._clock() + STAMP_EVERY
        threading.Thread(target=self._stamp, name="stamp", daemon=True).start()

    def _stamp(self) -> None:
        try:
            for digest in self._digests:
                key = f"{STAMPS_FOLDER}/{digest}"
                self._store.put(key, b"", self._store.get(key))
        except StoreError as error:
            log.info("When light was used cannot be kept: %s", error)


Objects = tuple[bytes | None, ...]
"""The objects of one chunk, None for each that is not there."""


def default_store() -> Path:
    """The default folder of light."""
    return user_cache("light")


class ChunkStore:
    """Chunks of all layers of a ``spec`` in a ``store``. Methods raise StoreError.

    ``damaged`` counts the objects that were read and could not be used.
    """

    def __init__(self, store: StoreLike, spec: BakeSpec) -> None:
        """Touch nothing yet."""
        self.spec = spec
        self.store = Store.of(store)
        self.damaged = 0
        self.layers = tuple(
            LayerStore(self.store, spec.prepared, layer, spec.shown) for layer in spec.plan.layers
        )
        self.use = UseStamps(self.store, [layer.digest for layer in self.layers])

    def open(self) -> None:
        """Open or make the layers' arrays, and find smaller layers, now and not with the first
        chunk.
        """
        for layer in self.layers:
            layer.open()
        self.fallbacks  # noqa: B018

    @cached_property
    def fresh(self) -> FreshLight:
        """The light that this process has of the bake and has not written yet."""
        return fresh_light(self.store, self.spec.digest)

    @property
    def made(self) -> bool:
        """Whether there may be light to read: any layer's array was made, or some is in memory."""
        return len(self.fresh) > 0 or any(layer.made for layer in self.layers)

    def read(self, index: Index) -> Chunk | None:
        """Read a chunk, or take it from memory where that is newer; None where no layer has any of
        it. Damaged objects count as absent and are logged.
        """
        if (newer := self.fresh.newer(index)) is not None:
            return newer
        return self._chunk(
            index, [self._decoded(layer, index, layer.read(index)) for layer in self.layers]
        )

    @cached_property
    def fallbacks(self) -> tuple[LayerStore | None, ...]:
        """For each layer the smaller one that an earlier plan has left; None without any."""
        return tuple(
            find_fallback(layer.layer, self.spec.prepared, self.store, self.spec.shown)
            for layer in self.layers
        )

    @property
    def chunk_bytes(self) -> int:
        """Bytes of the records of a whole chunk."""
        return sum(layer.size for layer in self.layers)

    def objects(self, index: Index) -> Objects:
        """The objects of a chunk as they are stored: of each layer, and then of each fallback."""
        return tuple(
            None if layer is None else layer.read(index)
            for layer in (*self.layers, *self.fallbacks)
        )

    def show(self, indices: Sequence[Index], objects: Sequence[Objects]) -> Chunks:
        """Decode the chunks that any layer has something of, as ``read`` does, from their
        ``objects``.

        A texel that is not baked has the light of the fallback layer, with no samples.
        """
        self.use.touch()
        stored = list(zip(*objects, strict=True))
        found = [
            layer.decode_all(indices, stored_parts, self._report_damage)
            for layer, stored_parts in zip(self.layers, stored, strict=False)
        ]
        for number, other in enumerate(self.fallbacks):
            if other is not None:
                smaller = other.decode_all(
                    indices, stored[len(self.layers) + number], self._report_damage
                )
                found[number] = completed(*found[number], *smaller)
        return Chunks.of_parts(indices, self.spec.prepared.lattice.texels, found)

    def show_fresh(self, chunks: Sequence[Chunk]) -> Chunks:
        """The ``chunks`` that are newer than the store, as ``show`` gives those of the store."""
        indices = [chunk.index for chunk in chunks]
        places, light = texels_of(chunks, self.spec.prepared.lattice.texels)
        found = []
        for part, other in zip(light.parts, self.fallbacks, strict=True):
            lit = part.samples != 0
            own = places[lit], part.rows(lit)
            if other is not None:
                stored = [other.read(index) for index in indices]
                own = completed(*own, *other.decode_all(indices, stored, self._report_damage))
            found.append(own)
        return Chunks.of_parts(indices, self.spec.prepared.lattice.texels, found)

    def load(self, index: Index) -> Chunk:
        """Read a chunk; it is empty where it is absent or damaged, and is baked again then."""
        return self.read(index) or Chunk.empty(index, self.spec.plan)

    def save(self, chunk: Chunk, changed: Sequence[bool] | None = None) -> bool:
        """Write the parts of a chunk, or those that ``changed``: one object each, atomically; see
        LayerStore.save.

        Returns whether another writer was found at the same chunk.
        """
        met = False
        for number, (layer, part) in enumerate(zip(self.layers, chunk.light.parts, strict=True)):
            if changed is None or changed[number]:
                met |= layer.save(chunk.index, chunk.offsets, part)
        return met

    def _chunk(self, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> Chunk | None:
        if not any(len(offsets) for offsets, _ in found):
            return None
        return Chunk.of_parts(index, found)

    def _decoded(
        self, layer: LayerStore, index: Index, stored: bytes | None
    ) -> tuple[np.ndarray, Part]:
        try:
            if stored is not None:
                return layer.decode(index, stored)
        except DamagedChunkError as error:
            self._report_damage(error)
        return np.empty(0, np.int32), Part.dark(layer.layer, 0)

    def _report_damage(self, error: DamagedChunkError) -> None:
        self.damaged += 1
        if self.store.is_news(
            str(error)
        ):  # a damaged chunk is read again and again until it is baked
            log.warning("%s", error)


def completed(
    offsets: np.ndarray, part: Part, others: np.ndarray, other: Part
) -> tuple[np.ndarray, Part]:
    """A ``part`` of texels at ``offsets``, and the light of ``other`` for further texels: void, or
    no samples.
    """
    lacking = ~np.isin(others, offsets)
    union = np.union1d(offsets, others[lacking]).astype(np.int32)
    whole = part.among(offsets, union)
    rows = np.searchsorted(union, others[lacking])
    whole.coefficients[rows, :, : other.layer.order**2] = other.coefficients[lacking]
    whole.samples[rows] = np.where(other.samples[lacking] == VOID, VOID, 0)
    return union, whole
