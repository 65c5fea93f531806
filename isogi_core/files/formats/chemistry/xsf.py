"""XCrySDen's files: XSF, fields in real space with x as the fastest, and BXSF, energies of bands in
reciprocal space with z as the fastest.

Both hold general grids: the last plane along each axis lies at the end of the grid's vectors, and
is the first one again if these are vectors of the lattice. Format:
http://www.xcrysden.org/doc/XSF.html.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry.cube import ANGSTROM
from isogi_core.files.formats.chemistry.sets import pick_set, read_z_fastest
from isogi_core.files.formats.chemistry.text import Text, text_of
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Affine, Grid, Periodic, Shape, read_as

_START = re.compile(
    rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*[ \t]*(?:ANIMSTEPS|CRYSTAL|SLAB|POLYMER|MOLECULE|DIM-GROUP|"
    rb"PRIMVEC|CONVVEC|ATOMS|BEGIN_INFO|BEGIN_BLOCK_(?:DATA|BAND)GRID)",
)
_GRID = re.compile(rb"^[ \t]*(?:BEGIN_)?DATAGRID_?3D_?([^\s]*)[^\n]*\n", re.MULTILINE)
_BANDS = re.compile(rb"^[ \t]*(?:BEGIN_)?BANDGRID_?3D_?([^\s]*)[^\n]*\n", re.MULTILINE)
_BAND = re.compile(rb"BAND:[ \t]*(\d+)[^\n]*\n")
_VECTORS = re.compile(
    rb"^[ \t]*(CRYSTAL|SLAB|POLYMER|MOLECULE|PRIMVEC|(?:BEGIN_BLOCK_|BEGIN_)?DATAGRID_?3D)[^\n]*\n",
    re.MULTILINE,
)
_FERMI = re.compile(rb"Fermi[ \t]+Energy[ \t]*[:=]?[ \t]*([-+\d.eEdD]+)", re.IGNORECASE)
_INFO_END = re.compile(rb"BEGIN_BLOCK_BANDGRID")

LATTICE_TOLERANCE = 1e-3
"""How far the vectors of a grid may be off those of the lattice, in its vectors."""

PERIODIC_AXES = {b"CRYSTAL": 3, b"SLAB": 2, b"POLYMER": 1}
"""Vectors of the lattice along which a structure repeats."""


def is_xsf(head: bytes) -> bool:
    """Return True if a file begins as XCrySDen's do."""
    return _START.match(head) is not None


@dataclass(frozen=True)
class Frame:
    """The place of a general grid: its ``shape`` along x, y, z, its ``origin``, and its
    ``vectors``, rows (3, 3).
    """

    shape: tuple[int, int, int]
    origin: np.ndarray
    vectors: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """The map from indices to the world, (3, 4)."""
        steps = self.vectors / np.maximum(np.array(self.shape) - 1, 1)[:, None]
        return np.column_stack([steps.T, self.origin])


@reader("XSF", "part", "channel")
def open_xsf(source: Source) -> Grid:
    """Open one grid of a file of XCrySDen; headers are read now, and the text is searched for
    further grids. Raises VolumeError.
    """
    with text_of(source) as text:
        names = _names(text)
    if not names:
        return _open_bands(source)
    chosen, notes = pick_set(source, names, "grids")
    with text_of(source) as text:
        lattice, repeating = read_lattice(text)
    with text_of(source) as text:
        frame = read_frame(text, chosen)
    periodic = along_lattice(frame.vectors, lattice, repeating)
    nx, ny, nz = (n - closed for n, closed in zip(frame.shape, periodic, strict=True))
    source.check((nz, ny, nx))
    if min(nx, ny, nz) < 1:
        raise VolumeError(f"'{source.name}' has one plane along an axis: write it again.")
    shape = (nz, ny, nx)
    slabs = partial(_slabs, source, chosen, shape)
    grid = general_grid(source, frame, shape, slabs)
    known = read_as("XSF", grid.dtype, PLACED_BY)
    return replace(grid, unit=ANGSTROM, notes=notes, periodic=periodic, read_as=known)


PLACED_BY = "its origin and vectors"


def general_grid(
    source: Source, frame: Frame, shape: Shape, slabs: Callable[[], Iterator[np.ndarray]]
) -> Grid:
    """Return the grid of a ``shape`` (z, y, x) whose values lie in a ``frame``."""
    spacing = tuple(np.linalg.norm(frame.matrix[:, :3], axis=0).tolist())
    affine = Affine.of(frame.matrix)
    return Grid(shape, np.dtype(np.float64), spacing, slabs, source.stamp, affine)


def _names(text: Text) -> tuple[str, ...]:
    """Return the names of the grids of a file; their places if two have the same one or one has
    none.
    """
    found = []
    while (grid := text.find(_GRID)) is not None:
        found.append(grid[1].decode("latin-1"))
    if len({*found}) < len(found) or (len(found) > 1 and "" in found):
        return tuple(str(place) for place in range(1, len(found) + 1))
    return tuple(found)


def read_lattice(text: Text) -> tuple[np.ndarray | None, int]:
    """Return the vectors of the lattice as rows (3, 3), None without them, and the number of those
    along which the structure repeats.
    """
    repeating = 0
    while (found := text.find(_VECTORS)) is not None and b"GRID" not in found[1]:
        if found[1] == b"PRIMVEC":
            rows = np.array([text.reals(3, "a vector of the lattice") for _ in range(3)])
            return rows, repeating or 3
        repeating = PERIODIC_AXES.get(found[1], 0)
    return None, 0


