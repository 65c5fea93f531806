"""A parcel: an array that is written once to a store, one object a chunk, for whoever needs it elsewhere.

It is a plain Zarr v3 array. Its metadata come last, so that with them it is whole; a chunk that is damaged or gone is
told, and never read as zeros.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np
from zarr.codecs import Crc32cCodec, ZstdCodec

from isogi_core.cache.metadata import KEY, described, description
from isogi_core.cache.root import Root
from isogi_core.cache.troubles import one_line
from isogi_core.cache.wrapping import LEVEL, unwrap, wrap
from isogi_core.errors import ChangedError, DamagedChunkError, StoreError

Shape = tuple[int, ...]


class Parcel:
    """The array under a ``name`` in the store at ``root``. Raises StoreError."""

    def __init__(self, root: Root, name: str) -> None:
        """Ask for nothing yet."""
        self.root = root
        self.name = name

    def put(self, values: np.ndarray, chunk: Shape, facts: Mapping[str, Any]) -> None:
        """Write ``values`` in objects of at most ``chunk``, and the ``facts``, unless all of it is there.

        Two that write the same one at once do no harm: what they write is the same.
        """
        if self.root.get(f"{self.name}/{KEY}") is not None:
            return
        sides = tuple(min(most, n) for most, n in zip(chunk, values.shape, strict=True))
        for index in product(*(range(-(-n // side)) for n, side in zip(values.shape, sides, strict=True))):
            self._put(self._key(index), packed(values, sides, index))
        compressors = [ZstdCodec(level=LEVEL), Crc32cCodec()]
        form: dict[str, Any] = {"shape": values.shape, "chunks": sides, "dtype": values.dtype}
        told = description(**form, fill_value=0, compressors=compressors, attributes={"isogi": dict(facts)})
        self._put(f"{self.name}/{KEY}", told)

    def describe(self) -> tuple[Shape, Shape, np.dtype[Any], dict[str, Any]]:
        """Shape, shape of a chunk, type, and facts."""
        found = self.root.get(f"{self.name}/{KEY}")
        if found is None:
            raise StoreError(f"The workers need {self.name} of {self._where}, which lacks it: restart the server.")
        try:
            array = described(found.data)
            facts: Any = array.attrs.asdict()["isogi"]
            return array.shape, array.chunks, array.dtype, facts
        except Exception as error:  # what Zarr makes of other documents is of many kinds
            raise self.damaged(one_line(error)) from error

    def slabs(self) -> Iterator[np.ndarray]:
        """The array, a layer of chunks at a time."""
        shape, chunk, dtype, _ = self.describe()
        for z in range(-(-shape[0] // chunk[0])):
            slab = np.empty((min(chunk[0], shape[0] - z * chunk[0]), *shape[1:]), dtype)
            for rest in product(*(range(-(-n // side)) for n, side in zip(shape[1:], chunk[1:], strict=True))):
                part = slab[(slice(None), *(slice(i * n, (i + 1) * n) for i, n in zip(rest, chunk[1:], strict=True)))]
                block = self._block((z, *rest), chunk, dtype)
                part[...] = block[tuple(map(slice, part.shape))]
            yield slab

    def damaged(self, why: str) -> StoreError:
        """That what is kept is not what was written."""
        return StoreError(f"{self.name} in {self._where} is damaged ({why}): delete it, and restart the server.")

    @property
    def _where(self) -> str:
        return f"the store at {self.root.place}"

    def _key(self, index: Shape) -> str:
        return "/".join((self.name, "c", *map(str, index)))

    def _put(self, key: str, data: bytes) -> None:
        """Write an object, in place of one that is another."""
        try:
            self.root.put(key, data, None)
        except ChangedError:
            found = self.root.get(key)
            if found is None or found.data != data:
                with suppress(ChangedError):  # by one who writes the same
                    self.root.put(key, data, found)

    def _block(self, index: Shape, chunk: Shape, dtype: np.dtype[Any]) -> np.ndarray:
        """A chunk as it was written, whole also at the array's end."""
        found = self.root.get(self._key(index))
        if found is None:
            raise self.damaged(f"chunk {index} is missing")
        try:
            return unwrap(found.data, math.prod(chunk) * dtype.itemsize).view(dtype).reshape(chunk)
        except DamagedChunkError as error:
            raise self.damaged(f"chunk {index}: {error}") from error


def packed(values: np.ndarray, chunk: Shape, index: Shape) -> bytes:
    """The object of a chunk: its values, zeros beyond the array's end, packed, and a checksum."""
    part = values[tuple(slice(i * n, (i + 1) * n) for i, n in zip(index, chunk, strict=True))]
    block = np.zeros(chunk, values.dtype.newbyteorder("<"))
    block[tuple(map(slice, part.shape))] = part
    return wrap(block.reshape(-1).view(np.uint8))
