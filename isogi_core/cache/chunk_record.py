"""The record of a chunk: the bytes of one object of the store, and the layer's metadata that
describe them.

A chunk is a cube of texels. Each layer of a bake (direct light, reflected light, glow) keeps a
chunk as one record. ``Chunk`` and ``Chunks`` are the decoded texels of all layers together.
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
    """Return the packed NumPy type of the record of a chunk with ``texels`` texels, z slowest.

    - ``bake``, ``index``: the layer's digest, and the chunk's index (z, y, x). A reader recognises
      by them an object that was stored under a wrong key.
    - ``scale``: unit of ``light``, ``high`` and ``noise``; the layer's scale.
    - ``rung``: code of each texel's sample count, 0 if the texel is not baked.
    - ``noise`` (noises, texels): codes of standard errors.
    - ``light`` (channels, floats, texels): coefficients of the lowest bands, as floats.
    - ``high`` (channels, coefficients - floats, texels): coefficients of higher bands, as codes.

    ``bake.texel_light`` defines the codes.
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
    """Pack the texels of a ``part`` into the record of the chunk ``index``; (bytes,) uint8.

    ``offsets`` (m,) are the places of the part's texels within the chunk, which has ``texels``
    texels. Texels without samples are left out. ``bake`` is the layer's digest.
    """
    layer = part.layer
    record = np.zeros((), record_type(layer, texels))
    record["bake"] = bake.encode()
    record["index"] = index
    record["scale"] = layer.scale
    # Store the texels that have samples. Everything else in the record is zero, so that equal light
    # has equal bytes.
    lit = part.samples != 0
    rows = part.rows(lit)
    record["rung"][offsets[lit]] = level_codes(rows.samples)
    record["noise"][:, offsets[lit]] = noise_codes(rows.noise, layer.scale).T
    # In memory a texel's coefficients lie together; in the record each coefficient is a plane over
    # the texels, in the order in which the kernel that unpacks them reads.
    light = np.moveaxis(rows.coefficients / np.float32(layer.scale), 0, -1)
    record["light"][:, :, offsets[lit]] = light_floats(light[:, : layer.floats], layer)
    record["high"][:, :, offsets[lit]] = light_codes(light[:, layer.floats :])
    return record.reshape(1).view(np.uint8)


def unpack(
    data: np.ndarray, layer: Layer, texels: int, bake: str, index: Index
) -> tuple[np.ndarray, Part] | None:
    """Unpack one record, (bytes,) uint8, to the ascending offsets of its texels and their part.

    Return None if the record is of another bake or another chunk than ``index``.
    """
    records = data.reshape(1, -1)
    if belongs(records, layer, texels, bake, [index]).all():
        return unpack_all(records, layer, texels)
    return None


def belongs(
    records: np.ndarray, layer: Layer, texels: int, bake: str, indices: Sequence[Index]
) -> np.ndarray:
    """Return True for each of the ``records`` (k, bytes) uint8 that names this ``bake`` and its
    chunk, the one at the same place in ``indices``; (k,) bool.

    The others were copied to a wrong key of the store, and hold the light of other texels.
    """
    found = record_fields(records, layer, texels)
    here = (found["index"] == np.array(indices).reshape(-1, 3)).all(axis=1)
    return np.asarray(here & (found["bake"] == bake.encode()))


def unpack_all(records: np.ndarray, layer: Layer, texels: int) -> tuple[np.ndarray, Part]:
    """Unpack ``records`` (k, bytes) uint8 to the ascending places of their texels, (m,) int32, and
    their part.

    A place is the record's number times ``texels`` plus the texel's offset in its chunk.
    """
    found = record_fields(records, layer, texels)
    places = np.flatnonzero(found["rung"] != 0).astype(np.int32)
    # Texels of record i are the rows bounds[i] to bounds[i + 1] of the part.
    bounds = np.searchsorted(places, np.arange(len(records) + 1, dtype=np.int32) * np.int32(texels))
    # One kernel call decodes all records: the part is allocated first, and filled in place.
    part = Part.undefined(layer, len(places))
    planes = (found["scale"], found["rung"], found["noise"], *planes_of(found, layer))
    filled = Texels(part.samples, part.noise, part.coefficients)
    unpack_texels(places % np.int32(texels), bounds, planes, RECORD_TABLES, filled)
    return places, part


