"""Light probes of either kind: Radiance pictures (.hdr), and OpenEXR pictures (.exr).

OpenEXR: https://openexr.com/en/latest/OpenEXRFileLayout.html, read by the library of its authors.
"""

import io
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import LightError
from isogi_core.files.packed_files import open_regular, reason_of
from isogi_core.files.radiance import MAX_PIXELS, parse_hdr, read_hdr

EXR_MAGIC = b"\x76\x2f\x31\x01"
EXR_LIBRARY = "OpenEXR"
EXR_VERSION = (3, 5)
"""The library of OpenEXR, and the first version of it that reads files from memory."""

REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of red, green, blue and white that files have which name none."""

CHROMATICITY_ERROR = 0.002
"""Largest difference of a chromaticity that counts as rounding."""


def read_probe(path: Path) -> np.ndarray:
    """Read linear RGB radiance (h, w, 3) float32, row 0 at the top.

    Raises LightError as ``read_hdr`` and ``parse_exr`` do.
    """
    try:
        with open_regular(Path(path)) as file:
            data = file.read(len(EXR_MAGIC))
            if data == EXR_MAGIC:
                data += file.read()
    except OSError as error:
        raise LightError(
            f"The light '{path}' cannot be read ({reason_of(error)}): check its path."
        ) from error
    if data.startswith(EXR_MAGIC):
        return parse_exr(data, str(path))
    return read_hdr(path)


def parse_probe(data: bytes, path: str, most: int = MAX_PIXELS) -> np.ndarray:
    """Return the picture in the bytes of a file called ``path``, of ``most`` pixels at most; see
    ``read_probe``.
    """
    if data.startswith(EXR_MAGIC):
        return parse_exr(data, path, most)
    return parse_hdr(data, path, most)


def parse_exr(data: bytes, path: str, most: int = MAX_PIXELS) -> np.ndarray:
    """Return the picture in the bytes of an OpenEXR file called ``path``, linear RGB (h, w, 3)
    float32, of ``most`` pixels at most.

    Its channels R, G and B, or Y alone, are read. Raises LightError if the library is missing or
    too old, or if the file is damaged, a cube map, of other primaries than Rec. 709, or without
    such channels.
    """
    library = _exr_library(path)
    # Judge the header before any pixel is read.
    _check_header(_opened(library, data, path, header_only=True), path, most)
    channels = {
        name: channel.pixels
        for name, channel in _opened(library, data, path).parts[0].channels.items()
    }
    names = next((names for names in ("RGB", "Y") if all(name in channels for name in names)), None)
    if names is None:
        found = ", ".join(sorted(channels)[:8])
        raise LightError(f"'{path}' has the channels {found}: save it with R, G and B.")
    picture = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    return np.ascontiguousarray(np.broadcast_to(picture, (*picture.shape[:2], 3)))


def _exr_library(path: str) -> Any:
    """Return the library of OpenEXR. Raises LightError, for a file called ``path``, if it is
    missing, or older than EXR_VERSION.
    """
    instead = "or save it as a Radiance picture, .hdr."
    try:
        library = import_module(EXR_LIBRARY)
    except ImportError as error:
        raise LightError(
            f"'{path}' is read by OpenEXR, which is not installed: pip install 'isogi[formats]', "
            f"{instead}"
        ) from error
    # Older ones read files by name alone, so that bytes would seem to be damaged.
    version = str(getattr(library, "__version__", "0"))
    if tuple(map(int, re.findall(r"\d+", version)[:2])) < EXR_VERSION:
        needed = ".".join(map(str, EXR_VERSION))
        raise LightError(
            f"'{path}' is read by OpenEXR {needed} or newer, and {version} is installed: "
            f"pip install --upgrade 'isogi[formats]', {instead}"
        )
    return library


def _opened(library: Any, data: bytes, path: str, header_only: bool = False) -> Any:
    """Return the library's file of these bytes. Raises LightError if it is damaged."""
    try:
        found = library.File(io.BytesIO(data), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise LightError(f"'{path}' is damaged or cut short: copy it again.") from error
    if not found.parts:
        raise LightError(f"The pixels of '{path}' are damaged or cut short: copy it again.")
    return found


def _check_header(file: Any, path: str, most: int) -> None:
    """Raise LightError unless the header of a file is that of a picture of light in Rec. 709, of
    ``most`` pixels at most.
    """
    header = file.parts[0].header
    first, last = header["dataWindow"]
    width, height = (int(size) for size in np.asarray(last, np.int64) - first + 1)
    if width * height > most:
        raise LightError(
            f"'{path}' has {width} × {height} pixels, and {most} are the most that may be: "
            "make it smaller."
        )
    if "CUBE" in str(header.get("envmap", "")):
        raise LightError(f"'{path}' is a cube map: save it as latitude and longitude.")
    given = np.ravel(header.get("chromaticities", REC_709))
    if np.abs(given - REC_709).max() > CHROMATICITY_ERROR:
        raise LightError(f"'{path}' has colours of other primaries: save it in Rec. 709 (sRGB).")
