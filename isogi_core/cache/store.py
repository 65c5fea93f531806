"""Chunks of light on disk or in an object store: one Zarr v3 array a bake, one object a chunk.

An object is written whole or not at all and describes itself, so readers and writers need no locks.
Whether a chunk is there is asked of the store by key and never read from values; what was
damaged on the way is caught by the checksum that is the last codec.
"""

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import zarr
from numcodecs.zstd import Zstd
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync

from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.chunk import Chunk
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.lattice import CHUNK

CRC_BYTES = 4


def default_store() -> Path:
    """Where light is kept when nobody says where: ``$XDG_CACHE_HOME/isogi/light`` or ``~/.cache/isogi/light``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "light"


class ChunkStore:
    """The chunks of one bake under ``root``, a folder or a URL that Zarr opens. Raises StoreError."""

    def __init__(self, root: str | Path, recipe: Recipe) -> None:
        """Name the bake's place; nothing is opened or made yet."""
        self.root = str(root)
        self.recipe = recipe

    @cached_property
    def array(self) -> "zarr.Array[Any]":
        """The Zarr array, made on first use: (z, y, x, planes) float32."""
        path = f"{self.root.rstrip('/')}/{self.recipe.scene.bake_digest}"
        try:
            return zarr.open_array(path, mode="r+", zarr_format=3, config={"write_empty_chunks": True})
        except FileNotFoundError:
            return self._create(path)
        except Exception as error:
            raise StoreError(f"Cannot open the light at {path}: {error}") from error

    def _create(self, path: str) -> "zarr.Array[Any]":
        planes = self.recipe.scene.plan.planes
        try:
            return zarr.create_array(
                path,
                shape=(*self.recipe.shape, len(planes)),
                chunks=(CHUNK, CHUNK, CHUNK, len(planes)),
                dtype="float32",
                fill_value=np.nan,
                serializer=BytesCodec(endian="little"),
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                attributes={"isogi": self._facts()},
                config={"write_empty_chunks": True},
                zarr_format=3,
                overwrite=False,
            )
        except zarr.errors.ContainsArrayError:
            return zarr.open_array(path, mode="r+", zarr_format=3, config={"write_empty_chunks": True})
        except Exception as error:
            raise StoreError(f"Cannot make a place for light at {path}: {error}") from error

    def _facts(self) -> dict[str, Any]:
        scene = self.recipe.scene
        return {
            "planes": list(scene.plan.planes),
            "volume": scene.volume.name,
            "volume_digest": scene.volume.digest,
            "isovalue_offset": scene.volume.offset,
            "isovalue_scale": scene.volume.scale,
            "step": self.recipe.step.tolist(),
            "albedo": list(scene.albedo),
            "bounces": scene.bounces,
            "order": scene.plan.order,
        }

    def _key(self, index: Index) -> str:
        return f"{self.array.path}/{self.array.metadata.encode_chunk_key((*index, 0))}".lstrip("/")

    def read(self, index: Index) -> bytes | None:
        """The object of a chunk as it is stored, or None where there is none."""
        try:
            stored = sync(self.array.store.get(self._key(index), default_buffer_prototype()))
        except Exception as error:
            raise StoreError(f"Cannot read chunk {index} of the light at {self.root}: {error}") from error
        return None if stored is None else stored.to_bytes()

    def decode(self, index: Index, stored: bytes) -> Chunk:
        """The chunk in an object; DamagedChunkError where the bytes are not the ones that were written."""
        planes = self.array.shape[-1]
        body, checksum = stored[:-CRC_BYTES], stored[-CRC_BYTES:]
        if len(stored) <= CRC_BYTES or google_crc32c.value(body).to_bytes(CRC_BYTES, "little") != checksum:
            raise DamagedChunkError(f"Chunk {index} of the light at {self.root} is damaged: its checksum is wrong.")
        values = np.frombuffer(Zstd().decode(body), "<f4")
        if values.size != CHUNK**3 * planes:
            raise DamagedChunkError(f"Chunk {index} of the light at {self.root} has the wrong size.")
        return Chunk.from_block(index, self.recipe.scene.plan, values.reshape(CHUNK, CHUNK, CHUNK, planes))

    def load(self, index: Index) -> Chunk:
        """The chunk, empty where it is absent or damaged: what is lost is baked again."""
        stored = self.read(index)
        if stored is None:
            return Chunk.empty(index, self.recipe.scene.plan)
        try:
            return self.decode(index, stored)
        except DamagedChunkError:
            return Chunk.empty(index, self.recipe.scene.plan)

    def save(self, chunk: Chunk) -> None:
        """Write a chunk as one object, atomically."""
        try:
            self.array.set_block_selection((*chunk.index, 0), self._inside(chunk))
        except Exception as error:
            raise StoreError(f"Cannot write chunk {chunk.index} of the light at {self.root}: {error}") from error

    def _inside(self, chunk: Chunk) -> np.ndarray:
        z, y, x = (min(CHUNK, n - i * CHUNK) for n, i in zip(self.recipe.shape, chunk.index, strict=True))
        return chunk.block()[:z, :y, :x]


def version_of(stored: bytes) -> str:
    """The version of a stored chunk: its checksum, as hex. Equal light has equal versions."""
    return stored[-CRC_BYTES:].hex()
