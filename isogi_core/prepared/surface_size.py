"""Area of an isosurface, and the volume that it encloses: sums over the tetrahedra of each cell.

Within a tetrahedron the field is linear between the corners, so that area and share are known in closed form (Doi and
Koide, "An efficient method of triangulating equi-valued surfaces by using tetrahedral cells", IEICE Trans. E74, 1991).
Errors fall by four where steps fall by two (Richardson): half the steps within cells tell how much is left to the
trilinear surface, and every other voxel tells how much the voxels themselves leave open.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.model.volume import Isovalue
from isogi_core.prepared.isosurface_mesh import CELL_CORNERS, cells_of

SUMMED_CELLS = 1 << 12
"""Cells whose tetrahedra are summed together."""

MAX_TRIED_CELLS = 1 << 16
"""Cells in which half the steps are tried: of more, evenly spread ones are."""

TETRAHEDRON_CORNERS = np.array([(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)])
"""Corners of the six tetrahedra of a cell, along its edges from the first corner to the last (Kuhn)."""

HALF_STEP_PLACES = np.array([[x, y, z] for z in (0, 0.5, 1) for y in (0, 0.5, 1) for x in (0, 0.5, 1)])
"""Places of a cell's corners and of those half-way between them."""

EIGHTHS = (CELL_CORNERS[:, None] + CELL_CORNERS) @ np.array([1, 3, 9])
"""Numbers in HALF_STEP_PLACES of the corners of each eighth of a cell (8, 8)."""


@dataclass(frozen=True)
class SurfaceSize:
    """``area`` and ``volume`` in the world's units, squared and cubed, each with how much it may be off.

    They are of the trilinear surface between the voxels. Its distance from a smooth surface through the same voxels is
    in the errors. ``is_open`` is whether the solid reaches a side of the volume, where it is taken to end.
    """

    area: float
    area_error: float
    volume: float
    volume_error: float
    is_open: bool


def surface_size(voxels: np.ndarray, isovalue: Isovalue, matrix: np.ndarray) -> SurfaceSize:
    """The size of the surface of ``voxels`` (nz, ny, nx) at a normalised isovalue; solid is what lies above.

    ``matrix`` (3, 3) takes steps between voxels, x first, to the world. Cells beside a voxel that is NaN have no
    surface, and are not solid.
    """
    level, even = float(isovalue), voxels[tuple(slice(n - 1 + n % 2) for n in voxels.shape)]
    finer = _finer(voxels, level, matrix)
    every_other = _plain(even[::2, ::2, ::2], level, 2.0 * matrix)  # reaches as far as the even voxels
    size = _plain(voxels, level, matrix) + 4.0 / 3.0 * finer
    error = (np.abs(finer) + np.abs(_plain(even, level, matrix) - every_other)) / 3.0
    return SurfaceSize(float(size[0]), float(error[0]), float(size[1]), float(error[1]), _reaches(voxels, level))


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


def _sums(voxels: np.ndarray, cells: np.ndarray, level: float, matrix: np.ndarray, halves: bool = False) -> np.ndarray:
    """Area, and volume above a level, (2,), in ``cells`` (n, 3) by their tetrahedra, or by those of their eighths."""
    total = np.zeros(2)
    for start in range(0, len(cells), SUMMED_CELLS):
        some = cells[start : start + SUMMED_CELLS]
        corners = np.stack([voxels[tuple((some + corner).T[::-1])] for corner in CELL_CORNERS], axis=1).astype(
            np.float64
        )
        total += _cut(_halved(corners), level, matrix / 2.0) if halves else _cut(corners, level, matrix)
    return total


def _reaches(voxels: np.ndarray, level: float) -> bool:
    """Whether what lies above a level reaches a side of the volume."""
    sides = (voxels[0], voxels[-1], voxels[:, 0], voxels[:, -1], voxels[..., 0], voxels[..., -1])
    return any(bool((side > level).any()) for side in sides)


def _halved(corners: np.ndarray) -> np.ndarray:
    """The corners (8 n, 8) of the eight halves of cells with these ``corners`` (n, 8)."""
    weights = np.where(CELL_CORNERS[None] == 1, HALF_STEP_PLACES[:, None], 1.0 - HALF_STEP_PLACES[:, None]).prod(axis=2)
    return (corners @ weights.T)[:, EIGHTHS].reshape(-1, 8)


def _cut(corners: np.ndarray, level: float, matrix: np.ndarray) -> np.ndarray:
    """Area, and volume above a level, (2,), of the tetrahedra of all cells with these ``corners`` (n, 8)."""
    values = corners[:, TETRAHEDRON_CORNERS].reshape(-1, 4) - level
    above = (values > 0.0).sum(axis=1)
    area, share = 0.0, float((above == 4).sum())
    for count, cut in ((1, _tip), (2, _wedge), (3, _foot)):
        some = np.flatnonzero(above == count)
        order = np.argsort(-values[some], axis=1)
        places = (CELL_CORNERS @ matrix.T)[TETRAHEDRON_CORNERS[(some % len(TETRAHEDRON_CORNERS))[:, None], order]]
        found = cut(np.take_along_axis(values[some], order, axis=1).T, places.transpose(1, 0, 2))
        area, share = area + found[0], share + found[1]
    return np.array([area, share * abs(np.linalg.det(matrix)) / len(TETRAHEDRON_CORNERS)])


def _tip(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra whose first corner alone is above zero.

    ``values`` (4, n) fall; ``corners`` are (4, n, 3).
    """
    shares = values[0] / (values[0] - values[1:])
    sides = shares[..., None] * (corners[1:] - corners[0])
    return 0.5 * _length(np.cross(sides[1] - sides[0], sides[2] - sides[0])), float(shares.prod(axis=0).sum())


def _foot(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra whose last corner alone is not above zero."""
    area, below = _tip(-values[::-1], corners[::-1])
    return area, values.shape[1] - below


def _wedge(values: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """Sums of area and share above of tetrahedra of whose corners two are above zero."""
    (a, b), (c, d) = values[:2], values[2:]
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
