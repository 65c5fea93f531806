"""Layers of light on disk or in an object store: one Zarr v3 array a layer, one object a chunk.

An object is written whole or not at all and describes itself, so readers and writers need no locks.
Whether a chunk is there is asked of the store by key and never read from values; what was
damaged on the way is caught by the checksum that is the last codec.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

from isogi_core.bake.light import Part
from isogi_core.bake.precision import FIRST_RUNG, NEGATIVE, NOISIEST, SILENT, STEPS, VOID, VOID_CODE
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.metadata import described, description
from isogi_core.cache.record import at_home, pack, record_type, unpack_all
from isogi_core.cache.root import Root, Where
from isogi_core.cache.shelf import Found
from isogi_core.cache.troubles import one_line
from isogi_core.cache.wrapping import LEVEL, unwrap_all, wrap
from isogi_core.errors import ChangedError, DamagedChunkError, StoreError, StoreFullError, StoreReadOnlyError
from isogi_core.model.plan import Layer
from isogi_core.model.scene import BAKE_FORMAT

CODECS = (BytesCodec, ZstdCodec, Crc32cCodec)
"""What a chunk goes through on its way to the store; the checksum is last, so that it covers all of it."""

MOST_TRIES = 20
"""Writes of a chunk in a row that others came before."""

CODES = {
    "first_rung": FIRST_RUNG,
    "void": VOID_CODE,
    "noisiest": NOISIEST,
    "steps": STEPS,
    "silent": SILENT,
    "negative": NEGATIVE,
}
"""What a reader without isogi needs to know of the bytes in a record."""

MOVE_AWAY = "have `isogi store repair` mend it, or move that folder away, and the light is baked again."


class LayerStore:
    """The chunks of one layer at ``root``, a folder, a URL or a root that is open. Raises StoreError.

    Its texels lie on the isosurface that is ``shown``, a normalised isovalue, where one is; see ``Look``.
    """

    def __init__(self, root: Where, recipe: Recipe, layer: Layer, shown: float | None = None) -> None:
        """Name the layer's place; nothing is opened or made yet."""
        self.root = Root.of(root)
        self.recipe = recipe
        self.layer = layer
        self.shown = shown
        self.digest = recipe.scene.layer_digest(layer, shown)
        self.texels = recipe.lattice.texels
        self.size = record_type(layer, self.texels).itemsize

    @cached_property
    def array(self) -> "zarr.Array[Any]":
        """The Zarr array, made on first use: (chunks z, y, x, bytes of a record) uint8."""
        return self._open() or self._create()

    @property
    def path(self) -> str:
        """The folder or URL of this layer: the root and the digest of all that its light depends on."""
        return f"{self.root.place.name}/{self.digest}"

    @property
    def exists(self) -> bool:
        """Whether the store has light of this layer: an array that was made, and a chunk at least in it."""
        array = self._find()
        return array is not None and self._is_ours(array) and bool(self.root.names(f"{self.digest}/c"))

    @property
    def made(self) -> bool:
        """Whether the array was made; once it was, the store is not asked again."""
        self._recognise()
        return "array" in self.__dict__

    def open(self) -> None:
        """Open the array, or make it; a store that takes none at the moment is read as it is."""
        with suppress(StoreReadOnlyError, StoreFullError):
            self.array  # noqa: B018

    def _find(self) -> "zarr.Array[Any] | None":
        """The Zarr array that is there, as it describes itself; None where there is none."""
        found = self.root.get(self._metadata_key)
        try:
            return None if found is None else described(found.data)
        except Exception as error:
            raise StoreError(f"Cannot open the light at {self.path}: {one_line(error)}; {MOVE_AWAY}") from error

    def _open(self) -> "zarr.Array[Any] | None":
        """The array where it is there; StoreError where it is not ours."""
        array = self._find()
        if array is None or self._is_ours(array):
            return array
        raise StoreError(f"What is kept at {self.path} is not this scene's light; {MOVE_AWAY}")

    def _is_ours(self, array: "zarr.Array[Any]") -> bool:
        facts = array.attrs.asdict().get("isogi")
        return (
            array.shape == (*self.recipe.chunks, self.size)
            and array.chunks == (1, 1, 1, self.size)
            and array.dtype == np.uint8
            and tuple(map(type, getattr(array.metadata, "codecs", ()))) == CODECS
            and isinstance(facts, dict)
            and facts.get("volume_digest") == self.recipe.scene.volume.digest
        )

    def _create(self) -> "zarr.Array[Any]":
        with suppress(ChangedError):
            self.root.put(self._metadata_key, self._description(), None)
        array = self._open()
        if array is None:
            raise StoreError(f"Cannot make a place for light at {self.path}: it is gone again.")
        return array

    def _description(self) -> bytes:
        """What the array says of itself, as Zarr writes it."""
        return description(
            shape=(*self.recipe.chunks, self.size),
            chunks=(1, 1, 1, self.size),
            dtype="uint8",
            fill_value=0,
            compressors=[ZstdCodec(level=LEVEL), Crc32cCodec()],
            attributes={"isogi": facts_of(self.layer, self.recipe, self.shown)},
        )

    @property
    def _metadata_key(self) -> str:
        return f"{self.digest}/zarr.json"

    def _key(self, index: Index) -> str:
        """The object of a chunk, as Zarr names it."""
        return "/".join((self.digest, "c", *map(str, index), "0"))

    def read(self, index: Index) -> bytes | None:
        """The object of a chunk as it is stored, or None where there is none."""
        self._recognise()
        return self.root.view(self._key(index))

    def _recognise(self) -> None:
        """See that the array, where there is one, is this layer's; once that is so, it is not looked at again."""
        if "array" not in self.__dict__ and (array := self._open()) is not None:
            self.array = array

    def decode(self, index: Index, stored: bytes) -> tuple[np.ndarray, Part]:
        """Offsets and part in an object; DamagedChunkError where it is not what was written, or not for here."""
        return unpack_all(self._records([(index, stored)]), self.layer, self.texels)

    def decode_all(
        self, indices: Sequence[Index], stored: Sequence[bytes | None], tell: Callable[[DamagedChunkError], None]
    ) -> tuple[np.ndarray, Part]:
        """``decode`` of many chunks at once: places, see ``Chunks.of_parts``, and their part.

        A chunk whose object is None has no texels, and so has one whose object is damaged, which is told.
        """
        there = [i for i, data in enumerate(stored) if data is not None]
        objects = [(indices[i], stored[i] or b"") for i in there]
        try:
            records = self._records(objects)
        except DamagedChunkError:
            sound = [self._is_sound(each, tell) for each in objects]
            there, objects = list(compress(there, sound)), list(compress(objects, sound))
            records = self._records(objects)
        places, part = unpack_all(records, self.layer, self.texels)
        return placed(places, there, self.texels) if len(there) < len(stored) else places, part

    def _records(self, objects: Sequence[tuple[Index, bytes]]) -> np.ndarray:
        """The records in objects, (objects, bytes) uint8; DamagedChunkError, of the first, where any is of no use."""
        try:
            records = unwrap_all([data for _, data in objects], self.size)
        except DamagedChunkError as error:
            raise self._damaged(objects[0][0], str(error)) from error
        home = at_home(records, self.layer, self.texels, self.digest, [index for index, _ in objects])
        if not home.all():
            raise self._damaged(objects[0][0], "it was baked for another place")
        return records

    def _is_sound(self, found: tuple[Index, bytes], tell: Callable[[DamagedChunkError], None]) -> bool:
        """Whether an object can be used; what is wrong with it is told."""
        try:
            self._records([found])
        except DamagedChunkError as error:
            tell(error)
            return False
        return True

    def _damaged(self, index: Index, why: str) -> DamagedChunkError:
        return DamagedChunkError(f"Chunk {index} of the light at {self.path} is damaged: {why}; it is baked again.")

    def encode(self, index: Index, offsets: np.ndarray, part: Part) -> bytes:
        """The object of a part's texels at ``offsets``, as Zarr would write it with CODECS."""
        return wrap(pack(part, offsets, self.texels, self.digest, index))

    def save(self, index: Index, offsets: np.ndarray, part: Part) -> bool:
        """Write a chunk's part as one object, atomically, together with what others have written there meanwhile.

        Of each texel the light of more samples stays, so that no writer undoes what another has added. The array is
        made again where somebody deleted it. Returns whether others were found to have taken the same samples, or more.
        """
        key = self._key(index)
        self._recognise()
        for _ in range(MOST_TRIES):
            former = self.root.get(key)
            whole = joined(offsets, part, *self._former(index, former))
            stored = self.encode(index, *whole)
            if former is None:
                self._keep_array()
            elif stored == former.data:
                return True
            with suppress(ChangedError):
                self.root.put(key, stored, former)
                return outdone(offsets, part, *whole)
        raise StoreError(f"Others keep writing chunk {index} of the light at {self.path}; it is tried again later.")

    def _former(self, index: Index, found: Found | None) -> tuple[np.ndarray, Part]:
        """What an object holds; nothing where there is none, or what there is has been damaged."""
        with suppress(DamagedChunkError):
            if found is not None:
                return self.decode(index, found.data)
        return np.empty(0, np.int32), Part.dark(self.layer, 0)

    def _keep_array(self) -> None:
        """Have the array made, and made again where it is gone."""
        self.array = self._open() or self._create()


