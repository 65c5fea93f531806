"""The record of a chunk: the content of one object of the store, and its description in the layer's
metadata.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, reduce
from itertools import compress
from typing import Any

import numpy as np

from isogi_core.bake.texel_light import (
    FIRST_LEVEL,
    LIGHT_OF,
    NOISE_OF,
    SAMPLES_OF,
    VOID_CODE,
    Light,
    Part,
    level_codes,
    light_codes,
    light_floats,
    noise_codes,
)
from isogi_core.errors import DamagedChunkError
from isogi_core.kernels.shading.texel_table import Numbers, Texels, unpack_texels
from isogi_core.model.scene_plan import MAX_SAMPLES, Layer, ScenePlan
from isogi_core.prepared.prepared_scene import Index

HIGHEST_LEVEL = 1 + (MAX_SAMPLES // FIRST_LEVEL).bit_length() - 1
"""The code of the highest sample level."""

RECORD_TABLES = Numbers(SAMPLES_OF, NOISE_OF, LIGHT_OF)
"""Tables of the numbers that the bytes of a record encode."""


@cache
def record_type(layer: Layer, texels: int) -> np.dtype[np.void]:
    """The NumPy type, packed, of the record of a chunk of so many ``texels``.

    ``bake`` is the layer's digest and ``index`` (z, y, x) the chunk's place. ``light`` (channels,
    coefficients, texels) holds multiples of ``scale``, and so does ``high``, the coefficients of
    higher bands as bytes. ``rung`` is the code of a texel's sample level; ``high``, ``rung`` and
    ``noise`` are codes: see ``bake.precision``. Texels go with z slowest.
    """
    return np.dtype(
        [
            ("bake", "S20"),
            ("index", "<i4", (3,)),
            ("scale", "<f4"),
            ("rung", "u1", (texels,)),
            ("noise", "u1", (layer.noises, texels)),
            ("light", "<f2" if layer.half else "<f4", (layer.channels, layer.floats, texels)),
            ("high", "u1", (layer.channels, layer.order**2 - layer.floats, texels)),
        ]
    )


def pack(part: Part, offsets: np.ndarray, texels: int, bake: str, index: Index) -> np.ndarray:
    """Pack a part's texels at ``offsets`` of the chunk ``index`` into a record, (bytes,) uint8, but
    for unlit ones.

    A whole chunk has so many ``texels``.
    """
    layer = part.layer
    record = np.zeros((), record_type(layer, texels))
    record["bake"] = bake.encode()
    record["index"] = index
    record["scale"] = layer.scale
    lit = part.samples != 0
    rows = part.rows(lit)
    record["rung"][offsets[lit]] = level_codes(rows.samples)
    record["noise"][:, offsets[lit]] = noise_codes(rows.noise, layer.scale).T
    light = np.moveaxis(rows.coefficients / np.float32(layer.scale), 0, -1)
    record["light"][:, :, offsets[lit]] = light_floats(light[:, : layer.floats], layer)
    record["high"][:, :, offsets[lit]] = light_codes(light[:, layer.floats :])
    return record.reshape(1).view(np.uint8)


def unpack(
    data: np.ndarray, layer: Layer, texels: int, bake: str, index: Index
) -> tuple[np.ndarray, Part] | None:
    """Unpack a record: ascending offsets of its texels, and their part; None where it is of another
    bake or place.
    """
    records = data.reshape(1, -1)
    if belongs(records, layer, texels, bake, [index]).all():
        return unpack_all(records, layer, texels)
    return None


def belongs(
    records: np.ndarray, layer: Layer, texels: int, bake: str, indices: Sequence[Index]
) -> np.ndarray:
    """Whether each of the ``records`` (k, bytes) uint8 is of this ``bake`` and its chunk of
    ``indices``; (k,) bool.
    """
    found = record_fields(records, layer, texels)
    here = (found["index"] == np.array(indices).reshape(-1, 3)).all(axis=1)
    return np.asarray(here & (found["bake"] == bake.encode()))


def unpack_all(records: np.ndarray, layer: Layer, texels: int) -> tuple[np.ndarray, Part]:
    """Unpack ``records`` (k, bytes) uint8: ascending places of their texels, and their part.

    A place is the record's number times ``texels`` plus the offset in its chunk; (m,) int32.
    """
    found = record_fields(records, layer, texels)
    places = np.flatnonzero(found["rung"] != 0).astype(np.int32)
    bounds = np.searchsorted(places, np.arange(len(records) + 1, dtype=np.int32) * np.int32(texels))
    part = Part.undefined(layer, len(places))
    planes = (found["scale"], found["rung"], found["noise"], *planes_of(found, layer))
    filled = Texels(part.samples, part.noise, part.coefficients)
    unpack_texels(places % np.int32(texels), bounds, planes, RECORD_TABLES, filled)
    return places, part


def record_fields(records: np.ndarray, layer: Layer, texels: int) -> np.ndarray:
    """View ``records`` (k, bytes) uint8 as NumPy records, (k,)."""
    return records.view(record_type(layer, texels))[:, 0]


def planes_of(found: np.ndarray, layer: Layer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The light in NumPy records as bits of half floats, single floats, and bytes; one kind of
    floats is empty.
    """
    light = found["light"]
    none = found["light"][:, :, :0]
    if layer.half:
        return light.view(np.uint16), none.astype(np.float32), found["high"]
    return none.astype(np.uint16), light, found["high"]


