"""Gaussian cube: one or several scalar fields about a molecule, z fastest; lengths in bohr, or in
ångström if the counts are negative.

Format: https://gaussian.com/cubegen, and https://h5cube-spec.readthedocs.io/en/latest/cubeformat.html.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry.levels import level_in
from isogi_core.files.formats.chemistry.sets import pick_set, read_z_fastest
from isogi_core.files.formats.chemistry.text import Text, text_of
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Affine, Grid, read_as

BOHR = "bohr"
ANGSTROM = "Å"

_REAL = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_AXIS = rb"[ \t]*-?\d+" + 3 * (rb"[ \t]+" + _REAL)
_HEAD = re.compile(
    rb"[^\n]*\n[^\n]*\n" + _AXIS + rb"(?:[ \t]+\d+)?[ \t]*\r?\n" + 2 * (_AXIS + rb"[ \t]*\r?\n")
)
"""Two lines of comment, then atoms and origin, then counts and steps along the axes."""

MOST_ATOMS = 1 << 24


def is_cube(head: bytes) -> bool:
    """Return True if a file begins as a cube does."""
    return _HEAD.match(head) is not None


@dataclass(frozen=True)
class Cube:
    """The header of a cube: ``shape`` along its x, y, z, ``steps`` its axes' rows (3, 3), and the
    ``names`` of its fields, the numbers of orbitals if it has such.
    """

    shape: tuple[int, int, int]
    steps: np.ndarray
    origin: np.ndarray
    unit: str
    names: tuple[str, ...]
    level: float | None


@reader("Gaussian cube", "part", "channel")
def open_cube(source: Source) -> Grid:
    """Open one field of a cube as a grid: only the header is read now. Raises VolumeError.

    Its numbers lie with z as the fastest, so that all of them are in memory when they are read.
    """
    with text_of(source) as text:
        cube = read_header(text)
    field, notes = pick_set(source, cube.names, "fields")
    nx, ny, nz = cube.shape
    source.check((nz, ny, nx))
    return Grid(
        (nz, ny, nx),
        np.dtype(np.float64),
        tuple(np.linalg.norm(cube.steps, axis=1).tolist()),
        partial(_slabs, source, field),
        source.stamp,
        Affine.of(np.column_stack([cube.steps.T, cube.origin])),
        cube.unit,
        notes,
        read_as=read_as("Gaussian cube", np.dtype(np.float64), "its axes"),
        level=cube.level,
    )


def read_header(text: Text) -> Cube:
    """Read the header, up to the first number of the fields. Raises VolumeError."""
    comments = f"{text.line()} {text.line()}"
    first = text.words(4, "a number of atoms and an origin")
    atoms, *origin, each = _counts(text, " ".join(first[:5]))
    axes = [_counts(text, text.line()) for _ in range(3)]
    counts = [int(axis[0]) for axis in axes]
    if 0 in counts or abs(atoms) > MOST_ATOMS:
        raise VolumeError(f"'{text.name}' has counts {counts}, which cannot be: write it again.")
    for _ in range(abs(int(atoms))):
        text.line()
    names = tuple(str(n) for n in range(1, max(int(each), 1) + 1))
    if atoms < 0:
        names = _orbitals(text)
    return Cube(
        (abs(counts[0]), abs(counts[1]), abs(counts[2])),
        np.array([axis[1:4] for axis in axes]),
        np.array(origin),
        ANGSTROM if min(counts) < 0 else BOHR,
        names,
        level_in(comments),
    )


def _counts(text: Text, line: str) -> list[float]:
    """Return a whole number, three numbers and another whole number, 1 if it is not there."""
    words = line.split()
    try:
        count, last = int(words[0]), int(words[4]) if len(words) > 4 else 1
        x, y, z = (float(word.replace("D", "E").replace("d", "e")) for word in words[1:4])
    except (ValueError, IndexError) as error:
        raise VolumeError(
            f"'{text.name}' has '{line[:60]}' instead of a count and three lengths, as a Gaussian "
            "cube has them: give the file of a cube."
        ) from error
    if not np.isfinite([x, y, z]).all():
        raise VolumeError(f"'{text.name}' has '{line[:60]}', which is not finite: write it again.")
    return [count, x, y, z, last]


def _orbitals(text: Text) -> tuple[str, ...]:
    """Return the numbers of the orbitals that follow the atoms: first their count, then each, in
    one line or more. Some programs write negative atoms and no such list: the next line then is one
    of values.
    """
    line = text.line()
    words = line.split()
    if not all(word.lstrip("+-").isdigit() for word in words):
        text.put_back(line)
        return ("1",)
    while words and len(words) <= int(words[0]) <= MOST_ATOMS:
        words += text.words(1, "the numbers of orbitals")
    if not words or len(words) != int(words[0]) + 1:
        raise VolumeError(f"'{text.name}' lists its orbitals as '{' '.join(words)[:60]}': mend it.")
    return tuple(words[1:])


def _slabs(source: Source, field: int) -> Iterator[np.ndarray]:
    with text_of(source) as text:
        cube = read_header(text)
        yield read_z_fastest(text, cube.shape, field, len(cube.names))
