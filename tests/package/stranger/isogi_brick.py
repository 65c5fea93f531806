"""Bricks: a line of words, voxels along x, y, z and their spacing, then a byte for each voxel."""

import json

import numpy as np

from isogi.plugins import (
    Grid,
    Kind,
    LitMesh,
    Source,
    VolumeError,
    Writer,
    marked,
    raw_slabs,
    reader,
)

READERS = [Kind("brick", marked(b"BRICK1 "), (".brick",), reader="isogi_brick:open_brick")]


@reader("brick")
def open_brick(source: Source) -> Grid:
    """Open a brick: only its first line is read now."""
    with source.unpacked() as file:
        line = file.readline(100)
    words = line.split()
    if len(words) != 7:
        raise VolumeError(f"'{source.name}' is cut off in its first line: write it again.")
    x, y, z = map(int, words[1:4])
    source.check((z, y, x))
    spacing = [float(word) for word in words[4:]]
    byte = np.dtype(np.uint8)
    return Grid(
        (z, y, x), byte, spacing, lambda: raw_slabs(source, len(line), (z, y, x), byte), unit="mm"
    )


def points_of(mesh: LitMesh) -> bytes:
    """Encode the places of a mesh and their light, a line each."""
    rows = np.column_stack([mesh.vertices, mesh.colours]).round(6).tolist()
    return "\n".join(json.dumps(row) for row in rows).encode()


WRITERS = [Writer(".points.json", "isogi_brick:points_of", vertex_bytes=90)]