def find_anomaly(data: np.ndarray, layer: Layer, texels: int) -> str:
    """Find the first thing in a record, (bytes,) uint8, that ``pack`` never writes; empty if all is
    well.
    """
    record = data.view(record_type(layer, texels))[0]
    level = record["rung"]
    light = record["light"]
    dark = level == 0
    oddities = {
        "it was packed to another scale": record["scale"] != np.float32(layer.scale),
        "a texel took a number of samples that none takes": (
            (level > HIGHEST_LEVEL) & (level != VOID_CODE)
        ).any(),
        "its light is not finite": not np.isfinite(light).all(),
        "texels without samples have light": any(
            record[name][..., dark].any() for name in ("light", "high", "noise")
        ),
    }
    return next((what for what, found in oddities.items() if found), "")


CODEC_NAMES = ["bytes", "zstd", "crc32c"]


@dataclass(frozen=True, eq=False)
class LayerFacts:
    """A layer as its ``zarr.json`` describes it: isogi's own ``attributes``, and ``texels`` along
    z, y, x.
    """

    layer: Layer
    texels: tuple[int, int, int]
    chunk: int
    attributes: dict[str, Any]

    @cached_property
    def chunk_texels(self) -> int:
        """Texels of a whole chunk."""
        return self.chunk**3

    @cached_property
    def record_size(self) -> int:
        """Bytes of a chunk's record."""
        return record_type(self.layer, self.chunk_texels).itemsize

    @property
    def chunks(self) -> Index:
        """Chunks along z, y, x."""
        z, y, x = (math.ceil(count / self.chunk) for count in self.texels)
        return z, y, x

    @property
    def lattice_facts(self) -> tuple[Any, ...]:
        """The facts that decide which texels can hold light: layers with equal facts must agree on
        these texels.
        """
        names = ("format", "volume_digest", "normals", "offset", "shown")
        return (self.texels, self.chunk, *(self.attributes.get(name) for name in names))

    def holds(self, index: Index) -> bool:
        """Whether a chunk lies within the lattice."""
        return all(place < count for place, count in zip(index, self.chunks, strict=True))


UNREADABLE = (
    *(ValueError, KeyError, TypeError, AttributeError),
    *(ArithmeticError, RecursionError),
)
"""Errors that metadata of something else raises."""


def facts_in(metadata: bytes) -> LayerFacts:
    """Read the facts in a ``zarr.json``. Raises DamagedChunkError, which says what is wrong with
    it.
    """
    try:
        found = json.loads(metadata)
        own = found["attributes"]["isogi"]
        z, y, x = map(int, own["texels"])
        named = {each.name: own[each.name] for each in fields(Layer) if each.name != "nodes"}
        layer = Layer(**named, nodes=tuple(map(float, own.get("nodes", ()))))
        facts = LayerFacts(layer, (z, y, x), int(own["chunk"]), own)
        whole = agrees(found, facts)
    except UNREADABLE as error:
        raise DamagedChunkError("it is not the metadata of a layer") from error
    if not whole:
        raise DamagedChunkError("the array that it describes is not that of its layer")
    return facts


