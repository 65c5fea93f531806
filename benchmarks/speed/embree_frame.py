"""A Lambert picture by Embree: tiles of primary rays on threads, shaded where they hit."""

import numpy as np
from numba import njit

from benchmarks.common.mesh import Mesh
from benchmarks.speed.embree import PACKET, Device, Tree
from isogi_core.frame.film import tone_table
from isogi_core.frame.tiles import Tiles

TILE = 1024 * PACKET // 4


@njit(nogil=True)
def lambert(hits, towards, table, picture):  # type: ignore[no-untyped-def]
    """Shade ``hits`` (4, n) by the cosine between the triangle's own normal and the light;
    ``picture`` (n, 3) uint8.
    """
    for m in range(picture.shape[0]):
        level = 0.0
        if hits[0, m] < np.inf:
            x, y, z = hits[1, m], hits[2, m], hits[3, m]
            cosine = (x * towards[0] + y * towards[1] + z * towards[2]) / np.sqrt(
                x * x + y * y + z * z
            )
            level = 0.1 + 0.6 * max(cosine, 0.0)
        picture[m, :] = table[int(level * (table.shape[0] - 1))]


class EmbreeFrame:
    """Pictures of meshes from one camera; its rays (3, n) float32 are given, and their making is
    not timed.
    """

    def __init__(
        self, origins: np.ndarray, directions: np.ndarray, towards: np.ndarray, tiles: Tiles
    ) -> None:
        """Keep the rays cut into tiles."""
        self.device = Device(tiles.threads)
        self.tiles = tiles
        self.towards = towards
        cuts = range(TILE, origins.shape[1], TILE)
        self.rays = [
            (np.ascontiguousarray(o), np.ascontiguousarray(d))
            for o, d in zip(np.split(origins, cuts, 1), np.split(directions, cuts, 1), strict=True)
        ]

    def picture(self, mesh: Mesh, quality: int) -> np.ndarray:
        """Build the tree of a mesh, and shade what the rays hit; (n, 3) uint8."""
        tree = Tree(self.device, *mesh, quality)
        picture = np.empty((sum(o.shape[1] for o, _ in self.rays), 3), np.uint8)

        def piece(a: int, b: int) -> None:
            for i in range(a, b):
                hits = tree.trace(self.device.sixteen, *self.rays[i])
                lambert(
                    hits, self.towards, tone_table(), picture[i * TILE : i * TILE + hits.shape[1]]
                )

        self.tiles.run(piece, len(self.rays), 1)
        tree.close()
        return picture
