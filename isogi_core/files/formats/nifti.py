"""NIfTI-1 and -2, one file or a pair, read by nibabel; voxels are streamed, as a packed file is read but once."""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import (
    LUMINANCE_NOTE,
    Source,
    library,
    luminance_of_colours,
    pick,
    pick_step,
    raw_slabs,
    reading,
)
from isogi_core.files.grid import PATIENT_AXES, Affine, Grid, Shape, read_as
from isogi_core.files.packing import Scaling

NIFTI_UNITS = {"mm": "mm", "meter": "m", "micron": "µm"}
UNPLACED_NOTE = "The file does not say how it lies: its axes are taken as they are."

LABELS = 1002
"""The intent of files whose values are labels."""

MAX_TRANSFORM_GAP = 0.01
"""Voxels by which two transforms of a file must differ for this to be told."""


def is_nifti(head: bytes) -> bool:
    """Whether a file begins as NIfTI does: the header's size, and its magic."""
    size = {head[:4], head[:4][::-1]}
    one = (348).to_bytes(4, "little") in size and head[344:348] in (b"n+1\0", b"ni1\0")
    return one or ((540).to_bytes(4, "little") in size and head[4:7] in (b"n+2", b"ni2"))


def open_nifti(source: Source) -> Grid:
    """Open a NIfTI file as a grid: only the header is read now. Raises VolumeError."""
    nib = library("nibabel", "NIfTI")
    source.refuse_others("time", "channel")
    with reading(source.name, "NIfTI"):
        header = _nifti_header(nib, source)
        shape, dtype = tuple(int(n) for n in header.get_data_shape()), header.get_data_dtype()
        scaling = scaling_of(header)
        (time, unchosen), channel, times, (nx, ny, nz) = frame_of(source, shape)
        source.check((nz, ny, nx))
        end = int(header.get_data_offset()) + math.prod(shape) * dtype.itemsize
        start = int(header.get_data_offset()) + (time + times * channel) * nx * ny * nz * dtype.itemsize
        voxels = _voxels_of(source, header)
        unit = NIFTI_UNITS.get(header.get_xyzt_units()[0], "")
        spacing = tuple(abs(float(step)) for step in header.get_zooms()[:3])
    others = [voxels.path] if voxels.path is not None and voxels.path != source.path else []
    slabs = partial(field_slabs, voxels, start, (nz, ny, nx), dtype, scaling)
    values = np.dtype(np.float32) if dtype.names else scaling.dtype(dtype)
    grid = Grid((nz, ny, nx), values, spacing, slabs, partial(source.stamp, *others), unit=unit)
    known = read_as("NIfTI", dtype, _placed_by(header), scaling.slope, scaling.intercept)
    labels = () if int(header["intent_code"]) == LABELS else None
    notes = (*((LUMINANCE_NOTE,) if dtype.names else ()), *voxels.cut_notes(end))
    return _placed_by_header(
        replace(grid, notes=notes, moment=(time, times), unchosen=unchosen, labels=labels, read_as=known), header
    )


def _nifti_header(nib: Any, source: Source) -> Any:
    """The header, of whichever version and byte order."""
    with source.unpacked() as file:
        head = file.read(348)
    one, pair = 348 in (int.from_bytes(head[:4], order) for order in ("little", "big")), b"ni" in head[4:8] + head[344:]
    if pair and source.path is None:
        raise VolumeError(f"'{source.name}' is a header whose voxels are in another file: save both as one .nii file.")
    kinds = nib.nifti1.Nifti1PairHeader, nib.nifti1.Nifti1Header, nib.Nifti2Header
    kind = nib.nifti2.Nifti2PairHeader if pair and not one else kinds[0] if pair else kinds[1] if one else kinds[2]
    with source.unpacked() as file:
        whole = file.read(kind.template_dtype.itemsize)
    return kind.from_fileobj(BytesIO(whole + bytes(4)))  # without extensions, which may claim any size


PAIR_ENDINGS = re.compile(r"\.(?:hdr|img)(\.gz|\.bz2)?$", re.IGNORECASE)
"""How the names of a pair of files end: that of the header, and that of the voxels."""


def beside(path: Path, end: str) -> Path | None:
    """The other file of a pair, whose name ends in ``.hdr`` or ``.img``; None where there is none."""
    stem = PAIR_ENDINGS.sub("", path.name)
    names = [f"{stem}{case}{packed}" for case in (end, end.upper()) for packed in ("", ".gz", ".bz2")]
    return next((found for name in names if (found := path.with_name(name)).is_file() and found != path), None)


def image_beside(source: Source) -> Path:
    """The file with the voxels of a header. VolumeError where there is none."""
    assert source.path is not None, "a pair has paths"
    found = beside(source.path, ".img")
    if found is None:
        wanted = PAIR_ENDINGS.sub("", source.path.name) + ".img"
        raise VolumeError(f"'{source.name}' is a header, and '{wanted}' with its voxels is not beside it.")
    return found


def _voxels_of(source: Source, header: Any) -> Source:
    """The file with the voxels: the source itself, or the other one of a pair."""
    return source if header.is_single or source.path is None else replace(source, path=image_beside(source))


def scaling_of(header: Any) -> Scaling:
    """Slope and intercept of one of nibabel's headers."""
    slope, intercept = header.get_slope_inter()
    if slope is None or slope == 0.0:
        return Scaling()
    return Scaling(float(slope), float(intercept or 0.0))


def frame_of(source: Source, shape: Shape) -> tuple[tuple[int, bool], int, int, tuple[int, int, int]]:
    """The step in time, as of ``pick_step``, the channel, how many steps there are, and the size along x, y, z."""
    nx, ny, nz, *extra = (*shape, *(1,) * (3 - len(shape)))
    while extra and extra[-1] == 1:
        extra.pop()
    times, channels = (*extra[:1], 1)[0], math.prod(extra[1:])
    return pick_step(source, times), pick(source, "channel", channels, "channels"), times, (nx, ny, nz)


def field_slabs(
    voxels: Source, start: int, shape: Shape, dtype: np.dtype[Any], scaling: Scaling
) -> Iterator[np.ndarray]:
    """The voxels (z, y, x) from a byte on, some layers at a time, scaled; luminance of colours."""
    for slab in raw_slabs(voxels, start, shape, dtype):
        if dtype.names:
            yield luminance_of_colours(np.stack([slab[name] for name in dtype.names], axis=-1))
        else:
            yield scaling.apply(slab)


def _placed_by(header: Any) -> str:
    """Which of its two transforms says where a file lies: the sform, where there is one."""
    return "its sform" if int(header["sform_code"]) else "its qform" if int(header["qform_code"]) else ""


def _placed_by_header(grid: Grid, header: Any) -> Grid:
    """The grid with the affine that the header prefers, in a patient's right, anterior, superior."""
    with reading("its header", "NIfTI"):
        sform, qform = int(header["sform_code"]), int(header["qform_code"])
        if not sform and not qform:
            return replace(
                grid, notes=(*grid.notes, "The file does not say how it lies: its axes are taken as they are.")
            )
        affine = header.get_best_affine()
        notes = grid.notes
        if sform and qform:
            apart = np.linalg.solve(affine[:3, :3], (header.get_qform() - affine)[:3])
            corner = np.abs(apart) @ np.array([*(n - 1 for n in grid.shape[::-1]), 1.0])
            if corner.max() > MAX_TRANSFORM_GAP:
                notes = (*notes, f"Its two transforms differ by {corner.max():.3g} voxels: the sform is taken.")
    return replace(grid, affine=Affine.of(affine, PATIENT_AXES), notes=notes)
