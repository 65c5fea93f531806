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
"""Lowest order of direct light that is shown in place of a higher one:
band 0 alone does not depend on the normal.
"""


def adopt(plan: ScenePlan, prepared: PreparedScene, store: StoreLike) -> ScenePlan:
    """Return the ``plan`` for a store that may hold other layers.

    Each layer without light in the ``store`` is replaced by the smallest larger layer with light
    there, if there is one.
    """
    store = Store.of(store)
    there = frozenset(store.layers())
    return replace(
        plan, layers=tuple(adopted_layer(layer, prepared, store, there) for layer in plan.layers)
    )


def adopted_layer(layer: Layer, prepared: PreparedScene, store: Store, there: Set[str]) -> Layer:
    """Return the ``layer`` if the ``store`` has light of it, else the smallest larger layer with
    light there, else the layer.

    ``there`` are the digests of the layers in the ``store``.
    """
    candidates = (layer, *sorted(larger_layers(layer), key=lambda other: other.bytes_per_texel))
    return next((found.layer for found in stored_layers(candidates, prepared, store, there)), layer)


def find_fallback(
    layer: Layer, prepared: PreparedScene, store: StoreLike, shown: Isovalue | None = None
) -> LayerStore | None:
    """Return the store of the largest smaller layer that has light of the same texels; None if
    there is none.

    Its light is shown until the ``layer`` itself is baked.
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
    """Yield the stores of those ``layers`` that have light.

    Layers whose digests are not ``there`` are skipped without a request.
    """
    layer_stores = (LayerStore(store, prepared, layer, shown) for layer in layers)
    return (each for each in layer_stores if each.digest in there and each.exists)


def larger_layers(layer: Layer) -> Iterator[Layer]:
    """Yield the layers of the same kind of light that keep every coefficient
    of ``layer`` at least as precisely, and more.
    """
    # Transfer of a higher order holds that of lower ones in its first bands. Other kinds have one
    # order only.
    if layer.kind in ("direct", "indirect"):
        orders = range(layer.order, MAX_ORDER + 1)
    else:
        orders = range(layer.order, layer.order + 1)
    others = (other for order in orders for other in precisions(layer, order))
    return (other for other in others if other != layer and covers(other, layer))


def smaller_layers(layer: Layer) -> Iterator[Layer]:
    """Yield the layers of the same kind of light that keep only lower bands of ``layer``,
    or keep its bands less precisely; most bands first.
    """
    # Direct light of one band would not show how a surface faces the light.
    if layer.kind == "direct":
        least = MIN_DIRECT_ORDER
    else:
        least = 1
    lower = range(layer.order - 1, least - 1, -1)
    others = (other for order in (layer.order, *lower) for other in precisions(layer, order))
    return (other for other in others if not (other.order == layer.order and covers(other, layer)))


def precisions(layer: Layer, order: int) -> Iterator[Layer]:
    """Yield the layer at another ``order`` in every precision, the most precise first."""
    yield replace(layer, order=order, half=False, coarse=None)
    for coarse in (None, *range(order - 1, 0, -1)):
        yield replace(layer, order=order, half=True, coarse=coarse)


def covers(other: Layer, layer: Layer) -> bool:
    """Return True if ``other``, whose order is not lower,
    keeps each coefficient of ``layer`` at least as precisely.
    """
    return other.floats >= layer.floats and (layer.half or not other.half)


log = logging.getLogger("isogi.cache")

STAMP_EVERY = 3600.0
"""Seconds after which the stamp of light in use is renewed:
fine enough for pruning by days, and one write an hour.
"""


class UseStamps:
    """Records when layers were last read, by writing an empty object a layer, its stamp, to the
    ``store``.

    The layers are given by their ``digests``. Safe to use from many threads.
    """

    def __init__(
        self, store: Store, digests: Sequence[str], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Write no stamp yet."""
        self._store = store
        self._digests = digests
        self._clock = clock
        self._due = clock()
        self._lock = threading.Lock()

    def touch(self) -> None:
        """Stamp the layers, as their light is read, unless that was done less than STAMP_EVERY
        seconds ago.

        The stamps are written by a thread, so that no frame waits for them.
        """
        # Set the next time first, so that only one thread stamps.
        with self._lock:
            if self._clock() < self._due:
                return
            self._due = self._clock() + STAMP_EVERY
        threading.Thread(target=self._stamp, name="stamp", daemon=True).start()

    def _stamp(self) -> None:
        """Write the stamps. Failure is logged: stamps only serve to choose layers to delete."""
        try:
            for digest in self._digests:
                key = f"{STAMPS_FOLDER}/{digest}"
                self._store.put(key, b"", self._store.get(key))
        except StoreError as error:
            log.info("The time of the last use of light cannot be stored: %s", error)


