"""The wrapping of a record in the store: compressed, with the checksum of that at its end, as Zarr's codecs have it."""

from collections.abc import Sequence

import google_crc32c
import numpy as np
from numcodecs.zstd import Zstd

from isogi_core.errors import DamagedChunkError

CRC_BYTES = 4

LEVEL = 1
"""How hard Zstandard tries."""


def wrap(record: np.ndarray) -> bytes:
    """The object of a ``record``, (bytes,) uint8."""
    body = bytes(Zstd(level=LEVEL).encode(record))
    return body + checksum_of(body)


def unwrap(stored: bytes, size: int) -> np.ndarray:
    """The record in an object, (``size``,) uint8. DamagedChunkError says what is wrong with the object."""
    return unwrap_all([stored], size)[0]


def unwrap_all(stored: Sequence[bytes], size: int) -> np.ndarray:
    """The records in objects, (objects, ``size``) uint8; DamagedChunkError says what is wrong with any of them.

    Zstandard takes bodies one after another for one stream, and sets itself up once for all of them.
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
    """An object without its checksum; DamagedChunkError where that is wrong."""
    body, checksum = stored[:-CRC_BYTES], stored[-CRC_BYTES:]
    if len(stored) <= CRC_BYTES or checksum_of(body) != checksum:
        raise DamagedChunkError("its checksum is wrong")
    return body


def checksum_of(body: bytes) -> bytes:
    """The checksum that an object ends with."""
    return google_crc32c.value(body).to_bytes(CRC_BYTES, "little")
