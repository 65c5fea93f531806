"""Meshes of isosurfaces: surface nets, whose vertices are then moved onto the trilinear surface
that rays meet.

A vertex for each cell that the surface passes, a quadrilateral for each edge that it crosses.
Source: Gibson, "Constrained elastic surface nets", MICCAI 1998.

Area of an isosurface, and the volume that it encloses: sums over the tetrahedra of each cell.
Within a tetrahedron the field is linear between the corners, so that area and share are known in
closed form (Doi and Koide, "An efficient method of triangulating equi-valued surfaces by using
tetrahedral cells", IEICE Trans. E74, 1991). Errors fall by four where steps fall by two
(Richardson): half the steps within cells tell how much is left to the trilinear surface, and every
other voxel tells how much the voxels themselves leave open.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.kernels.tracing.extents import fill_row_ends
from isogi_core.kernels.tracing.field import Field
from isogi_core.model.volume import Isovalue

MESH_BATCH_CELLS = 1 << 16
"""Cells whose vertices are found together."""

MAX_HULL_ROWS = 1 << 15
"""Ends of rows up to which all count in ``outermost_points``: a voxel is a hundredth there."""

NEWTON_STEPS = 6
"""Newton steps from the mean of a cell's crossings onto the surface."""

CELL_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
CELLS_AROUND_EDGES = np.array(
    [
        [[0, -1, -1], [0, 0, -1], [0, 0, 0], [0, -1, 0]],
        [[-1, 0, -1], [-1, 0, 0], [0, 0, 0], [0, 0, -1]],
    ]
)
RING = np.concatenate([CELLS_AROUND_EDGES, [[[-1, -1, 0], [0, -1, 0], [0, 0, 0], [-1, 0, 0]]]])
"""For an edge along x, y, z, the four cells around it, anticlockwise as the edge's end sees them;
offsets x, y, z.
"""


@dataclass(frozen=True, eq=False)
class Mesh:
    """``vertices`` (n, 3) float32 in index space, x first; ``quads`` (m, 4) int32, anticlockwise
    from outside.

    The diagonal from the first to the third corner divides a quadrilateral.
    """

    vertices: np.ndarray
    quads: np.ndarray


def isosurface_mesh(voxels: np.ndarray, isovalue: Isovalue) -> Mesh:
    """The mesh of the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue, two layers at a
    time.

    Solid is what lies above. Cells beside a voxel that is NaN have no surface.
    """
    level = float(isovalue)
    (cells, _) = cells_of(voxels, float(isovalue))
    corners = _corners_of(voxels, cells)
    starts = range(0, len(cells), MESH_BATCH_CELLS)
    inside = [_settled(corners[start : start + MESH_BATCH_CELLS], level) for start in starts]
    vertices = cells + np.concatenate([np.zeros((0, 3)), *inside])
    quads = _quads(cells, corners > level, voxels.shape)
    first = vertices[quads[:, 0]] - vertices[quads[:, 2]]
    second = vertices[quads[:, 1]] - vertices[quads[:, 3]]
    turned = (second**2).sum(axis=1) < (first**2).sum(axis=1)  # the shorter diagonal divides
    quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
    return Mesh(vertices.astype(np.float32), quads.astype(np.int32))


def vertex_count(voxels: np.ndarray, isovalue: Isovalue) -> int:
    """How many vertices the mesh of a surface has, and about as many quadrilaterals; see
    ``isosurface_mesh``.
    """
    return len(cells_of(voxels, float(isovalue))[0])


def cells_of(voxels: np.ndarray, level: float) -> tuple[np.ndarray, int]:
    """Indices (n, 3; x, y, z) of the cells that a surface passes, z ascending; and how many lie
    above it as a whole.

    Cells beside a voxel that is NaN are neither.
    """
    found = []
    solid = 0
    for z in range(len(voxels) - 1):
        slab = voxels[z : z + 2]
        inside = _around(slab > level)
        gone = _around(np.isnan(slab))
        y, x = np.nonzero((inside > 0) & (inside < 8) & (gone == 0))
        found.append(np.column_stack([x, y, np.full(len(x), z)]))
        solid += int((inside == 8).sum())
    return np.concatenate(found), solid