Objects = tuple[bytes | None, ...]
"""The objects of one chunk, None for each that is not there."""


def default_store() -> Path:
    """Return the folder that light is kept in by default."""
    return user_cache("light")


class ChunkStore:
    """The chunks of a bake, given by its ``spec``, with all their layers in a ``store``. Methods
    raise StoreError.

    ``damaged`` counts the objects that were read and could not be used.
    """

    def __init__(self, store: StoreLike, spec: BakeSpec) -> None:
        """Set up the layers' stores, without a request to the ``store``."""
        self.spec = spec
        self.store = Store.of(store)
        self.damaged = 0
        self.layers = tuple(
            LayerStore(self.store, spec.prepared, layer, spec.shown) for layer in spec.plan.layers
        )
        self.use = UseStamps(self.store, [layer.digest for layer in self.layers])

    def open(self) -> None:
        """Open or create the layers' arrays, and find the fallback layers.

        Without this call, an array is opened when a chunk is first read and created when one is
        first written; fallback layers are found when a frame first reads chunks.
        """
        for layer in self.layers:
            layer.open()
        self.fallbacks  # noqa: B018

    @cached_property
    def fresh(self) -> FreshLight:
        """The light of the bake that this process holds and has not written yet."""
        return fresh_light(self.store, self.spec.digest)

    @property
    def made(self) -> bool:
        """True if there may be light to read: in an array of a layer, or in memory."""
        return len(self.fresh) > 0 or any(layer.made for layer in self.layers)

    def read(self, index: Index) -> Chunk | None:
        """Read a chunk, or take it from memory if that has newer light; None if no layer has light
        of it.

        A chunk in memory is complete: it has all light that the store has of it, and newer light.
        Damaged objects are logged and count as absent.
        """
        if (newer := self.fresh.newer(index)) is not None:
            return newer
        return self._chunk(
            index, [self._decoded(layer, index, layer.read(index)) for layer in self.layers]
        )

    @cached_property
    def fallbacks(self) -> tuple[LayerStore | None, ...]:
        """For each layer the smaller one that an earlier plan has left, or None."""
        return tuple(
            find_fallback(layer.layer, self.spec.prepared, self.store, self.spec.shown)
            for layer in self.layers
        )

    @property
    def chunk_bytes(self) -> int:
        """Bytes of the records of a whole chunk."""
        return sum(layer.size for layer in self.layers)

    def objects(self, index: Index) -> Objects:
        """Read the objects of a chunk without decoding them:
        one of each layer, then one of each fallback.
        """
        return tuple(
            None if layer is None else layer.read(index)
            for layer in (*self.layers, *self.fallbacks)
        )

    def show(self, indices: Sequence[Index], objects: Sequence[Objects]) -> Chunks:
        """Decode chunks for a frame from their ``objects``, as read by ``objects``; chunks without
        light are left out.

        A texel that is not baked shows the light of the fallback layer, with 0 samples.
        """
        self.use.touch()
        # Turn the objects from one row a chunk into one row a layer, as each layer is decoded in
        # one call.
        stored = list(zip(*objects, strict=True))
        found = [
            layer.decode_all(indices, stored_parts, self._report_damage)
            for layer, stored_parts in zip(self.layers, stored, strict=False)
        ]
        # Fill in texels that only the smaller layer of an earlier plan has.
        for number, other in enumerate(self.fallbacks):
            if other is not None:
                smaller = other.decode_all(
                    indices, stored[len(self.layers) + number], self._report_damage
                )
                found[number] = add_fallback_light(*found[number], *smaller)
        return Chunks.of_parts(indices, self.spec.prepared.lattice.texels, found)

    def show_fresh(self, chunks: Sequence[Chunk]) -> Chunks:
        """Return ``chunks`` of unwritten light, as ``show`` returns those of the store."""
        indices = [chunk.index for chunk in chunks]
        places, light = texels_of(chunks, self.spec.prepared.lattice.texels)
        found = []
        # Unwritten light has rows for texels that are not baked yet: leave these to the fallback
        # layer.
        for part, other in zip(light.parts, self.fallbacks, strict=True):
            lit = part.samples != 0
            shown = places[lit], part.rows(lit)
            if other is not None:
                stored = [other.read(index) for index in indices]
                smaller = other.decode_all(indices, stored, self._report_damage)
                shown = add_fallback_light(*shown, *smaller)
            found.append(shown)
        return Chunks.of_parts(indices, self.spec.prepared.lattice.texels, found)

    def load(self, index: Index) -> Chunk:
        """Read a chunk; return an empty one if it is absent or damaged, so that it is baked."""
        return self.read(index) or Chunk.empty(index, self.spec.plan)

    def save(self, chunk: Chunk, changed: Sequence[bool] | None = None) -> bool:
        """Write the parts of a ``chunk``, or only those marked in ``changed``: one object a layer,
        each atomically.

        Return True if another writer has changed the same chunk (see ``LayerStore.save``).
        """
        contended = False
        for number, (layer, part) in enumerate(zip(self.layers, chunk.light.parts, strict=True)):
            # A layer without new light is not written again.
            if changed is None or changed[number]:
                contended |= layer.save(chunk.index, chunk.offsets, part)
        return contended

    def _chunk(self, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> Chunk | None:
        """Return the chunk of the parts that were found; None if none of them has texels."""
        if not any(len(offsets) for offsets, _ in found):
            return None
        return Chunk.of_parts(index, found)

    def _decoded(
        self, layer: LayerStore, index: Index, stored: bytes | None
    ) -> tuple[np.ndarray, Part]:
        """Return the offsets and the light of the texels in an object of a layer, as it is
        ``stored``; no texels if it is absent (None) or damaged, so that they are baked again.
        """
        try:
            if stored is not None:
                return layer.decode(index, stored)
        except DamagedChunkError as error:
            self._report_damage(error)
        return np.empty(0, np.int32), Part.dark(layer.layer, 0)

    def _report_damage(self, error: DamagedChunkError) -> None:
        """Count and log damage of an object."""
        self.damaged += 1
        # A damaged chunk is read again and again until it is baked.
        if self.store.is_new_message(str(error)):
            log.warning("%s", error)


def add_fallback_light(
    offsets: np.ndarray, part: Part, others: np.ndarray, other: Part
) -> tuple[np.ndarray, Part]:
    """Add to a ``part`` of texels at ``offsets`` the light of ``other`` at the places ``others``
    that it lacks.

    Added texels have 0 samples, so that they count as not baked, or VOID. Bands above those of
    ``other`` are 0. Return the ascending union of places, and the part.
    """
    lacking = ~np.isin(others, offsets)
    union = np.union1d(offsets, others[lacking]).astype(np.int32)
    whole = part.among(offsets, union)
    rows = np.searchsorted(union, others[lacking])
    # The fallback has fewer bands; those above stay 0.
    whole.coefficients[rows, :, : other.layer.order**2] = other.coefficients[lacking]
    whole.samples[rows] = np.where(other.samples[lacking] == VOID, VOID, 0)
    return union, whole
