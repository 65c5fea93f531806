"""Opening volumes of any kind but Zarr, by the table of kinds; folders, archives, and messages on
files that are no volumes.
"""

import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from isogi_core.errors import VolumeError, advice
from isogi_core.files.formats import (
    array_files,
    brain_files,
    dicom,
    nrrd,
    scanner_files,
    side_headers,
    tiff,
)
from isogi_core.files.formats.kinds import (
    HEAD_BYTES,
    ZIP_MAGIC,
    Head,
    Kind,
    added_kinds,
    added_reader_of,
    head_of,
    libraries_for,
    plugin_faults,
    reader_of,
)
from isogi_core.files.formats.other_kinds import (
    BARE_VOXELS_HINT,
    guess_of,
    hint_of,
    hint_of_folder,
    is_text,
)
from isogi_core.files.formats.source import FILE_CHOICES, Source
from isogi_core.files.grid import Grid, read_as
from isogi_core.files.plugins import blame_plugin, failure_of

__all__ = ["HEAD_BYTES", "libraries_for", "open_file", "open_upload", "split_part"]

KNOWN_KINDS = (
    "NRRD, NIfTI, DICOM, TIFF, MRC, HDF5, NetCDF, NumPy, MGH, Analyze, AFNI, MINC, "
    "MetaImage, VTI, Gaussian cube, CHGCAR, OpenDX, XSF or Zarr"
)


def open_file(path: Path, chosen: dict[str, Any]) -> Grid:
    """Open a file or a folder of slices as a grid; only headers are read now. Raises
    VolumeError.
    """
    path = _header_of(path)
    source = Source(str(path), path, chosen={key: str(value) for key, value in chosen.items()})
    if path.is_dir():
        return _open_folder(source)
    if "raw" in source.chosen:
        return array_files.open_raw(source)
    return _open_by_head(source)


def open_upload(file: IO[bytes], name: str, most: int) -> Grid:
    """Open an untrusted file as a grid: no other file is opened, and memory is allocated only for
    voxels that are there. Raises VolumeError, also if it has more than ``most`` voxels.
    """
    return _open_by_head(Source(name, file=file, voxels=most))


def _open_by_head(source: Source) -> Grid:
    """Open a file as a grid, by how it begins, else by its name. Raises VolumeError."""
    head = _head(source)
    # A plug-in may read what isogi can only name, and a kind of its own that is a ZIP file.
    added = added_reader_of(head)
    if added is None:
        if hint := hint_of(head):
            raise VolumeError(_with_faults(f"'{source.name}' seems to be {hint}.", head))
        if head.stored.startswith(ZIP_MAGIC):
            return open_archive(source)
    kind = added or reader_of(head)
    if kind is not None:
        if head.is_packed and not kind.unpacks and not kind.begins(head.stored):
            raise VolumeError(
                f"'{source.name}' seems to be {kind.name}, packed by gzip or "
                "bzip2: unpack it first."
            )
        return read_by_plugin(kind, source) if kind.package else kind.open()(source)
    if not is_text(head) and (header := side_headers.header_beside(source)):
        grid = _open_by_head(header)
        note = f"'{Path(source.name).name}' is bare voxels: '{Path(header.name).name}' says what."
        return replace(grid, notes=(*grid.notes, note))
    if array_files.is_raw(source.name):
        return array_files.open_raw(source)
    raise _unknown(source, head)


def _head(source: Source) -> Head:
    """Read how a file begins; its content is empty if it cannot be unpacked."""
    with source.open() as file:
        stored = file.read(HEAD_BYTES)
    with source.unpacked() as file:
        try:
            content = file.read(HEAD_BYTES)
        except (OSError, EOFError, ValueError, zlib.error):
            content = b""
    return head_of(stored, content, source.name)


def _header_of(path: Path) -> Path:
    """Return the header of a pair of files of which the voxels are named; any other path itself."""
    voxels = brain_files.PAIR_ENDINGS.search(path.name) is not None and ".img" in path.name.lower()
    if voxels:
        header = brain_files.beside(path, ".hdr")
    else:
        header = brain_files.afni_header(path) or scanner_files.par_beside(path)
    return header or path


def _unknown(source: Source, head: Head) -> VolumeError:
    """Return the error for a file that is no volume, with its likely kind if that is known."""
    name = source.name
    if not head.stored:
        return VolumeError(f"'{name}' is empty: copy or write it again.")
    if guess := guess_of(head):
        if guess == BARE_VOXELS_HINT and not head.is_packed and (fits := _cubes(source)):
            guess = f"{guess}; {fits} would fit"
        return VolumeError(_with_faults(f"'{name}' seems to be {guess}.", head))
    known = ", ".join([*(kind.name for kind in added_kinds()), KNOWN_KINDS])
    return VolumeError(
        _with_faults(f"'{name}' is no volume that is known here: give {known}.", head)
    )


def _with_faults(said: str, head: Head) -> str:
    """Add to a message a sentence for each broken plug-in, as one of these may be meant to read the
    file.
    """
    return " ".join([said, *plugin_faults(head)])


def read_by_plugin(kind: Kind, source: Source) -> Grid:
    """Open a file by a plug-in's reader. Raises VolumeError, which names the package, for all
    errors of the reader.
    """
    with blame_plugin(kind.package, _unread(kind, source.name), VolumeError):
        grid = kind.open()(source)
    if not isinstance(grid, Grid):
        wrong = f"it gives {type(grid).__name__}"
        raise VolumeError(failure_of(kind.package, _unread(kind, source.name), wrong))
    source.check(grid.shape)
    return replace(
        grid,
        slabs=partial(_checked_slabs, kind, source.name, grid),
        # A grid that names no state would be taken for the same after the file changed.
        stamp=source.stamp if grid.stamp is str else grid.stamp,
        read_as=grid.read_as or f"{read_as(kind.name, grid.dtype)}; read by {kind.package}",
    )


