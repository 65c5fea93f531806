"""Mosaics of Siemens' MRI: one DICOM image whose tiles are the slices of a volume.

Source: nibabel's "DICOM mosaic" (doc/source/dicom/dicom_mosaic.rst): the position in the file is
that of a slice as large as the mosaic with the same centre.
"""

import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import library

COUNT_TAG = 0x0019100A
"""Siemens' private tag with the number of slices."""

MOSAIC_TAGS = (
    *(0x00190010, COUNT_TAG),
    *(0x00290010, 0x00290011, 0x00290012, 0x00291010, 0x00291110, 0x00291210),
)
"""Private tags that say how a mosaic is made: the count of its tiles, and Siemens' CSA header."""

MOSAIC_NOTE = "The image is a mosaic of {count} slices: they are shown as layers."


@dataclass(frozen=True)
class Tile:
    """Pixels of a mosaic: the first row and column, and how many there are of each."""

    row: int
    column: int
    rows: int
    columns: int

    def of(self, pixels: np.ndarray) -> np.ndarray:
        """Cut the tile out of the pixels (rows, columns) of a mosaic."""
        return pixels[self.row : self.row + self.rows, self.column : self.column + self.columns]


@dataclass(frozen=True)
class Mosaic:
    """The tiles of a mosaic, in the order of their slices, the position of the first one and the
    unit ``normal`` along which they follow, millimetres of a patient's left, posterior, superior;
    both are None if the file does not place them.
    """

    tiles: Sequence[Tile]
    position: np.ndarray | None
    normal: np.ndarray | None


def is_mosaic(header: Any) -> bool:
    """Return True if an image is a mosaic, by its type."""
    return "MOSAIC" in (header.get("ImageType") or ())


def plane_of(header: Any) -> tuple[int, int]:
    """Return rows and columns of a slice of an image, which of a mosaic is a tile."""
    across = math.ceil(math.sqrt(_count(header) or 1)) if is_mosaic(header) else 1
    return int(header.Rows) // across, int(header.Columns) // across


def mosaic_of(name: str, header: Any) -> Mosaic:
    """Read how an image is made of tiles. Raises VolumeError if it does not say of how many."""
    count = _count(header)
    across = math.ceil(math.sqrt(count))
    if not count or int(header.Rows) % across or int(header.Columns) % across:
        raise VolumeError(
            f"'{name}' is a mosaic that does not say of how many slices, as an anonymised one may: "
            "convert the scanner's files to NIfTI, by dcm2niix."
        )
    rows, columns = plane_of(header)
    tiles = [Tile(n // across * rows, n % across * columns, rows, columns) for n in range(count)]
    position = header.get("ImagePositionPatient")
    pose = header.get("ImageOrientationPatient")
    steps = header.get("PixelSpacing")
    if not position or not pose or not steps:
        return Mosaic(tiles, None, None)
    along = np.array(pose, float).reshape(2, 3)
    corner = np.array([int(header.Columns) - columns, int(header.Rows) - rows]) / 2.0
    corner = corner * np.array(steps, float)[::-1]
    normal = np.cross(along[0], along[1])
    given = _normal(header)
    if given is not None and np.dot(given, normal) < 0.0:
        normal = -normal
    return Mosaic(tiles, np.array(position, float) + corner @ along, normal)


def _count(header: Any) -> int:
    """Read the number of slices, by the private tag, else by the CSA header; 0 if neither says
    it.
    """
    if COUNT_TAG in header:
        value = header[COUNT_TAG].value
        with suppress(TypeError, ValueError):
            return int.from_bytes(value, "little") if isinstance(value, bytes) else int(value)
    read = _csa(header)
    with suppress(KeyError, TypeError, ValueError):
        return int(_csa_reader().get_n_mosaic(read) or 0)
    return 0


def _normal(header: Any) -> np.ndarray | None:
    """Read the direction in which slices follow, by the CSA header; None if it does not say it."""
    read = _csa(header)
    with suppress(KeyError, TypeError, ValueError):
        found = _csa_reader().get_slice_normal(read)
        return None if found is None else np.asarray(found, float)
    return None


def _csa_reader() -> Any:
    """Load nibabel's reader of CSA headers, which warns that other parts of it are new."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return library("nibabel.nicom.csareader", "a mosaic")


def _csa(header: Any) -> Any:
    """Read Siemens' CSA header; empty if there is none."""
    if (0x0029, 0x0010) not in header:
        return {}
    try:
        return _csa_reader().get_csa_header(header) or {}
    except Exception:  # of many kinds, of damaged headers
        return {}
