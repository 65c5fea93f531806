"""Layers of light on disk or in an object store: one Zarr v3 array a layer, one object a chunk.

An object is written whole or not at all and describes itself, so readers and writers need no locks.
Whether a chunk is there is asked of the store by key and never read from values; what was
damaged on the way is caught by the checksum that is the last codec.
"""

from collections.abc import AsyncIterator, Iterator
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import zarr
from numcodecs.zstd import Zstd
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec
from zarr.core.array_spec import ArrayConfigParams
from zarr.core.buffer import Buffer, default_buffer_prototype
from zarr.core.common import AccessModeLiteral
from zarr.core.sync import sync
from zarr.storage import LocalStore

from isogi_core.bake.light import Part
from isogi_core.bake.precision import FIRST_RUNG, NEGATIVE, NOISIEST, SILENT, STEPS, VOID_CODE
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.record import pack, record_type, unpack
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.model.plan import Layer

CODECS = (BytesCodec, ZstdCodec, Crc32cCodec)
"""What a chunk goes through on its way to the store; the checksum is last, so that it covers all of it."""

CRC_BYTES = 4

CODES = {
    "first_rung": FIRST_RUNG,
    "void": VOID_CODE,
    "noisiest": NOISIEST,
    "steps": STEPS,
    "silent": SILENT,
    "negative": NEGATIVE,
}
"""What a reader without isogi needs to know of the bytes in a record."""

CONFIG: ArrayConfigParams = {"write_empty_chunks": True}
"""A chunk that looks like none is written too: that it is there says that it was baked."""

MOVE_AWAY = "move that folder away, and the light is baked again."