def agrees(metadata: dict[str, Any], facts: LayerFacts) -> bool:
    """Whether ``metadata`` describes an array as the layer's must be."""
    grid = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return bool(
        metadata["zarr_format"] == 3
        and metadata["node_type"] == "array"
        and metadata["data_type"] == "uint8"
        and metadata["shape"] == [*facts.chunks, facts.record_size]
        and grid == [1, 1, 1, facts.record_size]
        and [codec["name"] for codec in metadata["codecs"]] == CODEC_NAMES
        and metadata["chunk_key_encoding"]["name"] == "default"
        and isinstance(facts.attributes["volume_digest"], str)
    )


@dataclass(frozen=True, eq=False)
class Chunk:
    """Texels of one chunk: ``offsets`` (m,) int32 ascending, inside the chunk; ``light`` has a row
    for each.
    """

    index: Index
    offsets: np.ndarray
    light: Light

    @classmethod
    def empty(cls, index: Index, plan: ScenePlan) -> "Chunk":
        """A chunk in which nothing is baked."""
        return cls(index, np.empty(0, np.int32), Light.dark(plan, 0))

    @classmethod
    def of_parts(cls, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> "Chunk":
        """The chunk of the offsets and the part that were ``found`` in each layer."""
        return cls(index, *united(found))

    def with_texels(self, offsets: np.ndarray) -> "Chunk":
        """This chunk with the texels at ``offsets`` added where it lacks them; added texels are
        dark.
        """
        union = np.union1d(self.offsets, offsets).astype(np.int32)
        return Chunk(
            self.index,
            union,
            Light(tuple(part.among(self.offsets, union) for part in self.light.parts)),
        )

    def rows_of(self, offsets: np.ndarray) -> np.ndarray:
        """Rows of ``light`` for texels at ``offsets``, all of which the chunk must have."""
        return np.searchsorted(self.offsets, offsets)


@dataclass(frozen=True, eq=False)
class Chunks:
    """Texels of several chunks: those of ``indices[i]`` are the rows ``bounds[i]`` … ``bounds[i +
    1]`` of ``light``.

    ``bounds`` (chunks + 1,) int64; ``offsets`` (m,) int32, ascending in each chunk.
    """

    indices: tuple[Index, ...]
    bounds: np.ndarray
    offsets: np.ndarray
    light: Light

    @classmethod
    def of_one(cls, chunk: Chunk) -> "Chunks":
        """A single chunk."""
        return cls((chunk.index,), np.array([0, len(chunk.offsets)]), chunk.offsets, chunk.light)

    @classmethod
    def of_parts(
        cls, indices: Sequence[Index], texels: int, found: Sequence[tuple[np.ndarray, Part]]
    ) -> "Chunks":
        """The chunks that have texels, of the places and the part that were ``found`` in each
        layer.

        A place is the number of the chunk among ``indices`` times the ``texels`` of one plus the
        offset in it.
        """
        places, light = united(found)
        bounds = np.searchsorted(
            places, np.arange(len(indices) + 1, dtype=np.int32) * np.int32(texels)
        )
        there = tuple(compress(indices, (np.diff(bounds) > 0).tolist()))
        return cls(there, np.unique(bounds), places % np.int32(texels), light)


def united(found: Sequence[tuple[np.ndarray, Part]]) -> tuple[np.ndarray, Light]:
    """The places ``found`` in any of the layers, ascending, and their light; a part is dark where
    it lacks a place.
    """
    first = found[0][0]
    parts = [part for _, part in found]
    if all(np.array_equal(own, first) for own, _ in found):
        return first.astype(np.int32), Light(tuple(parts))
    places = reduce(np.union1d, [own for own, _ in found]).astype(np.int32)
    return places, Light(tuple(part.among(own, places) for own, part in found))
