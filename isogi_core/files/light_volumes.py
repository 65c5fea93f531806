"""Volumes with values and light, in files of other tools: .vti, .nrrd, .nii.gz and OME-Zarr."""

import gzip
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import library
from isogi_core.files.ome import UNIT_WORDS
from isogi_core.storage.atomic_file import whole_folder, write_whole


@dataclass(frozen=True, eq=False)
class LitVolume:
    """``arrays`` of points by name, (nz, ny, nx) or (nz, ny, nx, k) each, in the world.

    ``affine`` (3, 4) brings indices to the world, whose ``unit`` of length is empty where unknown, and which is RAS
    in a ``patient``. ``fields`` are arrays (k, n) of no points, which VTK's files alone hold.
    """

    arrays: dict[str, np.ndarray]
    affine: np.ndarray
    unit: str = ""
    patient: bool = False
    fields: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def together(self) -> np.ndarray:
        """All arrays as one vector of floats at each point, (nz, ny, nx, k) float32."""
        parts = [array if array.ndim == 4 else array[..., None] for array in self.arrays.values()]
        return np.concatenate(parts, axis=-1, dtype="<f4", casting="same_kind")

    @property
    def names(self) -> list[str]:
        """A name for each number of that vector."""
        known = {"light": ["red", "green", "blue"]}
        sizes = {name: array.shape[3] if array.ndim == 4 else 0 for name, array in self.arrays.items()}
        return [
            each for name, k in sizes.items() for each in known.get(name, [f"{name} {n}" for n in range(k)] or [name])
        ]


def vti_bytes(lit: LitVolume) -> bytes:
    """An image file of VTK with arrays of points, bytes or floats, little-endian, raw at its end.

    Format: VTK's XML image data, version 1.0.
    """
    arrays, affine = lit.arrays, lit.affine
    steps = np.linalg.norm(affine[:, :3], axis=0)
    nz, ny, nx = next(iter(arrays.values())).shape[:3]
    extent = f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}"
    place = {
        "WholeExtent": extent,
        "Origin": _light_numbers(affine[:, 3]),
        "Spacing": _light_numbers(steps),
        "Direction": _light_numbers((affine[:, :3] / steps).ravel()),
    }
    rows: dict[str, str] = {}
    blocks: list[bytes] = []
    for name, array in (arrays | lit.fields).items():
        whole = array.dtype == np.uint8
        block = np.ascontiguousarray(array, "u1" if whole else "<f4").tobytes()
        parts, count = array.shape[-1] if array.ndim in (2, 4) else 1, len(array)
        kind = f'type="{"UInt8" if whole else "Float32"}" Name={quoteattr(name)} NumberOfComponents="{parts}"'
        kind += f' NumberOfTuples="{count}"' if name in lit.fields else ""
        rows[name] = f'<DataArray {kind} format="appended" offset="{sum(map(len, blocks))}"/>'
        blocks.append(np.array([len(block)], "<u8").tobytes() + block)
    attributes = " ".join(f'{name}="{value}"' for name, value in place.items())
    kind = 'type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    points = f"<PointData Scalars={quoteattr(next(iter(arrays)))}>{''.join(map(rows.pop, arrays))}</PointData>"
    fields = f"<FieldData>{''.join(rows.values())}</FieldData>" if rows else ""
    piece = f'<ImageData {attributes}>{fields}<Piece Extent="{extent}">{points}</Piece></ImageData>'
    head = f'<?xml version="1.0"?>\n<VTKFile {kind}>{piece}<AppendedData encoding="raw">_'
    return head.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>\n"


def nrrd_bytes(lit: LitVolume) -> bytes:
    """A NRRD file of arrays of points together: a vector of floats at each voxel, such as value, red, green, blue."""
    block, affine = lit.together, lit.affine
    directions = " ".join(f"({','.join(repr(float(x)) for x in column)})" for column in affine[:, :3].T)
    origin = ",".join(repr(float(x)) for x in affine[:, 3])
    lines = ["NRRD0005", "type: float", "dimension: 4", f"sizes: {' '.join(map(str, block.shape[::-1]))}"]
    lines += ["space: right-anterior-superior" if lit.patient else "space dimension: 3"]
    lines += [f"space directions: none {directions}", f"space origin: ({origin})"]
    lines += ["kinds: list domain domain domain", "endian: little", "encoding: raw", "", ""]
    return "\n".join(lines).encode() + block.tobytes()


MOST_NIFTI1 = 32767
"""Voxels along an axis of NIfTI-1, at most."""

NIFTI_UNITS = {"mm": "mm", "m": "meter", "µm": "micron"}


