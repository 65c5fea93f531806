"""Blocks for cards that were packed before: each is folded, filtered and compressed once, for
all visitors.
"""

import hashlib
import threading
import zlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

from isogi_core.lru_cache import LruCache
from isogi_core.prepared.prepared_scene import Index

LEVEL = 1
"""Level of compression. Higher levels save a tenth of the bytes of voxels and light, and take
four times as long.
"""

DIGEST_BYTES = 16
"""Size of the name of a part's data."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a binary answer. Its compressed form and its name are found once, when first
    asked for.
    """

    data: bytes

    @cached_property
    def deflated(self) -> bytes:
        """The ``data`` as raw DEFLATE (RFC 1951) that ends at a whole byte, so that parts can
        be concatenated.
        """
        packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
        return packer.compress(self.data) + packer.flush(zlib.Z_FULL_FLUSH)

    @cached_property
    def digest(self) -> bytes:
        """A name of the ``data``."""
        return hashlib.blake2b(self.data, digest_size=DIGEST_BYTES).digest()

    @property
    def nbytes(self) -> int:
        """The bytes that it takes; before it is compressed it counts as twice its data."""
        return 2 * len(self.data)


@dataclass(frozen=True, eq=False)
class Block(Part):
    """A block of a chunk at a ``version``. ``around`` holds the versions of the chunks around
    it that its light was filtered by.
    """

    version: bytes = b""
    around: Mapping[Index, bytes] = field(default_factory=dict)


class Packed(NamedTuple):
    """The ``blocks`` of chunks."""

    blocks: tuple[Block, ...]

    @property
    def versions(self) -> tuple[bytes, ...]:
        """The version of each chunk, which tells how far it is baked."""
        return tuple(each.version for each in self.blocks)

    @property
    def alone(self) -> bool:
        """True if the version of each block alone identifies it: filtered blocks depend on the
        chunks around them, too.
        """
        return not any(each.around for each in self.blocks)


class KnownBlocks:
    """The newest blocks of a scene, within a limit of bytes. Safe to use from many threads."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` bytes."""
        self._kept: LruCache[Any] = LruCache(most)
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """The bytes that the blocks take."""
        return self._kept.nbytes

    def find(
        self,
        kind: Hashable,
        chunks: Sequence[Index],
        versions: Callable[[Sequence[Index]], Sequence[bytes]],
        make: Callable[[Sequence[Index]], Packed],
    ) -> Packed:
        """Return the blocks of ``chunks`` of some ``kind``: the light they are under, and the
        target error. ``versions`` returns those that some chunks have now.

        Blocks that are not kept, or whose chunks have been baked on, are made by ``make``. Other
        threads wait meanwhile, and find them. Raises the errors of ``make`` and of ``versions``.
        """
        with self._lock:
            # Collect the blocks that are kept, and all chunks that these depend on.
            held = ((at, self._kept.held((kind, at))) for at in dict.fromkeys(chunks))
            known: dict[Index, Block] = {at: block for at, block in held if block is not None}
            others = chain.from_iterable(block.around for block in known.values())
            around = tuple(dict.fromkeys([*chunks, *others]))
            # Keep those that no bake has outdated.
            now = dict(zip(around, versions(around), strict=True))
            found = {
                at: self._keep((kind, at), block)
                for at, block in known.items()
                if is_current(at, block, now)
            }
            # Make all others together.
            lacking = [at for at in dict.fromkeys(chunks) if at not in found]
            made = make(lacking).blocks if lacking else ()
            for at, block in zip(lacking, made, strict=True):
                self._kept.drop((kind, at))
                found[at] = self._keep((kind, at), block)
        return Packed(tuple(found[at] for at in chunks))

    def _keep(self, key: Hashable, block: Block) -> Block:
        """Keep a ``block`` as the newest of all, and return it."""
        return self._kept.get(key, lambda: block)


def is_current(at: Index, block: Block, now: Mapping[Index, bytes]) -> bool:
    """Return True if a ``block`` of the chunk ``at`` shows the present light of all chunks that
    it depends on, whose versions are ``now``.
    """
    return block.version == now[at] and block.around.items() <= now.items()