def outermost_points(field: Field, isovalue: Isovalue) -> np.ndarray:
    """Points (n, 3) of an isosurface in index space, x first, that have its convex hull.

    They are on edges of the first and the last cell of each row along x that holds the surface. Of
    more than MAX_HULL_ROWS rows those are left out whose neighbours along y or z reach as far on
    both sides: the hull is then right to less than a voxel.
    """
    nz, ny, _ = field.voxels.shape
    ends = np.empty((2, nz - 1, ny - 1), np.int32)
    fill_row_ends(field.voxels, field.low, field.high, float(isovalue), ends)
    found = []
    for cells, inwards in zip(ends, (1.0, -1.0), strict=True):
        reach = np.where(cells < 0, np.inf, inwards * cells)
        padded = np.pad(reach, 1, constant_values=np.inf)
        along_y = padded[1:-1, :-2] + padded[1:-1, 2:]
        along_z = padded[:-2, 1:-1] + padded[2:, 1:-1]
        kept = np.isfinite(reach)
        if ends.size > MAX_HULL_ROWS:
            kept &= 2.0 * reach < np.minimum(along_y, along_z)
        z, y = np.nonzero(kept)
        found.append(np.column_stack([cells[z, y], y, z]))
    cells = np.concatenate(found)
    corners = _corners_of(field.voxels, cells)
    places, crossed = edge_crossings(corners, float(isovalue))
    return np.asarray((cells[:, None] + places)[crossed])


