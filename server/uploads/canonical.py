"""Canonical files: how uploaded volumes are kept. isogi alone writes them, all in the same way, as raw NRRD."""

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote, unquote

import numpy as np

TYPES = {
    **{f"{kind}{size}": f"{name}{8 * size}" for kind, name in (("i", "int"), ("u", "uint")) for size in (1, 2, 4, 8)},
    **{"f4": "float", "f8": "double"},
}
"""NRRD's names of types by NumPy's."""

HEADER = """\
NRRD0004
type: {type}
dimension: 3
sizes: {sizes}
encoding: raw
endian: little
spacings: {spacings}
name:={name}

"""
FORM = re.compile(
    rb"NRRD0004\ntype: (\w+)\ndimension: 3\nsizes: (\d+) (\d+) (\d+)\nencoding: raw\nendian: little\n"
    rb"spacings: [-+.e\d ]+\nname:=([!-~]*)\n\n",
    re.ASCII,
)
LONGEST = 4096
"""Bytes that no header is longer than."""

VOXEL = 4
"""Bytes of a voxel in the server's memory, where all are float32."""


@dataclass(frozen=True)
class Kept:
    """A volume in its canonical file: its ``id``, its ``name`` for a person, voxels along x, y, z, and bytes."""

    id: str
    name: str
    size: tuple[int, int, int]
    bytes: int

    @property
    def held(self) -> int:
        """Bytes that the volume takes, on disk or in memory, whichever is more: what the quota counts."""
        return max(self.bytes, VOXEL * math.prod(self.size))


def write(file: IO[bytes], array: np.ndarray, spacing: Sequence[float], name: str) -> str:
    """Write an array (z, y, x) as a canonical file; gives its id, a digest of all but the name.

    The name of what has none is made of the id.
    """
    voxels = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    facts = {
        "type": TYPES[voxels.dtype.str[1:]],
        "sizes": " ".join(str(n) for n in voxels.shape[::-1]),
        "spacings": " ".join(repr(float(step)) for step in spacing),
    }
    digest = hashlib.blake2b(HEADER.format(**facts, name="").encode(), digest_size=10)
    digest.update(voxels.data)
    number = digest.hexdigest()
    file.write(HEADER.format(**facts, name=quote(name or f"volume {number[:6]}", safe="")).encode())
    file.write(voxels.data)
    return number


def read_facts(path: Path) -> Kept | None:
    """What a file whose name is its id tells of itself; None where it is not as ``write`` left it."""
    with path.open("rb") as file:
        head = FORM.match(file.read(LONGEST))
    if head is None:
        return None
    kind, *sizes, name = (part.decode() for part in head.groups())
    x, y, z = map(int, sizes)
    kept = Kept(path.stem, unquote(name), (x, y, z), path.stat().st_size)
    widths = {name: int(code[1]) for code, name in TYPES.items()}
    whole = head.end() + widths.get(kind, 0) * math.prod(kept.size)
    return kept if kept.bytes == whole else None
