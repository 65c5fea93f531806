"""Meshes of isosurfaces: surface nets, whose vertices are then moved onto the trilinear surface that rays meet.

A vertex for each cell that the surface passes, a quadrilateral for each edge that it crosses. Source: Gibson,
"Constrained elastic surface nets", MICCAI 1998.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.model.volume import Isovalue

MESH_BATCH_CELLS = 1 << 16
"""Cells whose vertices are found together."""

NEWTON_STEPS = 6
"""Newton steps from the mean of a cell's crossings onto the surface."""

CELL_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
CELLS_AROUND_EDGES = np.array(
    [[[0, -1, -1], [0, 0, -1], [0, 0, 0], [0, -1, 0]], [[-1, 0, -1], [-1, 0, 0], [0, 0, 0], [0, 0, -1]]]
)
RING = np.concatenate([CELLS_AROUND_EDGES, [[[-1, -1, 0], [0, -1, 0], [0, 0, 0], [-1, 0, 0]]]])
"""For an edge along x, y, z, the four cells around it, anticlockwise as the edge's end sees them; offsets x, y, z."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """``vertices`` (n, 3) float32 in index space, x first; ``quads`` (m, 4) int32, anticlockwise from outside.

    The diagonal from the first to the third corner divides a quadrilateral.
    """

    vertices: np.ndarray
    quads: np.ndarray


def isosurface_mesh(voxels: np.ndarray, isovalue: Isovalue) -> Mesh:
    """The mesh of the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue, two layers at a time.

    Solid is what lies above. Cells beside a voxel that is NaN have no surface.
    """
    level, (cells, _) = float(isovalue), cells_of(voxels, float(isovalue))
    corners = np.stack([voxels[tuple((cells + corner).T[::-1])] for corner in CELL_CORNERS], axis=1).astype(np.float64)
    starts = range(0, len(cells), MESH_BATCH_CELLS)
    inside = [_settled(corners[start : start + MESH_BATCH_CELLS], level) for start in starts]
    vertices = cells + np.concatenate([np.zeros((0, 3)), *inside])
    quads = _quads(cells, corners > level, voxels.shape)
    first, second = vertices[quads[:, 0]] - vertices[quads[:, 2]], vertices[quads[:, 1]] - vertices[quads[:, 3]]
    turned = (second**2).sum(axis=1) < (first**2).sum(axis=1)  # the shorter diagonal divides
    quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
    return Mesh(vertices.astype(np.float32), quads.astype(np.int32))


def vertex_count(voxels: np.ndarray, isovalue: Isovalue) -> int:
    """How many vertices the mesh of a surface has, and about as many quadrilaterals; see ``isosurface_mesh``."""
    return len(cells_of(voxels, float(isovalue))[0])


def cells_of(voxels: np.ndarray, level: float) -> tuple[np.ndarray, int]:
    """Indices (n, 3; x, y, z) of the cells that a surface passes, z ascending; and how many lie above it as a whole.

    Cells beside a voxel that is NaN are neither.
    """
    found, solid = [], 0
    for z in range(len(voxels) - 1):
        slab = voxels[z : z + 2]
        inside, gone = _around(slab > level), _around(np.isnan(slab))
        y, x = np.nonzero((inside > 0) & (inside < 8) & (gone == 0))
        found.append(np.column_stack([x, y, np.full(len(x), z)]))
        solid += int((inside == 8).sum())
    return np.concatenate(found), solid


def _around(slab: np.ndarray) -> np.ndarray:
    """How many corners of each cell between two layers (2, ny, nx) are true; (ny - 1, nx - 1)."""
    layers = slab.astype(np.int8).sum(axis=0)
    return np.asarray(layers[:-1, :-1] + layers[1:, :-1] + layers[:-1, 1:] + layers[1:, 1:])


def _settled(corners: np.ndarray, level: float) -> np.ndarray:
    """Places (n, 3) in the unit cells of ``corners`` (n, 8), on the trilinear surface or as near as steps come."""
    one, other = corners[:, EDGES[:, 0]], corners[:, EDGES[:, 1]]
    crossed = (one > level) != (other > level)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crossed, (level - one) / (other - one), 0.0)
    ends = CELL_CORNERS[EDGES[:, 0]] + share[..., None] * (CELL_CORNERS[EDGES[:, 1]] - CELL_CORNERS[EDGES[:, 0]])
    place = (ends * crossed[..., None]).sum(axis=1) / crossed.sum(axis=1)[:, None]
    for _ in range(NEWTON_STEPS):
        value, slope = _trilinear(corners, place)
        square = (slope**2).sum(axis=1)
        step = np.divide(level - value, square, out=np.zeros_like(value), where=square > 0.0)
        place = np.clip(place + step[:, None] * slope, 0.0, 1.0)
    return place


def _trilinear(corners: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (n,) and gradient (n, 3) of the trilinear field of ``corners`` (n, 8) at a ``place`` (n, 3)."""
    factors = np.where(CELL_CORNERS[None] == 1, place[:, None], 1.0 - place[:, None])
    value = (corners * factors.prod(axis=2)).sum(axis=1)
    slopes = [
        (corners * (2 * CELL_CORNERS[:, axis] - 1) * np.delete(factors, axis, axis=2).prod(axis=2)).sum(axis=1)
        for axis in range(3)
    ]
    return value, np.stack(slopes, axis=1)


def _quads(cells: np.ndarray, inside: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers (m, 4) of the vertices around each edge that is crossed, anticlockwise from outside."""
    stride = np.array([1, shape[2], shape[1] * shape[2]])
    keys, quads = cells @ stride, []
    for axis in range(3):
        crossed = np.flatnonzero(inside[:, 0] != inside[:, 1 << axis])
        beside = keys[crossed, None] + RING[axis] @ stride
        place = np.minimum(np.searchsorted(keys, beside), len(keys) - 1)
        whole = (keys[place] == beside).all(axis=1) & (cells[crossed][:, np.arange(3) != axis] > 0).all(axis=1)
        found = place[whole]
        outwards = inside[crossed[whole], 0]
        quads.append(np.where(outwards[:, None], found, found[:, ::-1]))
    return np.concatenate(quads)
