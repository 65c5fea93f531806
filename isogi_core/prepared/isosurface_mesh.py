"""Meshes of isosurfaces, and the area and volume of isosurfaces.

Meshes are surface nets whose vertices are then moved onto the trilinear surface that rays meet: a
vertex for each cell that the surface passes, and a quadrilateral for each edge that it crosses.
Source: Gibson, "Constrained elastic surface nets", MICCAI 1998.

Area and enclosed volume are sums over the tetrahedra of each cell. Within a tetrahedron the field
is linear between the corners, so that both are known in closed form. Source: Doi and Koide, "An
efficient method of triangulating equi-valued surfaces by using tetrahedral cells", IEICE Trans.
E74, 1991. The error falls by four if steps fall by two (Richardson): half steps within cells show
the distance left to the trilinear surface, and every other voxel shows the uncertainty of the
voxels themselves.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.kernels.tracing.extents import fill_row_ends
from isogi_core.kernels.tracing.field import Field
from isogi_core.model.volume import Isovalue

MESH_BATCH_CELLS = 1 << 16
"""Cells whose vertices are found together."""

MAX_HULL_ROWS = 1 << 15
"""Number of row ends up to which all count in ``outermost_points``: above it a voxel is about a
hundredth of the volume.
"""

NEWTON_STEPS = 6
"""Newton steps from the mean of a cell's edge crossings onto the surface."""

CELL_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
CELLS_AROUND_EDGES = np.array(
    [
        [[0, -1, -1], [0, 0, -1], [0, 0, 0], [0, -1, 0]],
        [[-1, 0, -1], [-1, 0, 0], [0, 0, 0], [0, 0, -1]],
    ]
)
RING = np.concatenate([CELLS_AROUND_EDGES, [[[-1, -1, 0], [0, -1, 0], [0, 0, 0], [-1, 0, 0]]]])
"""For an edge along x, y, z, the offsets x, y, z of the four cells around it, anticlockwise as
seen from the edge's end.
"""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh: ``vertices`` (n, 3) float32 in index space, x first, and ``quads`` (m, 4) int32,
    anticlockwise from outside.

    The diagonal from the first to the third corner divides a quadrilateral.
    """

    vertices: np.ndarray
    quads: np.ndarray


def isosurface_mesh(voxels: np.ndarray, isovalue: Isovalue) -> Mesh:
    """Return the mesh of the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue.

    The side above is solid. Cells next to a voxel that is NaN have no surface.
    """
    level = float(isovalue)
    # Place a vertex in each cell that the surface passes, and connect them around the edges that it
    # crosses.
    (cells, _) = cells_of(voxels, float(isovalue))
    corners = _corners_of(voxels, cells)
    starts = range(0, len(cells), MESH_BATCH_CELLS)
    inside = [_settled(corners[start : start + MESH_BATCH_CELLS], level) for start in starts]
    vertices = cells + np.concatenate([np.zeros((0, 3)), *inside])
    quads = _quads(cells, corners > level, voxels.shape)
    # Divide quadrilaterals by the shorter diagonal.
    first = vertices[quads[:, 0]] - vertices[quads[:, 2]]
    second = vertices[quads[:, 1]] - vertices[quads[:, 3]]
    turned = (second**2).sum(axis=1) < (first**2).sum(axis=1)
    quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
    return Mesh(vertices.astype(np.float32), quads.astype(np.int32))


def vertex_count(voxels: np.ndarray, isovalue: Isovalue) -> int:
    """Return the number of vertices of the mesh of a surface, which has about as many
    quadrilaterals; see ``isosurface_mesh``.
    """
    return len(cells_of(voxels, float(isovalue))[0])


def cells_of(voxels: np.ndarray, level: float) -> tuple[np.ndarray, int]:
    """Return the indices (n, 3; x, y, z) of the cells that a surface passes, z ascending, and the
    number of cells that lie completely above it.

    Cells next to a voxel that is NaN are neither.
    """
    found = [np.empty((0, 3), np.int64)]
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
    """Return points (n, 3) of an isosurface in index space, x first, whose convex hull is that of
    the surface.

    They are on edges of the first and the last cell of each row along x that holds the surface. If
    there are more than MAX_HULL_ROWS rows, the ends are left out whose neighbours along y or z
    reach at least as far on average: the hull is then right to less than a voxel.
    """
    nz, ny, _ = field.voxels.shape
    ends = np.empty((2, nz - 1, ny - 1), np.int32)
    fill_row_ends(field.voxels, field.low, field.high, float(isovalue), ends)
    found = []
    for cells, inwards in zip(ends, (1.0, -1.0), strict=True):
        # An end that lies inside of the line between its neighbours on both sides is no corner of
        # the hull.
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
    # Return the points at which the surface crosses the edges of these cells.
    corners = _corners_of(field.voxels, cells)
    places, crossed = edge_crossings(corners, float(isovalue))
    return np.asarray((cells[:, None] + places)[crossed])


def _corners_of(voxels: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the voxels at the corners of ``cells`` (n, 3); (n, 8) float64."""
    return np.stack(
        [voxels[tuple((cells + corner).T[::-1])] for corner in CELL_CORNERS], axis=1
    ).astype(np.float64)