def _corners_of(voxels: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """The voxels at the corners of ``cells`` (n, 3), (n, 8) float64."""
    return np.stack(
        [voxels[tuple((cells + corner).T[::-1])] for corner in CELL_CORNERS], axis=1
    ).astype(np.float64)


def _around(slab: np.ndarray) -> np.ndarray:
    """How many corners of each cell between two layers (2, ny, nx) are true; (ny - 1, nx - 1)."""
    layers = slab.astype(np.int8).sum(axis=0)
    return np.asarray(layers[:-1, :-1] + layers[1:, :-1] + layers[:-1, 1:] + layers[1:, 1:])


def _settled(corners: np.ndarray, level: float) -> np.ndarray:
    """Places (n, 3) in the unit cells of ``corners`` (n, 8), on the trilinear surface or as near as
    steps come.
    """
    ends, crossed = edge_crossings(corners, level)
    place = (ends * crossed[..., None]).sum(axis=1) / crossed.sum(axis=1)[:, None]
    for _ in range(NEWTON_STEPS):
        value, slope = _trilinear(corners, place)
        square = (slope**2).sum(axis=1)
        step = np.divide(level - value, square, out=np.zeros_like(value), where=square > 0.0)
        place = np.clip(place + step[:, None] * slope, 0.0, 1.0)
    return place


def edge_crossings(corners: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 12, 3) in the unit cell where a surface crosses the edges of cells with these
    ``corners`` (n, 8), and which edges it crosses, (n, 12).
    """
    one, other = corners[:, EDGES[:, 0]], corners[:, EDGES[:, 1]]
    crossed = (one > level) != (other > level)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crossed, (level - one) / (other - one), 0.0)
    ends = CELL_CORNERS[EDGES[:, 0]] + share[..., None] * (
        CELL_CORNERS[EDGES[:, 1]] - CELL_CORNERS[EDGES[:, 0]]
    )
    return ends, crossed


def _trilinear(corners: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (n,) and gradient (n, 3) of the trilinear field of ``corners`` (n, 8) at a ``place``
    (n, 3).
    """
    factors = np.where(CELL_CORNERS[None] == 1, place[:, None], 1.0 - place[:, None])
    value = (corners * factors.prod(axis=2)).sum(axis=1)
    slopes = [
        (
            corners
            * (2 * CELL_CORNERS[:, axis] - 1)
            * np.delete(factors, axis, axis=2).prod(axis=2)
        ).sum(axis=1)
        for axis in range(3)
    ]
    return value, np.stack(slopes, axis=1)


def _quads(cells: np.ndarray, inside: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers (m, 4) of the vertices around each edge that is crossed, anticlockwise from
    outside.
    """
    stride = np.array([1, shape[2], shape[1] * shape[2]])
    keys = cells @ stride
    quads = []
    for axis in range(3):
        crossed = np.flatnonzero(inside[:, 0] != inside[:, 1 << axis])
        beside = keys[crossed, None] + RING[axis] @ stride
        place = np.minimum(np.searchsorted(keys, beside), len(keys) - 1)
        whole = (keys[place] == beside).all(axis=1) & (
            cells[crossed][:, np.arange(3) != axis] > 0
        ).all(axis=1)
        found = place[whole]
        outwards = inside[crossed[whole], 0]
        quads.append(np.where(outwards[:, None], found, found[:, ::-1]))
    return np.concatenate(quads)


SUMMED_CELLS = 1 << 12
"""Cells whose tetrahedra are summed together."""

MAX_TRIED_CELLS = 1 << 16
"""Cells in which half the steps are tried: of more, evenly spread ones are."""

TETRAHEDRON_CORNERS = np.array(
    [(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)]
)
"""Corners of the six tetrahedra of a cell, along its edges from the first corner to the last
(Kuhn).
"""

HALF_STEP_PLACES = np.array(
    [[x, y, z] for z in (0, 0.5, 1) for y in (0, 0.5, 1) for x in (0, 0.5, 1)]
)
"""Places of a cell's corners and of those half-way between them."""

EIGHTHS = (CELL_CORNERS[:, None] + CELL_CORNERS) @ np.array([1, 3, 9])
"""Numbers in HALF_STEP_PLACES of the corners of each eighth of a cell (8, 8)."""


@dataclass(frozen=True)
class SurfaceSize:
    """``area`` and ``volume`` in the world's units, squared and cubed, each with how much it may be
    off.

    They are of the trilinear surface between the voxels. Its distance from a smooth surface through
    the same voxels is in the errors. ``is_open`` is whether the solid reaches a side of the volume,
    where it is taken to end.
    """

    area: float
    area_error: float
    volume: float
    volume_error: float
    is_open: bool


def surface_size(
    voxels: np.ndarray,
    isovalue: Isovalue,
    matrix: np.ndarray,
    periodic: tuple[bool, bool, bool] = (False, False, False),
) -> SurfaceSize:
    """The size of the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue; solid is what
    lies above.

    ``matrix`` (3, 3) takes steps between voxels, x first, to the world. Cells beside a voxel that
    is NaN have no surface, and are not solid. Sides across axes that are ``periodic`` are open to
    themselves alone.
    """
    level = float(isovalue)
    even = voxels[tuple(slice(n - 1 + n % 2) for n in voxels.shape)]
    finer = _finer(voxels, level, matrix)
    every_other = _plain(
        even[::2, ::2, ::2], level, 2.0 * matrix
    )  # reaches as far as the even voxels
    size = _plain(voxels, level, matrix) + 4.0 / 3.0 * finer
    error = (np.abs(finer) + np.abs(_plain(even, level, matrix) - every_other)) / 3.0
    return SurfaceSize(
        float(size[0]),
        float(error[0]),
        float(size[1]),
        float(error[1]),
        _reaches(voxels, level, periodic),
    )


def _plain(voxels: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Area, and volume above a level, (2,), by the tetrahedra of the cells."""
    cells, solid = cells_of(voxels, level)
    return _sums(voxels, cells, level, matrix) + np.array([0.0, solid * abs(np.linalg.det(matrix))])


def _finer(voxels: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """By how much area and volume are greater, (2,), by tetrahedra of eighths of the cells."""
    cells, _ = cells_of(voxels, level)
    some = cells[:: len(cells) // MAX_TRIED_CELLS + 1]
    more = _sums(voxels, some, level, matrix, halves=True) - _sums(voxels, some, level, matrix)
    return more * len(cells) / max(len(some), 1)


def _sums(
    voxels: np.ndarray, cells: np.ndarray, level: float, matrix: np.ndarray, halves: bool = False
) -> np.ndarray:
    """Area, and volume above a level, (2,), in ``cells`` (n, 3) by their tetrahedra, or by those of
    their eighths.
    """
    total = np.zeros(2)
    for start in range(0, len(cells), SUMMED_CELLS):
        some = cells[start : start + SUMMED_CELLS]
        corners = _corners_of(voxels, some)
        if halves:
            total += _cut(_halved(corners), level, matrix / 2.0)
        else:
            total += _cut(corners, level, matrix)
    return total


def _reaches(voxels: np.ndarray, level: float, periodic: tuple[bool, bool, bool]) -> bool:
    """Whether what lies above a level reaches a side of the volume, but for those across axes that
    are ``periodic``.
    """
    return any(
        bool((side > level).any())
        for axis, along in enumerate(periodic[::-1])
        if not along
        for side in np.moveaxis(voxels, axis, 0)[[0, -1]]
    )


def _halved(corners: np.ndarray) -> np.ndarray:
    """The corners (8 n, 8) of the eight halves of cells with these ``corners`` (n, 8)."""
    weights = np.where(
        CELL_CORNERS[None] == 1, HALF_STEP_PLACES[:, None], 1.0 - HALF_STEP_PLACES[:, None]
    ).prod(axis=2)
    return (corners @ weights.T)[:, EIGHTHS].reshape(-1, 8)


def _cut(corners: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Area, and volume above a level, (2,), of the tetrahedra of all cells with these ``corners``
    (n, 8).
    """
    values = corners[:, TETRAHEDRON_CORNERS].reshape(-1, 4) - level
    above = (values > 0.0).sum(axis=1)
    area = 0.0
    share = float((above == 4).sum())
    for count, cut in ((1, _tip), (2, _wedge), (3, _foot)):
        some = np.flatnonzero(above == count)
        order = np.argsort(-values[some], axis=1)
        places = (CELL_CORNERS @ matrix.T)[
            TETRAHEDRON_CORNERS[(some % len(TETRAHEDRON_CORNERS))[:, None], order]
        ]
        found = cut(np.take_along_axis(values[some], order, axis=1).T, places.transpose(1, 0, 2))
        area = area + found[0]
        share = share + found[1]
    return np.array([area, share * abs(np.linalg.det(matrix)) / len(TETRAHEDRON_CORNERS)])


def _tip(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra whose first corner alone is above zero.

    ``values`` (4, n) fall; ``corners`` are (4, n, 3).
    """
    shares = values[0] / (values[0] - values[1:])
    sides = shares[..., None] * (corners[1:] - corners[0])
    return 0.5 * _length(np.cross(sides[1] - sides[0], sides[2] - sides[0])), float(
        shares.prod(axis=0).sum()
    )


def _foot(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra whose last corner alone is not above zero."""
    area, below = _tip(-values[::-1], corners[::-1])
    return area, values.shape[1] - below


def _wedge(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra of whose corners two are above zero."""
    (a, b) = values[:2]
    (c, d) = values[2:]
    ac, ad, bc, bd = a / (a - c), a / (a - d), b / (b - c), b / (b - d)
    points = [
        corners[i] + share[:, None] * (corners[j] - corners[i])
        for i, j, share in ((0, 2, ac), (0, 3, ad), (1, 2, bc), (1, 3, bd))
    ]
    area = 0.5 * _length(np.cross(points[3] - points[0], points[2] - points[1]))
    return area, float((ac * ad * (1.0 - bd) + ac * (1.0 - bc) * bd + bc * bd).sum())


def _length(vectors: np.ndarray) -> float:
    """The sum of the lengths of ``vectors`` (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1)).sum())