def along_lattice(vectors: np.ndarray, lattice: np.ndarray | None, repeating: int) -> Periodic:
    """Return for each axis of a grid of these ``vectors`` True if the grid is a whole period of the
    ``lattice`` along it.
    """
    if lattice is None or abs(np.linalg.det(lattice)) == 0.0:
        return (False, False, False)
    parts = vectors @ np.linalg.inv(lattice)
    whole = np.abs(parts - np.round(parts)).max(axis=1) <= LATTICE_TOLERANCE
    inside = np.abs(parts[:, repeating:]).max(axis=1, initial=0.0) <= LATTICE_TOLERANCE
    x, y, z = (bool(each) for each in whole & inside & (np.round(np.abs(parts)).max(axis=1) > 0))
    return x, y, z


def read_frame(text: Text, chosen: int) -> Frame:
    """Find a grid by its place, and read on after its sizes, origin and vectors."""
    for _ in range(chosen + 1):
        if text.find(_GRID) is None:
            raise VolumeError(f"'{text.name}' changed while it was read: open it again.")
    return _frame(text)


def _frame(text: Text) -> Frame:
    nx, ny, nz = text.whole_numbers(3, "the sizes of a grid")
    if min(nx, ny, nz) < 1:
        raise VolumeError(
            f"'{text.name}' has sizes {(nx, ny, nz)}, which cannot be: write it again."
        )
    origin = np.array(text.reals(3, "the origin of a grid"))
    vectors = np.array([text.reals(3, "a vector of a grid") for _ in range(3)])
    return Frame((nx, ny, nz), origin, vectors)


def _slabs(source: Source, chosen: int, shape: tuple[int, int, int]) -> Iterator[np.ndarray]:
    """Yield the layers of a grid without the planes that repeat the first ones."""
    with text_of(source) as text:
        frame = read_frame(text, chosen)
        left = shape[0]
        for slab in text.slabs((frame.shape[2], frame.shape[1], frame.shape[0])):
            kept = slab[:left, : shape[1], : shape[2]]
            left -= len(kept)
            if len(kept):
                yield kept


def _open_bands(source: Source) -> Grid:
    """Open the energies of one band, by default the first that crosses the Fermi energy."""
    with text_of(source) as text:
        fermi = read_fermi(text)
    with text_of(source) as text:
        if text.find(_BANDS) is None:
            raise VolumeError(
                f"'{source.name}' holds a structure and no grid in three dimensions: give a file "
                "with a DATAGRID_3D."
            )
        count = text.whole_numbers(1, "the number of bands")[0]
        frame = _frame(text)
        nx, ny, nz = frame.shape
        source.check((nz, ny, nx))
        names, crossing = _read_bands(text, count, frame, fermi)
    first = crossing[0] if crossing else 0
    chosen, notes = pick_set(source, names, "bands")
    if "part" not in source.chosen and "channel" not in source.chosen:
        chosen = first
        notes = _of_bands(names, crossing, first)
    x, y, z = (n > 1 for n in frame.shape)
    shape = (nz - z, ny - y, nx - x)
    grid = general_grid(source, frame, shape, partial(_band_slabs, source, chosen, shape))
    known = read_as("BXSF", grid.dtype, PLACED_BY)
    return replace(grid, notes=notes, periodic=(x, y, z), level=fermi, read_as=known)


def _of_bands(names: tuple[str, ...], crossing: list[int], first: int) -> tuple[str, ...]:
    """Return a note that lists the bands, as none was chosen."""
    if len(names) == 1:
        return ()
    crossed = ", ".join(names[place] for place in crossing) or "none of them"
    return (
        f"The file holds bands {', '.join(names)}; the Fermi energy lies in {crossed}. Band "
        f"{names[first]} is shown, and #{names[(first + 1) % len(names)]} after the file's name "
        "chooses another.",
    )


def read_fermi(text: Text) -> float | None:
    """Return the Fermi energy in the unit of the bands; None if the file names none before its
    bands, or no finite number.
    """
    found = text.find(_FERMI)
    if found is None:
        return None
    try:
        energy = float(found[1].replace(b"D", b"E"))
    except ValueError:
        return None
    return energy if math.isfinite(energy) else None


MOST_BANDS = 4096


def _read_bands(
    text: Text, count: int, frame: Frame, fermi: float | None
) -> tuple[tuple[str, ...], list[int]]:
    """Read ``count`` bands of a BXSF file, each with one energy for every point of the ``frame``.

    Returns their names, and the numbers, from 0, of those whose energies lie on both sides of the
    Fermi energy; none if that is unknown. Raises VolumeError if bands are missing.
    """
    if not 0 < count <= MOST_BANDS:
        raise VolumeError(f"'{text.name}' has {count} bands, which cannot be: write it again.")
    names, crossing = [], []
    for place in range(count):
        found = text.find(_BAND)
        if found is None:
            raise VolumeError(f"'{text.name}' has {place} of its {count} bands: copy it again.")
        names.append(found[1].decode("latin-1"))
        low, high = math.inf, -math.inf
        for block in text.numbers(math.prod(frame.shape)):
            low, high = min(low, float(block.min())), max(high, float(block.max()))
        if fermi is not None and low < fermi < high:
            crossing.append(place)
    return tuple(names), crossing


def _band_slabs(source: Source, chosen: int, shape: tuple[int, int, int]) -> Iterator[np.ndarray]:
    with text_of(source) as text:
        text.find(_BANDS)
        text.line()
        frame = _frame(text)
        for _ in range(chosen + 1):
            text.find(_BAND)
        yield read_z_fastest(text, frame.shape)[: shape[0], : shape[1], : shape[2]]
