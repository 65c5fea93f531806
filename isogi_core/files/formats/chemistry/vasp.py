"""VASP's grids in the cell of a crystal, x fastest: densities (CHGCAR, CHG, PARCHG, AECCAR), which
are divided by the volume of the cell, and LOCPOT and ELFCAR, which are not.

Format: https://www.vasp.at/wiki/CHGCAR, and the pages of the others.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry.cube import ANGSTROM
from isogi_core.files.formats.chemistry.sets import pick_set
from isogi_core.files.formats.chemistry.text import Text, text_of
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Affine, Grid, Shape, read_as

_REAL = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_VECTOR = rb"[ \t]*" + 2 * (_REAL + rb"[ \t]+") + _REAL + rb"[ \t]*\r?\n"
_HEAD = re.compile(
    rb"[^\n]*\n[ \t]*"
    + _REAL
    + rb"(?:[ \t]+"
    + _REAL
    + rb"){0,2}[ \t]*\r?\n"
    + 3 * _VECTOR
    + rb"(?:[ \t]*[A-Z][^\n]*\n)?[ \t]*\d+(?:[ \t]+\d+)*[ \t]*\r?\n"
)
"""A comment, a scale, three vectors, the names of elements if they are there, and their counts."""

POTENTIALS = ("LOCPOT", "ELFCAR", "POT")
"""Words in the names of files whose values are not multiplied by the volume of the cell."""

DENSITIES = ("CHG", "AECCAR", "DENS")

DENSITY_SETS = {2: ("total", "magnetization"), 4: ("total", "mx", "my", "mz")}
OTHER_SETS = {2: ("up", "down"), 4: ("total", "mx", "my", "mz")}
"""Names of the data sets of a file by their number: with spin, and non-collinear. Densities are of
both spins, and the difference of these; potentials and ELFs are of each spin.
"""

MOST_ATOMS = 1 << 24


def is_vasp(head: bytes) -> bool:
    """Return True if a file begins as VASP's grids do: with a crystal."""
    return _HEAD.match(head) is not None


@dataclass(frozen=True)
class Crystal:
    """The header of a file: the cell's vectors as the rows of ``cell`` (3, 3), and the ``shape`` of
    the grid, z, y, x.
    """

    cell: np.ndarray
    shape: Shape

    @property
    def volume(self) -> float:
        """The volume of the cell, Å³."""
        return float(abs(np.linalg.det(self.cell)))


@reader("VASP", "part", "channel")
def open_vasp(source: Source) -> Grid:
    """Open one data set of a grid of VASP; headers are read now, and the text is searched for
    further sets. Raises VolumeError.
    """
    with text_of(source) as text:
        crystal = read_header(text)
        source.check(crystal.shape)
        repeats = grid_line(crystal.shape)
        count = 1
        while text.find(repeats) is not None:
            count += 1
    divided, why = is_density(source.name)
    sets = DENSITY_SETS if divided else OTHER_SETS
    names = sets.get(count, tuple(map(str, range(1, count + 1))))
    chosen, notes = pick_set(source, names, "data sets")
    step = crystal.cell / np.array(crystal.shape[::-1])[:, None]
    scale = 1.0 / crystal.volume if divided else 1.0
    known = read_as(
        "VASP " + ("density" if divided else "potential"),
        np.dtype(np.float64),
        "the cell of its crystal",
        scale,
    )
    return Grid(
        crystal.shape,
        np.dtype(np.float64),
        tuple(np.linalg.norm(step, axis=1).tolist()),
        partial(_slabs, source, chosen, scale),
        source.stamp,
        Affine.of(np.column_stack([step.T, np.zeros(3)])),
        ANGSTROM,
        (*notes, why),
        read_as=known,
        periodic=(True, True, True),
    )


def is_density(name: str) -> tuple[bool, str]:
    """Return True if values of a file of this ``name`` are a density times the cell's volume, and a
    note that says so.
    """
    upper = name.replace("\\", "/").rpartition("/")[2].upper()
    if any(word in upper for word in POTENTIALS) and not any(w in upper for w in DENSITIES):
        return False, "The values are as they stand in the file, as of a potential or an ELF."
    if any(word in upper for word in DENSITIES):
        return True, "The values are divided by the volume of the cell, as of a density: e/Å³."
    return True, (
        "The values are taken for a density and divided by the volume of the cell: put LOCPOT or "
        "ELFCAR into the file's name if they are not one."
    )


def read_header(text: Text) -> Crystal:
    """Read the crystal, and the sizes of the first grid. Raises VolumeError."""
    text.line()
    scales = text.line().split()
    cell = np.array([text.reals(3, "a vector of the cell") for _ in range(3)])
    cell = scaled(text, cell, scales)
    counts = text.line().split()
    if counts and not counts[0].isdigit():
        counts = text.line().split()
    if not counts or not all(word.isdigit() for word in counts):
        raise VolumeError(f"'{text.name}' does not count its atoms: give a file of VASP.")
    atoms = sum(map(int, counts))
    if text.line()[:1].upper() == "S":  # selective dynamics
        text.line()
    if atoms > MOST_ATOMS:
        raise VolumeError(f"'{text.name}' has {atoms} atoms, which cannot be: write it again.")
    try:
        for _ in range(atoms):
            text.line()
        line = ""
        while not line:
            line = text.line()
        sizes = [int(word) for word in line.split()]
    except (VolumeError, ValueError):
        sizes = []
    if len(sizes) != 3 or min(sizes) < 1:
        raise VolumeError(
            f"'{text.name}' holds the atoms of a crystal and no grid: give a CHGCAR, LOCPOT, "
            "ELFCAR or PARCHG."
        )
    return Crystal(cell, (sizes[2], sizes[1], sizes[0]))


def scaled(text: Text, cell: np.ndarray, scales: list[str]) -> np.ndarray:
    """Return a ``cell`` in Å: times one scale, or one for each axis of the world, or with the
    volume that a negative scale gives.
    """
    try:
        factors = np.array([float(word) for word in scales if word[:1] in "+-.0123456789"])
    except ValueError:
        factors = np.zeros(0)
    volume = abs(float(np.linalg.det(cell)))
    if len(factors) not in (1, 3) or not np.isfinite(factors).all() or not volume > 0.0:
        raise VolumeError(f"The cell of '{text.name}' has no volume or no scale: write it again.")
    if len(factors) == 1 and factors[0] < 0.0:
        return np.asarray(cell * (-factors[0] / volume) ** (1.0 / 3.0))
    return np.asarray(cell * factors)


def grid_line(shape: Shape) -> "re.Pattern[bytes]":
    """Return a pattern of the line of sizes with which a further grid of this ``shape`` begins."""
    sizes = rb"[ \t]+".join(str(n).encode() for n in shape[::-1])
    return re.compile(rb"^[ \t]*" + sizes + rb"[ \t]*\r?\n", re.MULTILINE)


def _slabs(source: Source, chosen: int, scale: float) -> Iterator[np.ndarray]:
    with text_of(source) as text:
        crystal = read_header(text)
        repeats = grid_line(crystal.shape)
        for _ in range(chosen):
            if text.find(repeats) is None:
                raise VolumeError(f"'{source.name}' changed while it was read: open it again.")
        for slab in text.slabs(crystal.shape):
            yield slab * scale
