"""Files of brains, read by nibabel: NIfTI-1 and -2, FreeSurfer's MGH, Analyze 7.5, AFNI, and MINC 1
and 2.

NIfTI and Analyze are one file or a pair. Voxels are streamed, as a packed file is read but once.
"""

import io
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
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
    reader,
)
from isogi_core.files.grid import (
    PATIENT_AXES,
    SINGLE_MOMENT,
    Affine,
    Grid,
    Shape,
    read_as,
    slab_layers,
)
from isogi_core.files.packing import Scaling

NIFTI_UNITS = {"mm": "mm", "meter": "m", "micron": "µm"}
UNPLACED_NOTE = "The file does not say how it lies: its axes are taken as they are."

LABELS = 1002
"""The intent of files whose values are labels."""

MAX_TRANSFORM_GAP = 0.01
"""Voxels by which two transforms of a file must differ for this to be told."""


@reader("NIfTI", "time", "channel")
def open_nifti(source: Source) -> Grid:
    """Open a NIfTI file as a grid: only the header is read now. Raises VolumeError."""
    header = _nifti_header(library("nibabel", "NIfTI"), source)
    if header.is_single or source.path is None:
        voxels = source
    else:
        voxels = replace(source, path=image_beside(source))
    grid = _grid_of(source, voxels, header, "NIfTI", _placed_by(header))
    if int(header["intent_code"]) == LABELS:
        labels = ()
    else:
        labels = None
    unit = NIFTI_UNITS.get(header.get_xyzt_units()[0], "")
    return _placed_by_header(replace(grid, unit=unit, labels=labels), header)


def _nifti_header(nib: Any, source: Source) -> Any:
    """Return the header, of either version and byte order."""
    with source.unpacked() as file:
        head = file.read(348)
    one = 348 in (int.from_bytes(head[:4], order) for order in ("little", "big"))
    pair = b"ni" in head[4:8] + head[344:]
    if pair and source.path is None:
        raise VolumeError(
            f"'{source.name}' is a header whose voxels are in another file: save both as one "
            ".nii file."
        )
    kinds = nib.nifti1.Nifti1PairHeader, nib.nifti1.Nifti1Header, nib.Nifti2Header
    if pair and not one:
        kind = nib.nifti2.Nifti2PairHeader
    elif pair:
        kind = kinds[0]
    elif one:
        kind = kinds[1]
    else:
        kind = kinds[2]
    with source.unpacked() as file:
        whole = file.read(kind.template_dtype.itemsize)
    return kind.from_fileobj(
        io.BytesIO(whole + bytes(4))
    )  # without extensions, which may claim any size


PAIR_ENDINGS = re.compile(r"\.(?:hdr|img)(\.gz|\.bz2)?$", re.IGNORECASE)
"""How the names of a pair of files end: that of the header, and that of the voxels."""


def beside(path: Path, end: str) -> Path | None:
    """Return the other file of a pair, whose name ends in ``.hdr`` or ``.img``; None if there is
    none.
    """
    stem = PAIR_ENDINGS.sub("", path.name)
    names = [
        f"{stem}{case}{packed}" for case in (end, end.upper()) for packed in ("", ".gz", ".bz2")
    ]
    return next(
        (found for name in names if (found := path.with_name(name)).is_file() and found != path),
        None,
    )


def image_beside(source: Source) -> Path:
    """Return the file with the voxels of a header. Raises VolumeError if there is none."""
    assert source.path is not None, "a pair has paths"
    found = beside(source.path, ".img")
    if found is None:
        wanted = PAIR_ENDINGS.sub("", source.path.name) + ".img"
        raise VolumeError(
            f"'{source.name}' is a header, and '{wanted}' with its voxels is not beside it."
        )
    return found


def _placed_by(header: Any) -> str:
    """Name the one of its two transforms that places a file: the sform, if there is one; empty if
    neither does.
    """
    if int(header["sform_code"]):
        return "its sform"
    if int(header["qform_code"]):
        return "its qform"
    return ""


def _placed_by_header(grid: Grid, header: Any) -> Grid:
    """Return the grid with the affine map that the header prefers, in a patient's right, anterior,
    superior.
    """
    sform, qform = int(header["sform_code"]), int(header["qform_code"])
    if not sform and not qform:
        return replace(grid, notes=(*grid.notes, UNPLACED_NOTE))
    affine = header.get_best_affine()
    notes = grid.notes
    if sform and qform:
        apart = np.linalg.solve(affine[:3, :3], (header.get_qform() - affine)[:3])
        corner = np.abs(apart) @ np.array([*(n - 1 for n in grid.shape[::-1]), 1.0])
        if corner.max() > MAX_TRANSFORM_GAP:
            notes = (
                *notes,
                f"Its two transforms differ by {corner.max():.3g} voxels: the sform is taken.",
            )
    return replace(grid, affine=Affine.of(affine, PATIENT_AXES), notes=notes)


