"""Zarr's documents: an array as its ``zarr.json`` describes it, and back. Nothing of it touches a store."""

from functools import lru_cache
from typing import Any

import zarr
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

KEY = "zarr.json"


def description(**array: Any) -> bytes:
    """The ``zarr.json`` of an array made with these arguments of ``zarr.create_array``."""
    store = MemoryStore()
    zarr.create_array(store, zarr_format=3, **array)
    return store._store_dict[KEY].to_bytes()


@lru_cache(maxsize=64)
def described(document: bytes) -> "zarr.Array[Any]":
    """The array that a ``zarr.json`` describes, without its chunks. Raises what Zarr makes of other documents.

    It is looked at before each new chunk, and Zarr takes as long for that as a small task for its light.
    """
    store = MemoryStore({KEY: default_buffer_prototype().buffer.from_bytes(document)})
    return zarr.open_array(store, mode="r", zarr_format=3)
