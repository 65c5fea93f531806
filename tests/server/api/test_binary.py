"""Parts of binary answers: each compressed once, together one member of gzip."""

import zlib

import numpy as np
import pytest

from isogi_core.frame.known_blocks import Part
from server.api.binary import gzipped

RNG = np.random.default_rng(1)


def noise(size: int) -> bytes:
    """Bytes that hardly compress."""
    return RNG.integers(0, 256, size, np.uint8).tobytes()


@pytest.mark.parametrize("data", [[], [b""], [b"light"], [noise(70_000), b"", bytes(70_000), noise(3)]])
def test_parts_are_one_member_of_gzip(data: list[bytes]) -> None:
    """Browsers read no second member; a reader checks the sum and the size at the end."""
    packed = gzipped([Part(each) for each in data])
    reader = zlib.decompressobj(16 + zlib.MAX_WBITS)
    assert reader.decompress(packed) + reader.flush() == b"".join(data)
    assert reader.eof and reader.unused_data == b""


def test_a_part_is_compressed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    pack = zlib.compressobj

    def counting(*options: int) -> object:
        made.append(1)
        return pack(*options)

    monkeypatch.setattr(zlib, "compressobj", counting)
    part, other = Part(bytes(1000)), Part(noise(1000))
    assert len(gzipped([part, other])) > len(gzipped([part, part])) and len(made) == 2
    assert part.digest == Part(bytes(1000)).digest != other.digest