def record_fields(records: np.ndarray, layer: Layer, texels: int) -> np.ndarray:
    """View ``records`` (k, bytes) uint8 as NumPy records of ``record_type``, (k,)."""
    return records.view(record_type(layer, texels))[:, 0]


def planes_of(found: np.ndarray, layer: Layer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the light of the NumPy records ``found`` (k,) as three arrays.

    - The coefficients of lower bands that are half floats, as their bits: (k, channels, floats,
      texels) uint16.
    - Those that are single floats: the same shape, float32.
    - The codes of the coefficients of higher bands: (k, channels, coefficients - floats, texels)
      uint8.

    The kernel has an argument for each kind of float. The layer uses one kind; the array of the
    other has no entries.
    """
    light = found["light"]
    none = found["light"][:, :, :0]
    if layer.half:
        return light.view(np.uint16), none.astype(np.float32), found["high"]
    return none.astype(np.uint16), light, found["high"]


def find_anomaly(data: np.ndarray, layer: Layer, texels: int) -> str:
    """Look for faults in a record, (bytes,) uint8, that ``pack`` never writes. Return a description
    of the first one, empty if there is none.
    """
    record = data.view(record_type(layer, texels))[0]
    level = record["rung"]
    light = record["light"]
    dark = level == 0
    # The record's checksum has been verified, so no fault here is damage of the store: the program
    # that wrote the record was wrong.
    faults = {
        "it was packed to another scale": record["scale"] != np.float32(layer.scale),
        "a texel took a number of samples that none takes": (
            (level > HIGHEST_LEVEL) & (level != VOID_CODE)
        ).any(),
        "its light is not finite": not np.isfinite(light).all(),
        "texels without samples have light": any(
            record[name][..., dark].any() for name in ("light", "high", "noise")
        ),
    }
    return next((fault for fault, found in faults.items() if found), "")


CODEC_NAMES = ["bytes", "zstd", "crc32c"]


@dataclass(frozen=True, eq=False)
class LayerFacts:
    """A layer as its ``zarr.json`` describes it.

    ``texels`` counts the texels of its lattice along z, y, x, ``chunk`` those along a chunk's side;
    ``attributes`` is isogi's entry in the metadata.
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
        """The facts that decide which texels can hold light.

        Layers that have equal facts must agree on these texels.
        """
        names = ("format", "volume_digest", "normals", "offset", "shown")
        return (self.texels, self.chunk, *(self.attributes.get(name) for name in names))

    def holds(self, index: Index) -> bool:
        """Return True if the chunk ``index`` lies within the lattice."""
        return all(place < count for place, count in zip(index, self.chunks, strict=True))


UNREADABLE = (
    *(ValueError, KeyError, TypeError, AttributeError),
    *(ArithmeticError, RecursionError),
)
"""Errors that reading raises if metadata is not that of a layer."""


def facts_in(metadata: bytes) -> LayerFacts:
    """Read the description of a layer from the bytes of its ``zarr.json``.

    Raises DamagedChunkError, with the reason, if it is not the metadata of a layer, or if the array
    that it describes does not fit the layer.
    """
    try:
        found = json.loads(metadata)
        attributes = found["attributes"]["isogi"]
        z, y, x = map(int, attributes["texels"])
        # Metadata from before there were nodes has no entry for them.
        named = {each.name: attributes[each.name] for each in fields(Layer) if each.name != "nodes"}
        layer = Layer(**named, nodes=tuple(map(float, attributes.get("nodes", ()))))
        facts = LayerFacts(layer, (z, y, x), int(attributes["chunk"]), attributes)
        fits = agrees(found, facts)
    except UNREADABLE as error:
        raise DamagedChunkError("it is not the metadata of a layer") from error
    if not fits:
        raise DamagedChunkError("the array that it describes is not that of its layer")
    return facts


def agrees(metadata: dict[str, Any], facts: LayerFacts) -> bool:
    """Return True if ``metadata`` describes the array
    that a layer with these ``facts`` must have.
    """
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
    """The texels of one chunk that have light, in all layers of a bake.

    ``offsets`` (m,) int32, ascending, are their places within the chunk; ``light`` has a row for
    each.
    """

    index: Index
    offsets: np.ndarray
    light: Light

    @classmethod
    def empty(cls, index: Index, plan: ScenePlan) -> "Chunk":
        """Return a chunk in which nothing is baked."""
        return cls(index, np.empty(0, np.int32), Light.dark(plan, 0))

    @classmethod
    def of_parts(cls, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> "Chunk":
        """Return the chunk whose layers have the offsets and parts ``found``, one pair a layer."""
        return cls(index, *merge_layers(found))

    def with_texels(self, offsets: np.ndarray) -> "Chunk":
        """Return this chunk with dark texels added at those ``offsets`` that it lacks."""
        union = np.union1d(self.offsets, offsets).astype(np.int32)
        return Chunk(
            self.index,
            union,
            Light(tuple(part.among(self.offsets, union) for part in self.light.parts)),
        )

    def rows_of(self, offsets: np.ndarray) -> np.ndarray:
        """Return the rows of ``light`` of the texels at ``offsets``;
        the chunk must have all of them.
        """
        return np.searchsorted(self.offsets, offsets)


@dataclass(frozen=True, eq=False)
class Chunks:
    """The texels of several chunks, in all layers of a bake.

    The texels of chunk ``indices[i]`` are the rows ``bounds[i]`` to ``bounds[i + 1]`` of ``light``.
    ``bounds`` (chunks + 1,) int64; ``offsets`` (m,) int32, ascending within each chunk.
    """

    indices: tuple[Index, ...]
    bounds: np.ndarray
    offsets: np.ndarray
    light: Light

    @classmethod
    def of_one(cls, chunk: Chunk) -> "Chunks":
        """Return a single chunk as ``Chunks``."""
        return cls((chunk.index,), np.array([0, len(chunk.offsets)]), chunk.offsets, chunk.light)

    @classmethod
    def of_parts(
        cls, indices: Sequence[Index], texels: int, found: Sequence[tuple[np.ndarray, Part]]
    ) -> "Chunks":
        """Return those chunks of ``indices`` that have texels, from the places and the part
        ``found`` in each layer.

        A place is the chunk's number among ``indices`` times the ``texels`` of a chunk, plus the
        texel's offset in it.
        """
        places, light = merge_layers(found)
        bounds = np.searchsorted(
            places, np.arange(len(indices) + 1, dtype=np.int32) * np.int32(texels)
        )
        # Leave out chunks without texels. Their bounds are equal to the ones before, so ``unique``
        # removes these too.
        there = tuple(compress(indices, (np.diff(bounds) > 0).tolist()))
        return cls(there, np.unique(bounds), places % np.int32(texels), light)


def merge_layers(found: Sequence[tuple[np.ndarray, Part]]) -> tuple[np.ndarray, Light]:
    """Return the ascending union of the places of all layers, (m,) int32, and the light there; a
    part is dark where its layer lacks the place.

    ``found`` holds the ascending places and the part of each layer.
    """
    first = found[0][0]
    parts = [part for _, part in found]
    # As a rule all layers were baked together and have the same places: no part is copied.
    if all(np.array_equal(places, first) for places, _ in found):
        return first.astype(np.int32), Light(tuple(parts))
    union = reduce(np.union1d, [places for places, _ in found]).astype(np.int32)
    return union, Light(tuple(part.among(places, union) for places, part in found))
