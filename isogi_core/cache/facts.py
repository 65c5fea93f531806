"""The facts of a layer: what its metadata says of whose light it is and how its records are read."""

import json
import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from isogi_core.bake.recipe import Index
from isogi_core.cache.record import record_type
from isogi_core.errors import DamagedChunkError
from isogi_core.model.plan import Layer

CODECS = ["bytes", "zstd", "crc32c"]


@dataclass(frozen=True, eq=False)
class LayerFacts:
    """One layer as its ``zarr.json`` tells it: ``attributes`` are isogi's own, ``texels`` those along z, y, x."""

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
    def ground(self) -> tuple[Any, ...]:
        """What says which of the texels can hold light: layers that agree on it must agree on that."""
        names = ("format", "volume_digest", "normals", "offset", "shown")
        return (self.texels, self.chunk, *(self.attributes.get(name) for name in names))

    def holds(self, index: Index) -> bool:
        """Whether a chunk lies within the lattice."""
        return all(place < count for place, count in zip(index, self.chunks, strict=True))


def facts_in(metadata: bytes) -> LayerFacts:
    """The facts that a ``zarr.json`` tells. DamagedChunkError says what is wrong with it."""
    try:
        found = json.loads(metadata)
        own = found["attributes"]["isogi"]
        z, y, x = map(int, own["texels"])
        named = {each.name: own[each.name] for each in fields(Layer) if each.name != "nodes"}
        layer = Layer(**named, nodes=tuple(map(float, own.get("nodes", ()))))
        facts = LayerFacts(layer, (z, y, x), int(own["chunk"]), own)
        whole = agrees(found, facts)
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise DamagedChunkError("it is not the metadata of a layer") from error
    if not whole:
        raise DamagedChunkError("the array that it describes is not that of its layer")
    return facts


def agrees(metadata: dict[str, Any], facts: LayerFacts) -> bool:
    """Whether the array that ``metadata`` describes is one that the layer's light is kept in."""
    grid = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return bool(
        metadata["zarr_format"] == 3
        and metadata["node_type"] == "array"
        and metadata["data_type"] == "uint8"
        and metadata["shape"] == [*facts.chunks, facts.record_size]
        and grid == [1, 1, 1, facts.record_size]
        and [codec["name"] for codec in metadata["codecs"]] == CODECS
        and metadata["chunk_key_encoding"]["name"] == "default"
        and isinstance(facts.attributes["volume_digest"], str)
    )
