"""Layers of light in a folder or an object store: one Zarr v3 array a layer, one object a chunk.

An object is written whole or not at all and describes itself, so readers and writers need no locks.
A chunk exists if the store has an object of its key; zeros never stand for an absent one. The
checksum, which is the last codec, reveals damage.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from itertools import compress
from typing import Any, TypeVar

import numpy as np
import zarr
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

from isogi_core.bake.texel_light import (
    CODES_PER_HALVING,
    FIRST_LEVEL,
    NEGATIVE,
    NOISIEST,
    SILENT,
    VOID,
    VOID_CODE,
    Part,
)
from isogi_core.cache.chunk_record import belongs, pack, record_type, unpack_all
from isogi_core.errors import (
    ChangedError,
    DamagedChunkError,
    StoreAwayError,
    StoreError,
    StoreFullError,
    StoreReadOnlyError,
)
from isogi_core.model.scene_plan import Layer
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import BAKE_FORMAT
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.backend import StoredObject, one_line
from isogi_core.storage.store import (
    ZSTD_LEVEL,
    Store,
    StoreLike,
    described_array,
    description,
    unwrap_all,
    wrap,
)

CHUNK_CODECS = (BytesCodec, ZstdCodec, Crc32cCodec)
"""Codecs of a chunk; the checksum is last, so that it covers the whole object."""

MOST_TRIES = 20
"""Most tries of a write while others write the same chunk."""

RECORD_CODES = {
    "first_rung": FIRST_LEVEL,
    "void": VOID_CODE,
    "noisiest": NOISIEST,
    "steps": CODES_PER_HALVING,
    "silent": SILENT,
    "negative": NEGATIVE,
}
"""Constants that a reader without isogi needs to decode the bytes of a record."""

MOVE_AWAY = (
    "let `isogi store repair` repair it, or move that folder away, and the light is baked again."
)

Seen = TypeVar("Seen")


def again_if_damaged(look: Callable[[], Seen]) -> Seen:
    """Return what ``look`` finds in a store; look once more if that cannot be used.

    An answer of a store may be damaged on its way. Raises what the second look raises, and
    StoreAwayError at once.
    """
    try:
        return look()
    except StoreAwayError:
        raise
    except StoreError:
        return look()


class LayerStore:
    """The chunks of one layer in a ``store``. Methods raise StoreError.

    With ``shown``, texels are projected onto the isosurface of that isovalue; see ``BakeSpec``.
    """

    def __init__(
        self,
        store: StoreLike,
        prepared: PreparedScene,
        layer: Layer,
        shown: Isovalue | None = None,
        digest: str = "",
        texels: int = 0,
    ) -> None:
        """Set up without a request to the store.

        ``digest`` and ``texels``, the texels of a chunk, follow from the scene unless they are
        given.
        """
        self.store = Store.of(store)
        self.prepared = prepared
        self.layer = layer
        self.shown = shown
        self.digest = digest or prepared.scene.layer_digest(layer, shown)
        self.texels = texels or prepared.lattice.texels
        self.size = record_type(layer, self.texels).itemsize

    @cached_property
    def array(self) -> "zarr.Array[Any]":
        """The Zarr array, created on first use: (chunks z, y, x, bytes of a record) uint8."""
        return self._open() or self._create()

    @property
    def chunks(self) -> Index:
        """Chunks along z, y, x."""
        return self.prepared.chunks

    @property
    def facts(self) -> dict[str, Any]:
        """The attributes of the array: see ``layer_attributes``."""
        return layer_attributes(self.layer, self.prepared, self.shown)

    @property
    def path(self) -> str:
        """The folder or URL of the layer, for messages."""
        return f"{self.store.url.name}/{self.digest}"

    @property
    def exists(self) -> bool:
        """True if the store has light of the layer: an array of its own, and at least one chunk."""
        array = again_if_damaged(self._find)
        return (
            array is not None
            and self._is_ours(array)
            and bool(self.store.folders(f"{self.digest}/c"))
        )

    @property
    def made(self) -> bool:
        """True if the array exists. The store is asked until it does."""
        self._recognise()
        return "array" in self.__dict__

    def open(self) -> None:
        """Open the array, or create it. A full or read-only store is used without it."""
        with suppress(StoreReadOnlyError, StoreFullError):
            self.array  # noqa: B018

    def _find(self) -> "zarr.Array[Any] | None":
        """Open the Zarr array in the store by its metadata; None if there is none."""
        found = self.store.get(self._metadata_key)
        try:
            if found is None:
                return None
            return described_array(found.data)
        except Exception as error:
            raise StoreError(
                f"Cannot open the light at {self.path}: {one_line(error)}; {MOVE_AWAY}"
            ) from error

    def _open(self) -> "zarr.Array[Any] | None":
        """Return the array, None if there is none; raise StoreError if it is not this layer's."""
        return again_if_damaged(self._find_own)

    def _find_own(self) -> "zarr.Array[Any] | None":
        """Return the array that the store has now, None if there is none; raise StoreError if it is
        not this layer's.
        """
        array = self._find()
        if array is None or self._is_ours(array):
            return array
        raise StoreError(f"The data at {self.path} are not the light of this scene; {MOVE_AWAY}")

    def _is_ours(self, array: "zarr.Array[Any]") -> bool:
        """Return True if an array in the store is the one that this layer needs:
        its shape, codecs and volume agree.
        """
        # The array is read before each new chunk, but checked only once.
        if array is self.__dict__.get("array"):
            return True
        facts = array.attrs.asdict().get("isogi")
        return (
            array.shape == (*self.chunks, self.size)
            and array.chunks == (1, 1, 1, self.size)
            and array.dtype == np.uint8
            and tuple(map(type, getattr(array.metadata, "codecs", ()))) == CHUNK_CODECS
            and isinstance(facts, dict)
            and facts.get("volume_digest") == self.prepared.scene.volume.digest
        )

    def _create(self) -> "zarr.Array[Any]":
        """Create the array in the store, and return it."""
        # Another process may have created it in between: then use that one.
        with suppress(ChangedError):
            self.store.put(self._metadata_key, self._description(), None)
        array = self._open()
        if array is None:
            raise StoreError(f"Light at {self.path} cannot be created: another process deletes it.")
        return array

    def _description(self) -> bytes:
        """Return the array's metadata, as Zarr writes it."""
        return description(
            shape=(*self.chunks, self.size),
            chunks=(1, 1, 1, self.size),
            dtype="uint8",
            fill_value=0,
            compressors=[ZstdCodec(level=ZSTD_LEVEL), Crc32cCodec()],
            attributes={"isogi": self.facts},
        )

    @property
    def _metadata_key(self) -> str:
        """Key of the object that describes the array."""
        return f"{self.digest}/zarr.json"

    def _key(self, index: Index) -> str:
        """Return the key of a chunk's object, as Zarr names it."""
        return "/".join((self.digest, "c", *map(str, index), "0"))

    def read(self, index: Index) -> bytes | None:
        """Read the object of a chunk; None if there is none."""
        self._recognise()
        return self.store.view(self._key(index))

    def _recognise(self) -> None:
        """Check once that an array in the store is this layer's."""
        if "array" not in self.__dict__ and (array := self._open()) is not None:
            self.array = array

    def decode(self, index: Index, stored: bytes) -> tuple[np.ndarray, Part]:
        """Decode the object of a chunk to offsets and part.

        Raises DamagedChunkError if it is damaged or of another chunk.
        """
        return unpack_all(self._records([(index, stored)]), self.layer, self.texels)

    def decode_all(
        self,
        indices: Sequence[Index],
        stored: Sequence[bytes | None],
        report: Callable[[DamagedChunkError], None],
    ) -> tuple[np.ndarray, Part]:
        """Decode the objects of many chunks in one call, to places (see ``Chunks.of_parts``) and
        their part.

        A chunk without an object has no texels. A damaged one has none either, and ``report`` is
        called with its error.
        """
        there = [i for i, data in enumerate(stored) if data is not None]
        objects = [(indices[i], stored[i] or b"") for i in there]
        try:
            records = self._records(objects)
        except DamagedChunkError:
            # Objects are checked together, as that is faster. Now that one is damaged, check each
            # by itself, and leave the damaged ones out.
            sound = [self._is_sound(each, report) for each in objects]
            there = list(compress(there, sound))
            objects = list(compress(objects, sound))
            records = self._records(objects)
        places, part = unpack_all(records, self.layer, self.texels)
        if len(there) < len(stored):
            places = to_chunk_places(places, there, self.texels)
        return places, part

    def _records(self, objects: Sequence[tuple[Index, bytes]]) -> np.ndarray:
        """Return the records in objects, (objects, bytes) uint8.

        Raises DamagedChunkError if any is damaged; the message names the first chunk of the list.
        """
        try:
            records = unwrap_all([data for _, data in objects], self.size)
        except DamagedChunkError as error:
            raise self._damaged(objects[0][0], str(error)) from error
        indices = [index for index, _ in objects]
        if not belongs(records, self.layer, self.texels, self.digest, indices).all():
            raise self._damaged(objects[0][0], "it was baked for another place")
        return records

    def _is_sound(
        self, found: tuple[Index, bytes], report: Callable[[DamagedChunkError], None]
    ) -> bool:
        """Return True if an object can be used; call ``report`` with its error if not."""
        try:
            self._records([found])
        except DamagedChunkError as error:
            report(error)
            return False
        return True

    def _damaged(self, index: Index, why: str) -> DamagedChunkError:
        """Return the error for a damaged chunk; ``why`` completes the sentence."""
        return DamagedChunkError(
            f"Chunk {index} of the light at {self.path} is damaged: {why}; it is baked again."
        )

    def encode(self, index: Index, offsets: np.ndarray, part: Part) -> bytes:
        """Encode a part's texels at ``offsets`` as an object,
        byte for byte as Zarr would with CHUNK_CODECS.
        """
        return wrap(pack(part, offsets, self.texels, self.digest, index))

    def save(self, index: Index, offsets: np.ndarray, part: Part) -> bool:
        """Write a chunk's part as one object, atomically, merged with the light that others have
        written there.

        Each texel keeps the light of more samples, so no writer undoes another's work. If the array
        was deleted, it is created again.

        Return True if another writer has stored the same light already, or more samples for some
        texel. Raises StoreError if others write the same chunk each time.
        """
        # Read, merge, and replace only if the object has not changed since it was read; else begin
        # again with the newer one.
        key = self._key(index)
        self._recognise()
        for _ in range(MOST_TRIES):
            former = self.store.get_sound(key)
            whole = merge_parts(offsets, part, *self._former(index, former))
            stored = self.encode(index, *whole)
            # A chunk without metadata could not be found again, so the array comes first.
            if former is None:
                self.array = self._open() or self._create()
            elif stored == former.data:
                return True
            with suppress(ChangedError):
                self.store.put(key, stored, former)
                return has_more_samples(offsets, part, *whole)
        raise StoreError(
            f"Others keep writing chunk {index} of the light at {self.path}; writing it is tried "
            "again later."
        )

    def _former(self, index: Index, found: StoredObject | None) -> tuple[np.ndarray, Part]:
        """Decode an object that was found; return no texels if it is missing or damaged."""
        with suppress(DamagedChunkError):
            if found is not None:
                return self.decode(index, found.data)
        return np.empty(0, np.int32), Part.dark(self.layer, 0)


