"""Files of scanners, read by nibabel: PAR/REC of Philips' MRI, and ECAT 7 of PET.

Both hold series whose fields have slopes of their own. A field is read at once, as nibabel sorts
and turns its slices.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, library, pick_step, reader
from isogi_core.files.grid import PATIENT_AXES, SINGLE_MOMENT, Affine, Grid, Shape, read_as

REC_SUFFIX = ".rec"
PAR_NAMES = (".par", ".PAR", ".Par")


def par_beside(path: Path) -> Path | None:
    """Find the header next to the .REC file of Philips' voxels at ``path``; None if the path ends
    otherwise, or no header is there.
    """
    if path.suffix.lower() != REC_SUFFIX:
        return None
    return next((each for end in PAR_NAMES if (each := path.with_suffix(end)).is_file()), None)


@reader("PAR/REC", "time")
def open_parrec(source: Source) -> Grid:
    """Open a PAR header on the disk, with the REC file next to it, as a grid in mm: the chosen step
    of a series, else its first. Raises VolumeError.
    """
    if source.path is None:
        raise VolumeError(
            f"'{source.name}' is a header whose voxels are in another file: save both as one .nii "
            "file, by nibabel's parrec2nii."
        )
    voxels = _rec_beside(source.path)
    if voxels is None:
        raise VolumeError(
            f"'{source.name}' is a header, and '{source.path.stem}.REC' with its voxels is not "
            "next to it: put it there."
        )
    header = _par_header(source.path)
    affine = header.get_affine()
    nx, ny, nz, *more = (int(n) for n in header.get_data_shape())
    fields = more[0] if more else 1
    source.check((nz, ny, nx))
    step, unchosen = pick_step(source, fields)
    known = f"PAR/REC of {header.get_data_dtype().name}, scaled to displayed values"
    # The voxels may have an axis of time of length 1: a step is then read, though the grid is no
    # series.
    return Grid(
        (nz, ny, nx),
        np.dtype(np.float32),
        _steps(affine),
        partial(_parrec_slabs, source.path, voxels, step if more else None),
        partial(source.stamp, voxels),
        Affine.of(affine, PATIENT_AXES),
        "mm",
        moment=(step, fields) if fields > 1 else SINGLE_MOMENT,
        unchosen=unchosen,
        read_as=f"{known}; placed by its slices' angles and offsets",
    )


def _rec_beside(path: Path) -> Path | None:
    """Find the REC file next to a header; None if there is none."""
    names = (path.with_suffix(end) for end in (".REC", ".rec", ".Rec"))
    return next((each for each in names if each.is_file()), None)


def _par_header(path: Path) -> Any:
    """Read the header of a pair. Scans that were stopped have fewer volumes than it says."""
    kind = library("nibabel.parrec", "PAR/REC").PARRECHeader
    with path.open(encoding="latin-1") as file:
        return kind.from_fileobj(file, permit_truncated=True, strict_sort=True)


def _parrec_slabs(path: Path, voxels: Path, step: int | None) -> Iterator[np.ndarray]:
    """Read the field of a step at once, scaled to displayed values; without a step, if the voxels
    have no axis of time.
    """
    header = _par_header(path)
    proxy = library("nibabel.parrec", "PAR/REC").PARRECArrayProxy
    with voxels.open("rb") as file:
        values = proxy(file, header, mmap=False, scaling="dv")
        field = values[..., step] if step is not None else values[...]
    yield _as_layers(field, header.get_data_shape()[2::-1])


def _as_layers(field: Any, shape: Shape) -> np.ndarray:
    """Turn a field (x, y, z) of nibabel into layers (z, y, x) float32."""
    return np.asarray(field, np.float32).T.reshape(shape)


def _steps(affine: np.ndarray) -> tuple[float, float, float]:
    """Lengths of a step along x, y, z."""
    x, y, z = (float(step) for step in np.linalg.norm(affine[:3, :3], axis=0))
    return x, y, z


@reader("ECAT", "time")
def open_ecat(source: Source) -> Grid:
    """Open a file of PET as a grid: a series of frames. Raises VolumeError."""
    with _ecat(source) as frames:
        count = int(frames.get_nframes())
        step, unchosen = pick_step(source, count)
        nx, ny, nz = (int(n) for n in frames.get_shape(step))
        source.check((nz, ny, nx))
        stored = frames._get_data_dtype(step)
        affine = frames.get_frame_affine(step)
    return Grid(
        (nz, ny, nx),
        np.dtype(np.float32),
        _steps(affine),
        partial(_ecat_slabs, source, step),
        source.stamp,
        Affine.of(affine, PATIENT_AXES),
        "mm",
        moment=(step, count) if count > 1 else SINGLE_MOMENT,
        unchosen=unchosen,
        read_as=read_as("ECAT, scaled to activity,", np.dtype(stored), "its header"),
    )


@contextmanager
def _ecat(source: Source) -> Iterator[Any]:
    """Read the headers of all frames; the file stays open meanwhile."""
    module = library("nibabel.ecat", "ECAT")
    with source.open() as file:
        header = module.EcatHeader.from_fileobj(file)
        matrices = np.zeros((int(header["num_frames"]), 4), np.int32)
        listed = module.read_mlist(file, header.endianness)[: len(matrices)]
        matrices[: len(listed)] = listed
        yield module.EcatSubHeader(header, matrices, file)


def _ecat_slabs(source: Source, step: int) -> Iterator[np.ndarray]:
    with _ecat(source) as frames:
        field = frames.data_from_fileobj(step)
        yield _as_layers(field, frames.get_shape(step)[::-1])
