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
from zarr.core.array_spec import ArrayConfigParams
from zarr.core.buffer import Buffer, default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage import LocalStore

from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.origin import was_baked_here
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.lattice import CHUNK

CODECS = (BytesCodec, ZstdCodec, Crc32cCodec)
"""What a chunk goes through on its way to the store; the checksum is last, so that it covers all of it."""

CRC_BYTES = 4

CONFIG: ArrayConfigParams = {"write_empty_chunks": True}
"""A chunk that looks like none is written too: that it is there says that it was baked."""

MOVE_AWAY = "move that folder away, and the light is baked again."


def default_store() -> Path:
    """Where light is kept when nobody says where: ``$XDG_CACHE_HOME/isogi/light`` or ``~/.cache/isogi/light``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "light"


class ChunkStore:
    """The chunks of one bake under ``root``, a folder or a URL that Zarr opens. Raises StoreError."""

    def __init__(self, root: str | Path, recipe: Recipe) -> None:
        """Name the bake's place; nothing is opened or made yet."""
        self.root = str(root).removeprefix("file://")
        self.recipe = recipe

    @cached_property
    def array(self) -> "zarr.Array[Any]":
        """The Zarr array, made on first use: (z, y, x, planes) float32."""
        return self._open()

    @property
    def path(self) -> str:
        """The folder or URL of this bake: the root and the digest of all that the light depends on."""
        return f"{self.root.rstrip('/')}/{self.recipe.scene.bake_digest}"

    def _open(self) -> "zarr.Array[Any]":
        try:
            array = zarr.open_array(self.path, mode="r+", zarr_format=3)
        except FileNotFoundError:
            return self._create()
        except Exception as error:
            raise StoreError(f"Cannot open the light at {self.path}: {one_line(error)}; {MOVE_AWAY}") from error
        if not self._is_ours(array):
            raise StoreError(f"What is kept at {self.path} is not this scene's light; {MOVE_AWAY}")
        return array.with_config(CONFIG)

    def _is_ours(self, array: "zarr.Array[Any]") -> bool:
        planes = self.recipe.scene.plan.planes
        facts = array.attrs.asdict().get("isogi")
        return (
            array.shape == (*self.recipe.shape, len(planes))
            and array.chunks == (CHUNK, CHUNK, CHUNK, len(planes))
            and array.dtype == np.float32
            and tuple(map(type, getattr(array.metadata, "codecs", ()))) == CODECS
            and isinstance(facts, dict)
            and facts.get("volume_digest") == self.recipe.scene.volume.digest
        )

    def _create(self) -> "zarr.Array[Any]":
        planes = self.recipe.scene.plan.planes
        try:
            return zarr.create_array(
                self.path,
                shape=(*self.recipe.shape, len(planes)),
                chunks=(CHUNK, CHUNK, CHUNK, len(planes)),
                dtype="float32",
                fill_value=np.nan,
                serializer=BytesCodec(endian="little"),
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                attributes={"isogi": self._facts()},
                config=CONFIG,
                zarr_format=3,
                overwrite=False,
            )
        except zarr.errors.ContainsArrayError:
            return self._open()
        except Exception as error:
            raise StoreError(f"Cannot make a place for light at {self.path}: {one_line(error)}.") from error

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

    def decode(self, index: Index, stored: bytes) -> Chunk:
        """The chunk in an object; DamagedChunkError where it is not what was written, or was written for elsewhere."""
        body, checksum = stored[:-CRC_BYTES], stored[-CRC_BYTES:]
        if len(stored) <= CRC_BYTES or google_crc32c.value(body).to_bytes(CRC_BYTES, "little") != checksum:
            raise self._damaged(index, "its checksum is wrong")
        plan = self.recipe.scene.plan
        block = np.full((CHUNK, CHUNK, CHUNK, len(plan.planes)), np.nan, "<f4")
        try:
            Zstd().decode(body, out=block)
        except (RuntimeError, ValueError) as error:
            raise self._damaged(index, "it does not unpack") from error
        chunk = Chunk.from_block(index, plan, block)
        if not was_baked_here(chunk, self.recipe):
            raise self._damaged(index, "it was baked for another place")
        return chunk

    def _damaged(self, index: Index, why: str) -> DamagedChunkError:
        return DamagedChunkError(f"Chunk {index} of the light at {self.path} is damaged: {why}; it is baked again.")

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
        """Write a chunk as one object, atomically; the array is made again where somebody deleted it."""
        try:
            if self._get(self._metadata_key) is None:
                del self.array
            self.array.set_block_selection((*chunk.index, 0), self._inside(chunk))
        except StoreError:
            raise
        except Exception as error:
            why = one_line(error)
            raise StoreError(f"Cannot write chunk {chunk.index} of the light at {self.path}: {why}.") from error

    def _inside(self, chunk: Chunk) -> np.ndarray:
        z, y, x = (min(CHUNK, n - i * CHUNK) for n, i in zip(self.recipe.shape, chunk.index, strict=True))
        return chunk.block()[:z, :y, :x]


def one_line(error: Exception) -> str:
    """What an error of somebody else's says, on one line and without a full stop."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