def _grid_of(
    source: Source,
    voxels: Source,
    header: Any,
    kind: str,
    placed: str = "its header",
    shape: Shape = (),
    scalings: Sequence[Scaling] = (),
) -> Grid:
    """Return the grid of one of nibabel's headers, without its place in the world. Its ``voxels``
    may be in another file.

    ``shape`` and the ``scalings`` of its fields are given if the header does not have them.
    """
    shape = tuple(int(n) for n in shape or header.get_data_shape())
    dtype = header.get_data_dtype()
    (time, unchosen), channel, times, (nx, ny, nz) = _frame_of(source, shape)
    source.check((nz, ny, nx))
    first = int(header.get_data_offset())
    field = time + times * channel
    start = first + field * nx * ny * nz * dtype.itemsize
    if scalings:
        scaling = scalings[field]
    else:
        scaling = _scaling_of(header)
    x, y, z = (abs(float(step)) for step in header.get_zooms()[:3])
    if voxels.path is not None and voxels.path != source.path:
        others = [voxels.path]
    else:
        others = []
    slabs = partial(_field_slabs, voxels, start, (nz, ny, nx), dtype, scaling)
    cut = voxels.cut_notes(first + math.prod(shape) * dtype.itemsize)
    if dtype.names:
        values = np.dtype(np.float32)
    else:
        values = scaling.dtype(dtype)
    grid = Grid((nz, ny, nx), values, (x, y, z), slabs, partial(source.stamp, *others))
    known = read_as(kind, dtype, placed, scaling.slope, scaling.intercept)
    if dtype.names:
        notes = (LUMINANCE_NOTE, *cut)
    else:
        notes = cut
    return replace(grid, notes=notes, moment=(time, times), unchosen=unchosen, read_as=known)


def _scaling_of(header: Any) -> Scaling:
    """Return slope and intercept of one of nibabel's headers."""
    slope, intercept = header.get_slope_inter()
    if slope is None or slope == 0.0:
        return Scaling()
    return Scaling(float(slope), float(intercept or 0.0))


def _frame_of(
    source: Source, shape: Shape
) -> tuple[tuple[int, bool], int, int, tuple[int, int, int]]:
    """Return the step in time, as of ``pick_step``, the channel, the number of steps, and the size
    along x, y, z.
    """
    nx, ny, nz, *extra = (*shape, *(1,) * (3 - len(shape)))
    while extra and extra[-1] == 1:
        extra.pop()
    times = (*extra[:1], 1)[0]
    channels = math.prod(extra[1:])
    return (
        pick_step(source, times),
        pick(source, "channel", channels, "channels"),
        times,
        (nx, ny, nz),
    )


def _field_slabs(
    voxels: Source, start: int, shape: Shape, dtype: np.dtype[Any], scaling: Scaling
) -> Iterator[np.ndarray]:
    """Yield the voxels (z, y, x) from a byte on, some layers at a time, scaled; luminance of
    colours.
    """
    for slab in raw_slabs(voxels, start, shape, dtype):
        if dtype.names:
            yield luminance_of_colours(np.stack([slab[name] for name in dtype.names], axis=-1))
        else:
            yield scaling.apply(slab)


NO_SIDES = (
    "Analyze does not say where left is: x is taken to go to the patient's left, as SPM does."
)


@reader("MGH", "time", "channel")
def open_mgh(source: Source) -> Grid:
    """Open a file of FreeSurfer as a grid: only the header is read now. Raises VolumeError."""
    kind = library("nibabel.freesurfer.mghformat", "MGH").MGHHeader
    with source.unpacked() as file:
        header = kind(file.read(kind._hdrdtype.itemsize))
    grid = _grid_of(source, source, header, "MGH")
    return replace(grid, affine=Affine.of(header.get_best_affine(), PATIENT_AXES), unit="mm")


@reader("Analyze", "time", "channel")
def open_analyze(source: Source) -> Grid:
    """Open the header of a pair as a grid. Raises VolumeError."""
    if source.path is None:
        raise VolumeError(
            f"'{source.name}' is a header whose voxels are in another file: save both as one "
            ".nii file."
        )
    kind = library("nibabel", "Analyze").spm2analyze.Spm2AnalyzeHeader
    with source.unpacked() as file:
        header = kind.from_fileobj(file)
    grid = _grid_of(source, replace(source, path=image_beside(source)), header, "Analyze")
    placed = source.path.with_suffix(".mat").is_file()
    lost = (
        (f"SPM's '{source.path.stem}.mat' beside it is not read: convert both to NIfTI.",)
        if placed
        else ()
    )
    affine = Affine.of(header.get_best_affine(), PATIENT_AXES)
    return replace(grid, affine=affine, notes=(*grid.notes, NO_SIDES, *lost))