def _around(slab: np.ndarray) -> np.ndarray:
    """Return the number of true corners of each cell between two layers (2, ny, nx); (ny - 1,
    nx - 1).
    """
    layers = slab.astype(np.int8).sum(axis=0)
    return np.asarray(layers[:-1, :-1] + layers[1:, :-1] + layers[:-1, 1:] + layers[1:, 1:])


def _settled(corners: np.ndarray, level: float) -> np.ndarray:
    """Return places (n, 3) in the unit cells of ``corners`` (n, 8), on the trilinear surface or
    as near as NEWTON_STEPS come.
    """
    ends, crossed = edge_crossings(corners, level)
    place = (ends * crossed[..., None]).sum(axis=1) / crossed.sum(axis=1)[:, None]
    # Step along the gradient to the level, and stay in the cell.
    for _ in range(NEWTON_STEPS):
        value, slope = _trilinear(corners, place)
        square = (slope**2).sum(axis=1)
        step = np.divide(level - value, square, out=np.zeros_like(value), where=square > 0.0)
        place = np.clip(place + step[:, None] * slope, 0.0, 1.0)
    return place


def edge_crossings(corners: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (n, 12, 3) in the unit cell at which a surface crosses the edges of
    cells with these ``corners`` (n, 8), and which edges it crosses, (n, 12) bool.
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
    """Return value (n,) and gradient (n, 3) of the trilinear field of ``corners`` (n, 8) at a
    ``place`` (n, 3).
    """
    # The weight of a corner is the product of its factors along all axes; its derivative along an
    # axis is ±1 in place of that axis' factor.
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
    """Return the numbers (m, 4) of the vertices around each edge that is crossed, anticlockwise
    from outside.

    ``cells`` (n, 3) have a vertex each and are sorted by z, y, x; ``inside`` (n, 8) marks their
    corners in the solid, and ``shape`` is that of the voxels.
    """
    # A key numbers the cells of the whole volume in the same order, so keys ascend, and a cell is
    # found by bisection.
    stride = np.array([1, shape[2], shape[1] * shape[2]])
    keys = cells @ stride
    quads = []
    for axis in range(3):
        # Each edge along this axis belongs to the cell that it is the first edge of.
        crossed = np.flatnonzero(inside[:, 0] != inside[:, 1 << axis])
        around = keys[crossed, None] + RING[axis] @ stride
        # Find the four cells around the edge; on the border of the volume, or next to a hole, some
        # are missing, and so is the quadrilateral. Edges at the low border are excluded by their
        # place: keys before it number no cells.
        place = np.minimum(np.searchsorted(keys, around), len(keys) - 1)
        whole = (keys[place] == around).all(axis=1) & (
            cells[crossed][:, np.arange(3) != axis] > 0
        ).all(axis=1)
        found = place[whole]
        # Turn it so that its front looks out of the solid.
        outwards = inside[crossed[whole], 0]
        quads.append(np.where(outwards[:, None], found, found[:, ::-1]))
    return np.concatenate(quads)


SUMMED_CELLS = 1 << 12
"""Cells whose tetrahedra are summed together."""

MAX_TRIED_CELLS = 1 << 16
"""Most cells in which half steps are tried: of more, an even sample is."""

TETRAHEDRON_CORNERS = np.array(
    [(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)]
)
"""Corners of the six tetrahedra of a cell, along its edges from the first corner to the last
(Kuhn's subdivision).
"""

HALF_STEP_PLACES = np.array(
    [[x, y, z] for z in (0, 0.5, 1) for y in (0, 0.5, 1) for x in (0, 0.5, 1)]
)
"""Places of a cell's corners and of the midpoints between them."""

EIGHTHS = (CELL_CORNERS[:, None] + CELL_CORNERS) @ np.array([1, 3, 9])
"""Numbers in HALF_STEP_PLACES of the corners of each eighth of a cell (8, 8)."""


@dataclass(frozen=True)
class SurfaceSize:
    """``area`` and ``volume`` in squared and cubed world units, with the estimated error of each.

    They are of the trilinear surface between the voxels; the errors include its distance from a
    smooth surface through the same voxels. ``is_open`` says that the solid reaches a side of the
    volume, where it is taken to end.
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
    """Measure the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue; the side above is
    solid.

    ``matrix`` (3, 3) maps steps between voxels, x first, to the world. Cells next to a voxel that
    is NaN have no surface, and are not solid. Sides across axes that are ``periodic`` are no border
    of the solid: the field goes on there.
    """
    level = float(isovalue)
    # All voxels are compared with every other one, which must reach as far: make the number along
    # each side odd, by dropping the last layer of even ones.
    odd_sided = voxels[tuple(slice(n - 1 + n % 2) for n in voxels.shape)]
    finer = _finer(voxels, level, matrix)
    every_other = _plain(odd_sided[::2, ::2, ::2], level, 2.0 * matrix)
    # Half steps remove 3/4 of the error: 4/3 of their difference is all of it (Richardson).
    size = _plain(voxels, level, matrix) + 4.0 / 3.0 * finer
    # The finer one of two results has an error of a third of their difference, as it removes 3/4 of
    # the other's: of half steps against whole ones, and of all voxels against every other one.
    error = (np.abs(finer) + np.abs(_plain(odd_sided, level, matrix) - every_other)) / 3.0
    return SurfaceSize(
        float(size[0]),
        float(error[0]),
        float(size[1]),
        float(error[1]),
        _reaches_border(voxels, level, periodic),
    )


def _plain(voxels: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Return the area, and the volume above a level, by the tetrahedra of the cells that the
    surface passes, and the volume of those above it; (2,).
    """
    cells, solid = cells_of(voxels, level)
    return _area_and_volume(voxels, cells, level, matrix) + np.array(
        [0.0, solid * abs(np.linalg.det(matrix))]
    )


def _finer(voxels: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Return the increase of area and volume if cells are divided into eighths; (2,). Many
    cells are sampled.
    """
    cells, _ = cells_of(voxels, level)
    some = cells[:: len(cells) // MAX_TRIED_CELLS + 1]
    more = _area_and_volume(voxels, some, level, matrix, halves=True) - _area_and_volume(
        voxels, some, level, matrix
    )
    return more * len(cells) / max(len(some), 1)


def _area_and_volume(
    voxels: np.ndarray, cells: np.ndarray, level: float, matrix: np.ndarray, halves: bool = False
) -> np.ndarray:
    """Return the area of the surface, in squared world units, and the volume above a level, in
    cubed ones; (2,). They are those in the listed ``cells`` (n, 3) alone.

    The cells' tetrahedra are summed, or those of their eighths if ``halves``.
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


def _reaches_border(voxels: np.ndarray, level: float, periodic: tuple[bool, bool, bool]) -> bool:
    """Return True if a voxel above the level is in the first or last layer along an axis.

    Axes x, y, z that are ``periodic`` do not count: the field goes on there.
    """
    return any(
        bool((side > level).any())
        for axis, repeats in enumerate(periodic[::-1])
        if not repeats
        for side in np.moveaxis(voxels, axis, 0)[[0, -1]]
    )


def _halved(corners: np.ndarray) -> np.ndarray:
    """Return the corners (8 n, 8) of the eight eighths of cells with these ``corners`` (n, 8),
    trilinear between them.
    """
    weights = np.where(
        CELL_CORNERS[None] == 1, HALF_STEP_PLACES[:, None], 1.0 - HALF_STEP_PLACES[:, None]
    ).prod(axis=2)
    return (corners @ weights.T)[:, EIGHTHS].reshape(-1, 8)


def _cut(corners: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Return the area, and the volume above a level, of the tetrahedra of all cells with these
    ``corners`` (n, 8); (2,).
    """
    values = corners[:, TETRAHEDRON_CORNERS].reshape(-1, 4) - level
    # A tetrahedron is cut by the number of its corners above the level; with four it is solid.
    above = (values > 0.0).sum(axis=1)
    area = 0.0
    share = float((above == 4).sum())
    for count, cut in ((1, _tip), (2, _wedge), (3, _foot)):
        some = np.flatnonzero(above == count)
        # Sort its corners by falling value, so that each kind has one formula.
        order = np.argsort(-values[some], axis=1)
        places = (CELL_CORNERS @ matrix.T)[
            TETRAHEDRON_CORNERS[(some % len(TETRAHEDRON_CORNERS))[:, None], order]
        ]
        found = cut(np.take_along_axis(values[some], order, axis=1).T, places.transpose(1, 0, 2))
        area = area + found[0]
        share = share + found[1]
    return np.array([area, share * abs(np.linalg.det(matrix)) / len(TETRAHEDRON_CORNERS)])


def _tip(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Return two sums over n tetrahedra of which one corner is above zero: the area of their cuts,
    and the share of each one's volume that is above.

    ``values`` (4, n) fall from corner to corner; ``corners`` (4, n, 3) are the corners' places.
    """
    # The surface cuts the three edges from the top corner, each at this share of its length. The
    # tip above the cut is a smaller tetrahedron: its share of the volume is the product of these.
    shares = values[0] / (values[0] - values[1:])
    from_top = shares[..., None] * (corners[1:] - corners[0])
    return 0.5 * _length(np.cross(from_top[1] - from_top[0], from_top[2] - from_top[0])), float(
        shares.prod(axis=0).sum()
    )


def _foot(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Return the same sums as ``_tip`` over tetrahedra of which three corners are above zero: all
    but a tip below zero is above. Arguments are as for ``_tip``.
    """
    area, below = _tip(-values[::-1], corners[::-1])
    return area, values.shape[1] - below


def _wedge(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Return the same sums as ``_tip`` over tetrahedra of which two corners are above zero.
    Arguments are as for ``_tip``.
    """
    (a, b) = values[:2]
    (c, d) = values[2:]
    # Places of the crossings on the four edges between the upper corners a, b and the lower c, d.
    ac, ad, bc, bd = a / (a - c), a / (a - d), b / (b - c), b / (b - d)
    points = [
        corners[i] + share[:, None] * (corners[j] - corners[i])
        for i, j, share in ((0, 2, ac), (0, 3, ad), (1, 2, bc), (1, 3, bd))
    ]
    # The cut is a planar quadrilateral: half the product of its diagonals.
    area = 0.5 * _length(np.cross(points[3] - points[0], points[2] - points[1]))
    # The part above is three tetrahedra: a with the crossings ac, ad, bd; a with ac, bc, bd; a and
    # b with bc, bd.
    return area, float((ac * ad * (1.0 - bd) + ac * (1.0 - bc) * bd + bc * bd).sum())


def _length(vectors: np.ndarray) -> float:
    """Return the sum of the lengths of ``vectors`` (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1)).sum())