def nifti_bytes(lit: LitVolume) -> bytes:
    """A packed NIfTI file, one vector at each voxel (intent VECTOR), written by nibabel; its world is RAS.

    Raises VolumeError where nibabel is missing.
    """
    nib = nibabel()
    affine = np.vstack([lit.affine, [0.0, 0.0, 0.0, 1.0]])
    block = lit.together.transpose(2, 1, 0, 3)[:, :, :, None]
    kind = nib.Nifti1Image if max(block.shape) <= MOST_NIFTI1 else nib.Nifti2Image
    image = kind(block, affine)
    image.header.set_intent("vector")
    image.header.set_xyzt_units(NIFTI_UNITS.get(lit.unit, "unknown"))
    return gzip.compress(image.to_bytes(), 4, mtime=0)


def nibabel() -> Any:
    """The library that writes NIfTI. Raises VolumeError where it is missing."""
    return library("nibabel", "NIfTI")


def write_zarr(path: Path, lit: LitVolume) -> None:
    """An OME-Zarr image (NGFF 0.5) of one resolution, whose channels are the numbers of each point.

    Raises VolumeError as ``check_zarr`` does.
    """
    check_zarr(path, lit.affine)
    block, steps, origin = straightened(lit.together, lit.affine)
    space: dict[str, Any] = {"type": "space", **({"unit": UNIT_WORDS[lit.unit]} if lit.unit in UNIT_WORDS else {})}
    axes: list[Any] = [{"name": "c", "type": "channel"}, *({"name": name, **space} for name in "zyx")]
    placed: list[Any] = [
        {"type": "scale", "scale": [1.0, *steps[::-1]]},
        {"type": "translation", "translation": [0.0, *origin[::-1]]},
    ]
    image: dict[str, Any] = {
        "name": path.name,
        "axes": axes,
        "datasets": [{"path": "0", "coordinateTransformations": placed}],
    }
    chunks = (1, *(min(n, 128) for n in block.shape[:3]))
    with whole_folder(path) as partial:
        group = zarr.open_group(partial, mode="w", zarr_format=3)
        group.attrs["ome"] = {"version": "0.5", "multiscales": [image], "omero": {"channels": channels(lit)}}
        array = group.create_array(
            "0", shape=(block.shape[3], *block.shape[:3]), dtype="float32", chunks=chunks, dimension_names=tuple("czyx")
        )
        array[:] = np.moveaxis(block, 3, 0)


def check_zarr(path: Path, affine: np.ndarray) -> None:
    """Raise VolumeError where a volume does not lie along the world's axes, or the folder is there already."""
    if path.exists():
        raise VolumeError(f"{path} is there already: delete it, or name another.")
    sizes = np.abs(affine[:, :3])
    if (sizes.sum(axis=0) - sizes.max(axis=0)).max() > 1e-6 * sizes.max():
        raise VolumeError("OME-Zarr says no turns, and this volume lies obliquely: write .nii.gz, .vti or .nrrd.")


def channels(lit: LitVolume) -> list[dict[str, Any]]:
    """What viewers are told of the channels: name, colour and the range to show."""
    colours = {"red": "FF0000", "green": "00FF00", "blue": "0000FF"}
    value = next(iter(lit.arrays.values()))
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    spans = [(0.0, 1.0) if name in colours else (low, high) for name in lit.names]
    windows = [{"min": a, "max": b, "start": a, "end": b} for a, b in spans]
    return [
        {"label": name, "color": colours.get(name, "FFFFFF"), "window": window, "active": True}
        for name, window in zip(lit.names, windows, strict=True)
    ]


def straightened(block: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, list[float], list[float]]:
    """An array (nz, ny, nx, k) with its axes along the world's, the steps along x, y, z, and the first voxel's place.

    The ``affine`` turns by right angles.
    """
    matrix, origin = affine[:, :3], affine[:, 3].copy()
    steps, axes = np.abs(matrix).max(axis=0), np.abs(matrix).argmax(axis=0)
    order = [int(np.flatnonzero(axes == axis)[0]) for axis in range(3)]
    for column in range(3):
        if matrix[axes[column], column] < 0.0:
            block = np.flip(block, 2 - column)
            origin += matrix[:, column] * (block.shape[2 - column] - 1)
    turned = block.transpose(*(2 - order[axis] for axis in (2, 1, 0)), 3)
    return turned, [float(steps[each]) for each in order], [float(each) for each in origin]


Write = Callable[[Path, LitVolume], None]
WRITERS: dict[str, Write] = {
    ".vti": lambda path, lit: write_whole(path, vti_bytes(lit)),
    ".nrrd": lambda path, lit: write_whole(path, nrrd_bytes(lit)),
    ".nii.gz": lambda path, lit: write_whole(path, nifti_bytes(lit)),
    ".zarr": write_zarr,
}
"""What writes a volume, by the ending of its file's name."""


def _light_numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