def placed(places: np.ndarray, numbers: Sequence[int], texels: int) -> np.ndarray:
    """The ``places`` (m,) int32 in some records, as those in the chunks of these ``numbers``, one of each record."""
    record, offset = np.divmod(places, np.int32(texels))
    return np.asarray(np.array(numbers, np.int32)[record] * np.int32(texels) + offset)


def joined(offsets: np.ndarray, part: Part, others: np.ndarray, other: Part) -> tuple[np.ndarray, Part]:
    """Two parts of one chunk as one: of each texel the light of more samples, and void where it is so in one."""
    union = np.union1d(offsets, others).astype(np.int32)
    whole = Part.dark(part.layer, len(union))
    whole.put(np.searchsorted(union, offsets), part)
    rows = np.searchsorted(union, others)
    better = (whole.samples[rows] != VOID) & ((other.samples > whole.samples[rows]) | (other.samples == VOID))
    whole.put(rows[better], other.rows(better))
    return union, whole


def outdone(offsets: np.ndarray, part: Part, union: np.ndarray, whole: Part) -> bool:
    """Whether the ``whole`` has more samples than a ``part`` of it of any of its texels."""
    return bool((whole.samples[np.searchsorted(union, offsets)] > part.samples).any())


def facts_of(layer: Layer, recipe: Recipe, shown: float | None = None) -> dict[str, Any]:
    """What a layer's array says of itself: whose light it is, how it was made, and how its records are read.

    ``scene`` and ``plan`` are those that it was first baked for; others may share the layer.
    """
    scene, record = recipe.scene, record_type(layer, recipe.lattice.texels)
    return {
        "format": BAKE_FORMAT,
        "scene": scene.id,
        "volume": scene.volume.name,
        "volume_digest": scene.volume.digest,
        "isovalue_offset": scene.volume.offset,
        "isovalue_scale": scene.volume.scale,
        "texels": list(recipe.shape),
        "chunk": scene.chunk,
        "step": recipe.step.tolist(),
        "normals": scene.normals,
        "offset": scene.offset,
        "shown": shown,
        **asdict(layer),
        "bounces": scene.bounces if layer.reflected else 0,
        "albedo": list(layer.nodes or scene.albedo) if layer.reflected else None,
        "lights": [light.name for light in scene.lights] if layer.kind == "irradiance" else None,
        "plan": asdict(scene.plan),
        "codes": CODES,
        "record": [[name, kind.base.str, list(kind.shape)] for name, kind in fields_of(record)],
    }


def fields_of(record: np.dtype[np.void]) -> Iterator[tuple[str, np.dtype[Any]]]:
    """Names and types of a record's fields, in their order."""
    for name in record.names or ():
        yield name, record[name]
