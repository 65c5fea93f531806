"""Zarr's formats: an array's ``zarr.json``, and a chunk's compressed bytes with a checksum at the end."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import google_crc32c
import numpy as np
import zarr
from numcodecs.zstd import Zstd
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from isogi_core.errors import DamagedChunkError

METADATA_KEY = "zarr.json"


def description(**array: Any) -> bytes:
    """The ``zarr.json`` of an array made with these arguments of ``zarr.create_array``."""
    store = MemoryStore()
    zarr.create_array(store, zarr_format=3, **array)
    return store._store_dict[METADATA_KEY].to_bytes()


@lru_cache(maxsize=64)
def described_array(document: bytes) -> "zarr.Array[Any]":
    """The array that a ``zarr.json`` describes, without its chunks. Raises errors of many kinds for other documents.

    Kept, as it is read before each new chunk, and Zarr takes as long for it as a small task for its light.
    """
    store = MemoryStore({METADATA_KEY: default_buffer_prototype().buffer.from_bytes(document)})
    return zarr.open_array(store, mode="r", zarr_format=3)


CRC_BYTES = 4

ZSTD_LEVEL = 1
"""Compression level of Zstandard."""


def wrap(record: np.ndarray) -> bytes:
    """Compress a ``record``, (bytes,) uint8, into an object with a checksum."""
    body = bytes(Zstd(level=ZSTD_LEVEL).encode(record))
    return body + checksum_of(body)


def unwrap(stored: bytes, size: int) -> np.ndarray:
    """The record in an object, (``size``,) uint8. Raises DamagedChunkError."""
    return unwrap_all([stored], size)[0]


def unwrap_all(stored: Sequence[bytes], size: int) -> np.ndarray:
    """The records in objects, (objects, ``size``) uint8. Raises DamagedChunkError where any is damaged.

    The bodies are decoded as one stream, so that Zstandard is set up once.
    """
    bodies = b"".join(map(body_of, stored))
    try:
        records = np.frombuffer(Zstd().decode(bodies) if stored else b"", np.uint8)
    except (RuntimeError, ValueError) as error:
        raise DamagedChunkError("it does not unpack") from error
    if len(records) != len(stored) * size:
        raise DamagedChunkError("it does not unpack to a record")
    return records.reshape(len(stored), size)


def body_of(stored: bytes) -> bytes:
    """An object without its checksum; DamagedChunkError where the checksum is wrong."""
    body, checksum = stored[:-CRC_BYTES], stored[-CRC_BYTES:]
    if len(stored) <= CRC_BYTES or checksum_of(body) != checksum:
        raise DamagedChunkError("its checksum is wrong")
    return body


def checksum_of(body: bytes) -> bytes:
    """The checksum at the end of an object."""
    return google_crc32c.value(body).to_bytes(CRC_BYTES, "little")