def to_chunk_places(places: np.ndarray, numbers: Sequence[int], texels: int) -> np.ndarray:
    """Renumber ``places`` (m,) int32 in records to places in chunks,
    if record i is of chunk ``numbers[i]``.
    """
    record, offset = np.divmod(places, np.int32(texels))
    return np.asarray(np.array(numbers, np.int32)[record] * np.int32(texels) + offset)


def merge_parts(
    offsets: np.ndarray, part: Part, others: np.ndarray, other: Part
) -> tuple[np.ndarray, Part]:
    """Merge two parts of one chunk: each texel gets the light of more samples, and is void if it is
    so in either part.

    ``offsets`` and ``others`` are the texels of ``part`` and ``other``, ascending. Return the union
    of them, and its part.
    """
    if not len(others):
        return offsets, part
    union = np.union1d(offsets, others).astype(np.int32)
    whole = part.among(offsets, union)
    rows = np.searchsorted(union, others)
    # VOID is -1 and would lose a comparison of samples, so it is asked for by itself.
    better = (whole.samples[rows] != VOID) & (
        (other.samples > whole.samples[rows]) | (other.samples == VOID)
    )
    whole.put(rows[better], other.rows(better))
    return union, whole


def has_more_samples(offsets: np.ndarray, part: Part, union: np.ndarray, whole: Part) -> bool:
    """Return True if ``whole`` has more samples than ``part`` for any texel of ``part``."""
    return whole is not part and bool(
        (whole.samples[np.searchsorted(union, offsets)] > part.samples).any()
    )