AFNI_ENDINGS = re.compile(r"\.(?:HEAD|BRIK)(\.gz|\.bz2)?$")
"""How the names of AFNI's pairs end: the header's, and the voxels'."""


def afni_header(path: Path) -> Path | None:
    """Return the header of AFNI's voxels; None if a file is none, or has no header next to it."""
    header = path.with_name(AFNI_ENDINGS.sub(".HEAD", path.name))
    if ".BRIK" in path.name and header != path and header.is_file():
        return header
    return None


@reader("AFNI", "time", "channel")
def open_afni(source: Source) -> Grid:
    """Open the header of AFNI's pair as a grid: a series in time, or channels, a brick each. Raises
    VolumeError.
    """
    if source.path is None:
        one = "save both as one .nii file, by 3dAFNItoNIFTI"
        raise VolumeError(f"'{source.name}' is a header whose voxels are in another file: {one}.")
    kind = library("nibabel.brikhead", "AFNI").AFNIHeader
    names = [AFNI_ENDINGS.sub(f".BRIK{packed}", source.path.name) for packed in ("", ".gz", ".bz2")]
    voxels = next(
        (found for name in names if (found := source.path.with_name(name)).is_file()), None
    )
    if voxels is None:
        raise VolumeError(
            f"'{source.name}' is a header, and '{names[0]}' with its voxels is not beside it."
        )
    with source.open() as file:
        header = kind.from_fileobj(io.StringIO(file.read().decode("latin-1").replace("\r\n", "\n")))
        nx, ny, nz, bricks = header.get_data_shape()
        slopes = header.get_data_scaling()
    shape = (nx, ny, nz, bricks) if "TAXIS_NUMS" in header.info else (nx, ny, nz, 1, bricks)
    if slopes is None:
        scalings = [Scaling()] * bricks
    else:
        scalings = [Scaling(float(slope)) for slope in slopes]
    grid = _grid_of(
        source, replace(source, path=voxels), header, "AFNI", shape=shape, scalings=scalings
    )
    return replace(grid, affine=Affine.of(header.get_affine(), PATIENT_AXES), unit="mm")


MINC1_MAGIC = b"CDF"
"""How MINC 1 begins; MINC 2 is HDF5."""

SCALED_SLICES = "MINC, each slice of a slope of its own,"


@reader("MINC", "time")
def open_minc(source: Source) -> Grid:
    """Open a file as a grid: of MINC 2 only its description is read now. Raises VolumeError."""
    with _image(source) as image:
        shape = tuple(int(n) for n in image.get_data_shape())
        stored = np.dtype(image.get_data_dtype())
        names = list(map(str, image._dim_names))
        if not all(name.endswith("space") for name in names[-3:]) or names[:-3] not in (
            [],
            ["time"],
        ):
            raise VolumeError(
                f"'{source.name}' has the axes {', '.join(names)}: save z, y and x alone, or "
                "in time."
            )
        source.check(shape[-3:])
        matrix = image.get_affine()[:3, [2, 1, 0, 3]]
    times = shape[0] if len(shape) > 3 else 1
    time, unchosen = pick_step(source, times)
    picked = (time,) if len(shape) > 3 else ()
    wide = stored.itemsize > 2 and stored.newbyteorder("=") != np.float32
    dtype: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
    x, y, z = (float(step) for step in np.linalg.norm(matrix[:, :3], axis=0))
    return Grid(
        shape[-3:],
        dtype,
        (x, y, z),
        partial(_image_slabs, source, picked, shape[-3:], dtype),
        source.stamp,
        Affine.of(matrix, PATIENT_AXES),
        "mm",
        moment=(time, times) if times > 1 else SINGLE_MOMENT,
        unchosen=unchosen,
        read_as=read_as("MINC" if stored.kind == "f" else SCALED_SLICES, stored, "its dimensions"),
    )


@contextmanager
def _image(source: Source) -> Iterator[Any]:
    """Yield the file as an image of nibabel."""
    with source.open() as file:
        begins = file.read(len(MINC1_MAGIC))
        file.seek(0)
        if begins == MINC1_MAGIC:
            classic = library("nibabel.externals.netcdf", "MINC").netcdf_file(file, mmap=False)
            yield library("nibabel.minc1", "MINC").Minc1File(classic)
            return
        kind = library("nibabel.minc2", "MINC").Minc2File
        h5py = library("h5py", "MINC")
        with h5py.File(source.path or file, "r", locking=False) as whole:
            yield kind(whole)


def _image_slabs(
    source: Source, picked: tuple[int, ...], shape: Shape, dtype: np.dtype[Any]
) -> Iterator[np.ndarray]:
    """Yield some layers at a time, scaled to the range that each slice gives."""
    with _image(source) as image:
        step = slab_layers(shape[1] * shape[2] * 8)
        for z in range(0, shape[0], step):
            yield image.get_scaled_data((*picked, slice(z, min(z + step, shape[0])))).astype(dtype)
