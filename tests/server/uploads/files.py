"""Files that clients upload."""

import io
from pathlib import Path
from typing import Any

import nrrd
import numpy as np

FIELDS = "type: uint8\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n"


def headed(fields: str = FIELDS, body: bytes = bytes(range(24)), magic: str = "NRRD0004") -> bytes:
    """A file of these header lines and bytes."""
    return f"{magic}\n{fields}\n".encode() + body


def ball(side: int = 12, **header: Any) -> bytes:
    """A ball in a cube of voxels, as pynrrd writes it."""
    z, y, x = np.mgrid[:side, :side, :side] - (side - 1) / 2.0
    file = io.BytesIO()
    values = (1.5 * side - np.sqrt(x**2 + y**2 + z**2)).astype(np.float32)
    nrrd.write(file, values, {"encoding": "raw", **header}, index_order="C")
    return file.getvalue()


def names(folder: Path) -> set[str]:
    """What stands in a folder, but for the lock."""
    return {path.name for path in folder.iterdir()} - {"lock"}