class LayerStore:
    """The chunks of one layer under ``root``, a folder or a URL that Zarr opens. Raises StoreError."""

    def __init__(self, root: str | Path, recipe: Recipe, layer: Layer) -> None:
        """Name the layer's place; nothing is opened or made yet."""
        self.root = str(root).removeprefix("file://")
        self.recipe = recipe
        self.layer = layer
        self.digest = recipe.scene.layer_digest(layer)
        self.size = record_type(layer).itemsize

    @cached_property
    def array(self) -> "zarr.Array[Any]":
        """The Zarr array, made on first use: (chunks z, y, x, bytes of a record) uint8."""
        return self._open()

    @property
    def path(self) -> str:
        """The folder or URL of this layer: the root and the digest of all that its light depends on."""
        return f"{self.root.rstrip('/')}/{self.digest}"

    @property
    def exists(self) -> bool:
        """Whether the store has light of this layer: an array that was made, and a chunk at least in it."""
        array = self._find("r")
        return array is not None and self._is_ours(array) and self._holds_any(array)

    def _holds_any(self, array: "zarr.Array[Any]") -> bool:
        """Whether there is anything where chunks are kept; one folder is listed, however many chunks there are."""
        try:
            return sync(any_of(array.store.list_dir(f"{array.path}/c".lstrip("/"))))
        except Exception as error:
            raise StoreError(f"Cannot look for light at {self.path}: {one_line(error)}.") from error

    def _find(self, mode: AccessModeLiteral) -> "zarr.Array[Any] | None":
        """The Zarr array that is there, opened; None where there is none."""
        try:
            return zarr.open_array(self.path, mode=mode, zarr_format=3)
        except FileNotFoundError:
            return None
        except Exception as error:
            raise StoreError(f"Cannot open the light at {self.path}: {one_line(error)}; {MOVE_AWAY}") from error

    def _open(self) -> "zarr.Array[Any]":
        array = self._find("r+")
        if array is None:
            return self._create()
        if not self._is_ours(array):
            raise StoreError(f"What is kept at {self.path} is not this scene's light; {MOVE_AWAY}")
        return array.with_config(CONFIG)

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
        try:
            return zarr.create_array(
                self.path,
                shape=(*self.recipe.chunks, self.size),
                chunks=(1, 1, 1, self.size),
                dtype="uint8",
                fill_value=0,
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                attributes={"isogi": facts_of(self.layer, self.recipe)},
                config=CONFIG,
                zarr_format=3,
                overwrite=False,
            )
        except zarr.errors.ContainsArrayError:
            return self._open()
        except Exception as error:
            raise StoreError(f"Cannot make a place for light at {self.path}: {one_line(error)}.") from error

    def _key(self, index: Index) -> str:
        return f"{self.array.path}/{self.array.metadata.encode_chunk_key((*index, 0))}".lstrip("/")

    @property
    def _metadata_key(self) -> str:
        return f"{self.array.path}/zarr.json".lstrip("/")

    def _get(self, key: str) -> Buffer | None:
        """An object by its key; a local one without the detour over Zarr's event loop."""
        store = self.array.store
        return (
            store.get_sync(key) if isinstance(store, LocalStore) else sync(store.get(key, default_buffer_prototype()))
        )

    def read(self, index: Index) -> bytes | None:
        """The object of a chunk as it is stored, or None where there is none."""
        try:
            stored = self._get(self._key(index))
        except Exception as error:
            raise StoreError(f"Cannot read chunk {index} of the light at {self.path}: {one_line(error)}.") from error
        return None if stored is None else stored.to_bytes()

    def decode(self, index: Index, stored: bytes) -> tuple[np.ndarray, Part]:
        """Offsets and part in an object; DamagedChunkError where it is not what was written, or not for here."""
        body, checksum = stored[:-CRC_BYTES], stored[-CRC_BYTES:]
        if len(stored) <= CRC_BYTES or google_crc32c.value(body).to_bytes(CRC_BYTES, "little") != checksum:
            raise self._damaged(index, "its checksum is wrong")
        try:
            record = np.frombuffer(Zstd().decode(body), np.uint8)
        except (RuntimeError, ValueError) as error:
            raise self._damaged(index, "it does not unpack") from error
        if len(record) != self.size:
            raise self._damaged(index, "it does not unpack to a record")
        found = unpack(record, self.layer, self.digest, index)
        if found is None:
            raise self._damaged(index, "it was baked for another place")
        return found

    def _damaged(self, index: Index, why: str) -> DamagedChunkError:
        return DamagedChunkError(f"Chunk {index} of the light at {self.path} is damaged: {why}; it is baked again.")

    def save(self, index: Index, offsets: np.ndarray, part: Part) -> None:
        """Write a chunk's part as one object, atomically; the array is made again where somebody deleted it."""
        try:
            if self._get(self._metadata_key) is None:
                del self.array
            self.array.set_block_selection((*index, 0), pack(part, offsets, self.digest, index)[None, None, None])
        except StoreError:
            raise
        except Exception as error:
            why = one_line(error)
            raise StoreError(f"Cannot write chunk {index} of the light at {self.path}: {why}.") from error


async def any_of(names: AsyncIterator[str]) -> bool:
    """Whether there is any of the ``names``; no more than the first is asked for."""
    async for _ in names:
        return True
    return False


def facts_of(layer: Layer, recipe: Recipe) -> dict[str, Any]:
    """What a layer's array says of itself: whose light it is, how it was made, and how its records are read.

    ``plan`` is that of the scene which it was first baked for; others may share the layer.
    """
    scene = recipe.scene
    return {
        "volume": scene.volume.name,
        "volume_digest": scene.volume.digest,
        "isovalue_offset": scene.volume.offset,
        "isovalue_scale": scene.volume.scale,
        "texels": list(recipe.shape),
        "step": recipe.step.tolist(),
        **asdict(layer),
        "bounces": scene.bounces if layer.reflected else 0,
        "albedo": list(scene.albedo) if layer.reflected else None,
        "lights": [light.name for light in scene.lights] if layer.kind == "irradiance" else None,
        "plan": asdict(scene.plan),
        "codes": CODES,
        "record": [[name, kind.base.str, list(kind.shape)] for name, kind in fields_of(record_type(layer))],
    }


def fields_of(record: np.dtype[np.void]) -> Iterator[tuple[str, np.dtype[Any]]]:
    """Names and types of a record's fields, in their order."""
    for name in record.names or ():
        yield name, record[name]


def one_line(error: Exception) -> str:
    """What an error of somebody else's says, on one line and without a full stop."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
