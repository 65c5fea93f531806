"""Blocks for cards that were packed before: each is folded, filtered and compressed once, for all
visitors.
"""

import hashlib
import threading
import zlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

from isogi_core.cache.scene_caches import Loader
from isogi_core.lru_cache import LruCache
from isogi_core.prepared.prepared_scene import Index

LEVEL = 1
"""Compression: of voxels and light higher levels save a tenth of the bytes, and take four times as
long.
"""

DIGEST_BYTES = 16
"""Bytes that name the data of a part."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a binary answer; what is found when it is first asked for is kept."""

    data: bytes

    @cached_property
    def deflated(self) -> bytes:
        """The ``data`` as raw DEFLATE (RFC 1951) that ends at a whole byte: such parts may follow
        each other.
        """
        packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
        return packer.compress(self.data) + packer.flush(zlib.Z_FULL_FLUSH)

    @cached_property
    def digest(self) -> bytes:
        """What names the ``data``."""
        return hashlib.blake2b(self.data, digest_size=DIGEST_BYTES).digest()

    @property
    def nbytes(self) -> int:
        """Bytes that it takes; before it is compressed it is counted as twice its data."""
        return 2 * len(self.data)


@dataclass(frozen=True, eq=False)
class Block(Part):
    """A block of a chunk at a ``version``; the versions of the chunks ``beside`` it that its light
    is filtered by.
    """

    version: bytes = b""
    beside: Mapping[Index, bytes] = field(default_factory=dict)


class Packed(NamedTuple):
    """The ``blocks`` of chunks."""

    blocks: tuple[Block, ...]

    @property
    def versions(self) -> tuple[bytes, ...]:
        """How far each chunk is baked."""
        return tuple(each.version for each in self.blocks)

    @property
    def alone(self) -> bool:
        """Whether each version stands for its block alone. What was filtered depends on chunks
        beside it, too.
        """
        return not any(each.beside for each in self.blocks)


class KnownBlocks:
    """The newest blocks of a scene, within a limit of bytes. Any thread may ask."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` bytes."""
        self._kept: LruCache[Any] = LruCache(most)
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes that the blocks take."""
        return self._kept.nbytes

    def find(
        self,
        kind: Hashable,
        chunks: Sequence[Index],
        loader: Loader,
        make: Callable[[Sequence[Index]], Packed],
        check: Callable[[], object],
    ) -> Packed:
        """The blocks of ``chunks``, of some ``kind``: what light they are under, and when texels
        are final.

        Blocks that are not kept, or whose chunks were baked on since, are made by ``make``; for all
        that ask meanwhile too. Raises what ``make`` and ``Loader.ensure`` raise.
        """
        with self._lock:
            held = ((at, self._kept.held((kind, at))) for at in dict.fromkeys(chunks))
            known: dict[Index, Block] = {at: block for at, block in held if block is not None}
            around = tuple(
                dict.fromkeys(
                    [*chunks, *chain.from_iterable(each.beside for each in known.values())]
                )
            )
            loader.ensure(around, check)
            now = dict(zip(around, loader.pool.versions(around), strict=True))
            found = {
                at: self._keep((kind, at), each)
                for at, each in known.items()
                if is_current(at, each, now)
            }
            lacking = [at for at in dict.fromkeys(chunks) if at not in found]
            made = make(lacking).blocks if lacking else ()
            for at, block in zip(lacking, made, strict=True):
                self._kept.drop((kind, at))
                found[at] = self._keep((kind, at), block)
        return Packed(tuple(found[at] for at in chunks))

    def _keep(self, key: Hashable, block: Block) -> Block:
        """The block, the newest of all that are kept."""
        return self._kept.get(key, lambda: block)


def is_current(at: Index, block: Block, now: Mapping[Index, bytes]) -> bool:
    """Whether nothing was baked on that a ``block`` shows of the chunk ``at``, by the versions of
    chunks ``now``.
    """
    return block.version == now[at] and block.beside.items() <= now.items()
