"""Objects of chunks: what is not whole is noticed, whichever byte of it."""

import numpy as np
import pytest

from isogi_core.errors import DamagedChunkError
from isogi_core.storage.store import unwrap, unwrap_all, wrap

RNG = np.random.default_rng(3)
RECORD = RNG.integers(0, 9, 200).astype(np.uint8)


def test_a_record_comes_back_from_its_object() -> None:
    for record in (RECORD, np.zeros(5000, np.uint8), RNG.integers(0, 256, 300).astype(np.uint8)):
        np.testing.assert_array_equal(unwrap(wrap(record), len(record)), record)


def test_every_bit_that_flips_is_noticed() -> None:
    stored = wrap(RECORD)
    for place in range(8 * len(stored)):
        broken = bytearray(stored)
        broken[place // 8] ^= 1 << place % 8
        with pytest.raises(DamagedChunkError):
            unwrap(bytes(broken), len(RECORD))


def test_an_object_that_is_cut_anywhere_is_noticed() -> None:
    stored = wrap(RECORD)
    for broken in (*(stored[:end] for end in range(len(stored))), stored + b"\0", bytes(len(stored))):
        with pytest.raises(DamagedChunkError):
            unwrap(broken, len(RECORD))


@pytest.mark.parametrize("size", [len(RECORD) - 1, len(RECORD) + 1, 0])
def test_a_record_of_another_layer_is_no_record(size: int) -> None:
    with pytest.raises(DamagedChunkError, match="does not unpack to a record"):
        unwrap(wrap(RECORD), size)


def test_one_damaged_object_of_many_is_noticed() -> None:
    records = RNG.integers(0, 9, (7, 64)).astype(np.uint8)
    stored = [wrap(record) for record in records]
    np.testing.assert_array_equal(unwrap_all(stored, 64), records)
    assert unwrap_all([], 64).shape == (0, 64)
    for broken in range(7):
        with pytest.raises(DamagedChunkError):
            unwrap_all([*stored[:broken], stored[broken][:-1], *stored[broken + 1 :]], 64)