def layer_attributes(
    layer: Layer, prepared: PreparedScene, shown: Isovalue | None = None
) -> dict[str, Any]:
    """Return the attributes of a layer's array: the scene, the parameters of its light, and the
    codes of its records.

    A reader without isogi can decode the records from them. ``scene`` and ``plan`` are those that
    the layer was first baked for; other scenes may share it.
    """
    scene = prepared.scene
    record = record_type(layer, prepared.lattice.texels)
    # Direct light meets surfaces once, so neither bounces nor albedo change it.
    bounces = 0
    albedo = None
    if layer.reflected:
        bounces = scene.bounces
        albedo = list(layer.nodes or scene.surfaces.albedo)
    # Only irradiance depends on the lights; transfer serves any.
    lights = None
    if layer.kind == "irradiance":
        lights = [light.name for light in scene.lighting.lights]
    return {
        # The scene and volume of the light, and the lattice that it is for.
        "format": BAKE_FORMAT,
        "scene": scene.id,
        "volume": scene.volume.name,
        "volume_digest": scene.volume.digest,
        "isovalue_offset": scene.volume.offset,
        "isovalue_scale": scene.volume.scale,
        "texels": list(prepared.shape),
        "chunk": scene.settings.chunk,
        "step": prepared.step.tolist(),
        "normals": scene.settings.normals,
        "offset": scene.settings.offset,
        "shown": shown,
        # The layer, and everything that its light depends on.
        **asdict(layer),
        "bounces": bounces,
        "albedo": albedo,
        "lights": lights,
        # The plan, and the form of its records.
        "plan": asdict(scene.plan),
        "codes": RECORD_CODES,
        "record": [[name, kind.base.str, list(kind.shape)] for name, kind in fields_of(record)],
    }


def fields_of(record: np.dtype[np.void]) -> Iterator[tuple[str, np.dtype[Any]]]:
    """Yield the names and types of a record's fields, in their order."""
    for name in record.names or ():
        yield name, record[name]