def _checked_slabs(kind: Kind, name: str, grid: Grid) -> Iterator[np.ndarray]:
    """Iterate over the slabs of a plug-in's grid. Raises VolumeError if they do not make up its
    shape.
    """
    layers = 0
    with blame_plugin(kind.package, _unread(kind, name), VolumeError):
        for slab in grid.slabs():
            layers += len(slab)
            if slab.shape[1:] != grid.shape[1:] or layers > len(grid):
                break
            yield slab.astype(grid.dtype, copy=False)
        else:
            if layers == len(grid):
                return
    wrong = f"its slabs do not make up {' × '.join(map(str, grid.shape))}"
    raise VolumeError(failure_of(kind.package, _unread(kind, name), wrong))


def _unread(kind: Kind, name: str) -> str:
    """Say that a plug-in does not read a file as the kind that it should be."""
    return f"'{name}' cannot be read as {kind.name}"


def _cubes(source: Source) -> str:
    """Name cubes of voxels that a file would hold without a header; empty if there are none."""
    with source.open() as file:
        return " or ".join(array_files.cubes_of(file.seek(0, 2)))


def _open_folder(source: Source) -> Grid:
    """Open a folder of slices: TIFF if it holds such, else DICOM. Raises VolumeError, with the
    folder's likely kind if it holds neither.
    """
    if tiff.slices_in(source):
        return tiff.open_tiff_folder(source)
    folder = source.path if source.archive is None else None
    if folder is not None and (hint := hint_of_folder(folder)):
        raise VolumeError(f"'{source.name}' seems to be {hint}.")
    if any(dicom.may_be_dicom(source.at(path)) for path in source.paths):
        return dicom.open_dicom(source)
    raise _no_slices(source)


def _no_slices(source: Source) -> VolumeError:
    """Return the error for a folder without slices, with its files that are volumes."""
    paths = [path for path in source.paths if not path.name.startswith(".")]
    volumes = [path for path in paths[:MOST_LOOKED_AT] if _is_whole(source.at(path))]
    if volumes:
        return VolumeError(
            f"'{source.name}' is a folder, and {_some(volumes)} in it would open: give one of "
            "these."
        )
    held = f"{len(paths)} files ({_some(paths)})" if paths else "no files"
    return VolumeError(
        f"'{source.name}' is a folder that holds {held} and no slice of DICOM or TIFF: give the "
        "folder with the slices, or a file."
    )


def _some(paths: list[Path]) -> str:
    """Name the first of some files."""
    more = " …" if len(paths) > 4 else ""
    return ", ".join(path.name for path in paths[:4]) + more


HEADER_SUFFIX = ".nhdr"
"""How a header's name ends whose voxels are in other files."""

SLICES_HINT = "slices of DICOM or TIFF, or a header (.nhdr) with its data"


def open_archive(source: Source) -> Grid:
    """Open a ZIP file as a grid: of arrays of NumPy; else slices, a header with its data, or the
    only file in it. Raises VolumeError.
    """
    folder = source.unpacked_archive()
    paths = folder.paths
    if any(path.suffix == ".npy" for path in paths):
        return array_files.open_numpy(source)
    headers = [path for path in paths if path.suffix.lower() == HEADER_SUFFIX]
    if len(headers) == 1:
        return nrrd.open_nrrd(folder.at(headers[0]))
    if any(path.name in ZARR_FILES for path in paths):
        raise VolumeError(
            f"'{source.name}' holds a Zarr: unpack it, and give the path of its folder."
        )
    if len(paths) == 1:
        return _open_by_head(folder.at(paths[0]))
    alone = [path for path in paths[:MOST_LOOKED_AT] if _is_whole(folder.at(path))]
    if len(alone) == 1:
        return _open_by_head(folder.at(alone[0]))
    if len(alone) > 1:
        listed = ", ".join(path.name for path in alone[:4])
        raise VolumeError(f"'{source.name}' holds several volumes ({listed}): give one of them.")
    if tiff.slices_in(folder) or any(dicom.may_be_dicom(folder.at(path)) for path in paths):
        return _open_folder(folder)
    raise VolumeError(
        f"'{source.name}' holds {len(paths)} files ({_some(paths)}) that are no one volume: give "
        f"{SLICES_HINT}."
    )


MOST_LOOKED_AT = 64
"""Number of files of an archive that are examined as volumes."""


SLICE_KINDS = ("TIFF", "DICOM")
"""Kinds of which a file may be one slice of many."""


def _is_whole(source: Source) -> bool:
    """Return True if a file is a volume alone, and no slice of one."""
    kind = reader_of(_head(source))
    return kind is not None and kind.name not in SLICE_KINDS


ZARR_FILES = ("zarr.json", ".zarray", ".zgroup")
"""Names of files by which a folder is a Zarr."""


def split_part(name: str) -> tuple[str, dict[str, str]]:
    """Return a volume's name without the part after its last #, and the choice that this part
    makes: ``#time=3``, or a path in the file.

    Raises VolumeError for a key that is none of FILE_CHOICES.
    """
    place, mark, text = name.rpartition("#")
    if not mark or not place:
        return name, {}
    chosen: dict[str, str] = {}
    for each in text.split("&"):
        key, equals, value = each.partition("=")
        if equals and key not in FILE_CHOICES:
            raise VolumeError(f"'{each}' of '{name}' chooses nothing: {advice(key, FILE_CHOICES)}")
        chosen[key if equals else "part"] = value if equals else each
    return place, chosen
