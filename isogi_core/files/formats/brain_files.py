"""FreeSurfer's MGH, Analyze 7.5 and AFNI, read by nibabel: what brains were kept in before NIfTI, and beside it."""

import io
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from isogi_core.errors import VolumeError
from isogi_core.files.formats.nifti import field_slabs, frame_of, image_beside, scaling_of
from isogi_core.files.formats.source import Source, library, reading
from isogi_core.files.grid import PATIENT_AXES, Affine, Grid, Shape, read_as
from isogi_core.files.packing import Scaling

MGH, MGH_SUFFIXES = b"\0\0\0\1", (".mgh", ".mgz")

ANALYZE_HEADER_BYTES, REGULAR_MARK = 348, slice(38, 39)
"""The size of Analyze's header, its first number, and where most of its files have an r."""

NO_SIDES = "Analyze does not say where left is: x is taken to go to the patient's left, as SPM does."


def is_mgh(head: bytes, suffix: str) -> bool:
    """Whether a file begins as MGH does, and is named so: its beginning alone is little."""
    return head.startswith(MGH) and suffix in MGH_SUFFIXES


def is_analyze(head: bytes, suffix: str) -> bool:
    """Whether a file begins as Analyze does, and is named so or has its r; NIfTI begins so, too, and has a mark."""
    sized = ANALYZE_HEADER_BYTES in (int.from_bytes(head[:4], order) for order in ("little", "big"))
    return sized and (head[REGULAR_MARK] == b"r" or suffix in (".hdr", ".gz"))


def open_mgh(source: Source) -> Grid:
    """Open a file of FreeSurfer as a grid: only the header is read now. Raises VolumeError."""
    kind = library("nibabel.freesurfer.mghformat", "MGH").MGHHeader
    with reading(source.name, "MGH"), source.unpacked() as file:
        header = kind(file.read(kind._hdrdtype.itemsize))
    return _opened(source, source, header, "MGH")


def open_analyze(source: Source) -> Grid:
    """Open the header of a pair as a grid. Raises VolumeError."""
    if source.path is None:
        raise VolumeError(f"'{source.name}' is a header whose voxels are in another file: save both as one .nii file.")
    kind = library("nibabel", "Analyze").spm2analyze.Spm2AnalyzeHeader
    with reading(source.name, "Analyze"), source.unpacked() as file:
        header = kind.from_fileobj(file)
    grid = _opened(source, replace(source, path=image_beside(source)), header, "Analyze")
    placed = source.path.with_suffix(".mat").is_file()
    lost = (f"SPM's '{source.path.stem}.mat' beside it is not read: convert both to NIfTI.",) if placed else ()
    return replace(grid, notes=(*grid.notes, NO_SIDES, *lost))


AFNI_ENDINGS = re.compile(r"\.(?:HEAD|BRIK)(\.gz|\.bz2)?$")
"""How the names of AFNI's pairs end: the header's, and the voxels'."""


def is_afni(head: bytes, suffix: str) -> bool:
    """Whether a file begins as AFNI's headers do, with an attribute, and is named so."""
    return suffix == ".head" and head.lstrip().startswith(b"type") and b"-attribute" in head


def afni_header(path: Path) -> Path | None:
    """The header of AFNI's voxels; None where a file is none, or has no header beside it."""
    header = path.with_name(AFNI_ENDINGS.sub(".HEAD", path.name))
    return header if ".BRIK" in path.name and header != path and header.is_file() else None


def open_afni(source: Source) -> Grid:
    """Open the header of AFNI's pair as a grid: a series in time, or channels, a brick each. Raises VolumeError."""
    if source.path is None:
        one = "save both as one .nii file, by 3dAFNItoNIFTI"
        raise VolumeError(f"'{source.name}' is a header whose voxels are in another file: {one}.")
    kind = library("nibabel.brikhead", "AFNI").AFNIHeader
    names = [AFNI_ENDINGS.sub(f".BRIK{packed}", source.path.name) for packed in ("", ".gz", ".bz2")]
    voxels = next((found for name in names if (found := source.path.with_name(name)).is_file()), None)
    if voxels is None:
        raise VolumeError(f"'{source.name}' is a header, and '{names[0]}' with its voxels is not beside it.")
    with reading(source.name, "AFNI"), source.open() as file:
        header = kind.from_fileobj(io.StringIO(file.read().decode("latin-1").replace("\r\n", "\n")))
        nx, ny, nz, bricks = header.get_data_shape()
        slopes = header.get_data_scaling()
    shape = (nx, ny, nz, bricks) if "TAXIS_NUMS" in header.info else (nx, ny, nz, 1, bricks)
    scalings = [Scaling()] * bricks if slopes is None else [Scaling(float(slope)) for slope in slopes]
    return _opened(source, replace(source, path=voxels), header, "AFNI", shape, scalings)


def _opened(
    source: Source, voxels: Source, header: Any, kind: str, shape: Shape = (), scalings: Sequence[Scaling] = ()
) -> Grid:
    """The grid of one of nibabel's headers, of a ``shape`` and with ``scalings`` of its fields where
    it does not say these itself.
    """
    source.refuse_others("time", "channel")
    with reading(source.name, "a volume"):
        shape, dtype = tuple(int(n) for n in shape or header.get_data_shape()), header.get_data_dtype()
        (time, unchosen), channel, times, (nx, ny, nz) = frame_of(source, shape)
        source.check((nz, ny, nx))
        first, field = int(header.get_data_offset()), time + times * channel
        start = first + field * nx * ny * nz * dtype.itemsize
        scaling = scalings[field] if scalings else scaling_of(header)
        affine = Affine.of(header.get_affine() if kind == "AFNI" else header.get_best_affine(), PATIENT_AXES)
        x, y, z = (abs(float(step)) for step in header.get_zooms()[:3])
    others = [voxels.path] if voxels.path is not None and voxels.path != source.path else []
    slabs = partial(field_slabs, voxels, start, (nz, ny, nx), dtype, scaling)
    notes = voxels.cut_notes(first + math.prod(shape) * dtype.itemsize)
    grid = Grid((nz, ny, nx), scaling.dtype(dtype), (x, y, z), slabs, partial(source.stamp, *others), affine)
    known = read_as(kind, dtype, "its header", scaling.slope, scaling.intercept)
    unit = "" if kind == "Analyze" else "mm"
    return replace(grid, unit=unit, notes=notes, moment=(time, times), unchosen=unchosen, read_as=known)
