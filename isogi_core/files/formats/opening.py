"""Opening volumes of any kind but Zarr: the kind is told by how a file begins, and then by its name."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import KEYS, Source
from isogi_core.files.grid import Grid
from isogi_core.files.nrrd import open_nrrd, read_attached

HEAD = 544
"""Bytes by which a kind is told."""

Opener = Callable[[Source], Grid]

KNOWN = "NRRD, NIfTI, DICOM, TIFF, MRC, HDF5, NumPy, MetaImage, VTI or Zarr"


def _opener(module: str, name: str) -> Opener:
    """The function of a reader's module, loaded now."""
    found: Opener = getattr(import_module(f"isogi_core.files.formats.{module}"), name)
    return found


def opener_for(head: bytes, suffix: str) -> Opener | None:
    """The function that opens files which begin with ``head``; by their ``suffix`` where that says nothing."""
    from isogi_core.files.formats import dicom, hdf5, itk, mrc, nifti, numpy_file, tiff  # noqa: PLC0415 (late)

    kinds: list[tuple[bool, Opener]] = [
        (nifti.is_nifti(head), nifti.open_nifti),
        (dicom.is_dicom(head), dicom.open_dicom),
        (tiff.is_tiff(head), tiff.open_tiff),
        (mrc.is_mrc(head), mrc.open_mrc),
        (head.startswith(hdf5.MAGIC), hdf5.open_hdf5),
        (head.startswith((numpy_file.NPY, numpy_file.ZIP)), numpy_file.open_numpy),
        (b"<VTKFile" in head and b"ImageData" in head, _opener("vti", "open_vti")),
        (b"NDims" in head or b"ObjectType" in head or head.startswith(b"# vtk DataFile"), itk.open_itk),
        (suffix == ".vti", _opener("vti", "open_vti")),
        (suffix in itk.SUFFIXES, itk.open_itk),
    ]
    return next((opener for fits, opener in kinds if fits), None)


def open_file(path: Path, chosen: dict[str, Any]) -> Grid:
    """Open a file or a folder of slices as a grid; only headers are read now. Raises VolumeError."""
    source = Source(str(path), path, chosen={key: str(value) for key, value in chosen.items()})
    if path.is_dir():
        return _open_folder(source)
    with source.open() as file:
        plain = file.read(4)
    if plain.startswith(b"NRRD") or path.suffix.lower() in (".nrrd", ".nhdr"):
        source.refuse_others()
        return open_nrrd(path)
    opener = opener_for(_head(source), path.suffix.lower())
    if opener is None:
        raise VolumeError(f"'{path}' is no volume that is known here: give {KNOWN}.")
    return opener(source)


def _head(source: Source) -> bytes:
    """How a file begins, unpacked; empty where it cannot be."""
    with source.unpacked() as file:
        try:
            return file.read(HEAD)
        except (OSError, EOFError, ValueError):
            return b""


def _open_folder(source: Source) -> Grid:
    """Open a folder of slices: TIFF where it holds such, else DICOM."""
    from isogi_core.files.formats import dicom, tiff  # noqa: PLC0415 (late)

    assert source.path is not None, "a folder has a path"
    return tiff.open_tiff_folder(source) if tiff.slices_in(source.path) else dicom.open_dicom(source)


def open_upload(file: Any, name: str, most: int) -> Grid:
    """Open an untrusted file as a grid: no other file is opened, and no memory is taken on a header's word.

    Raises VolumeError, also where it has more than ``most`` voxels.
    """
    source = Source(name, file=file, voxels=most)
    if file.read(4) == b"NRRD":
        file.seek(0)
        return read_attached(file, name, most)
    opener = opener_for(_head(source), Path(name).suffix.lower())
    if opener is None:
        raise VolumeError(f"'{name}' is no volume that is known here: give {KNOWN}.")
    return opener(source)


LIBRARIES: tuple[tuple[int, bytes, tuple[str, ...]], ...] = (
    (0, b"\x1f\x8b", ("nibabel", "mrcfile.utils", "mrcfile.mrcinterpreter")),
    (0, b"BZh", ("nibabel", "mrcfile.utils", "mrcfile.mrcinterpreter")),
    (344, b"n", ("nibabel",)),
    (4, b"n", ("nibabel",)),
    (128, b"DICM", ("pydicom.pixels", "pydicom.pixels.decoders", "openjpeg", "rle")),
    (0, b"II", ("tifffile", "imagecodecs._imcd", "imagecodecs")),
    (0, b"MM", ("tifffile", "imagecodecs._imcd", "imagecodecs")),
    (208, b"MAP", ("mrcfile.utils", "mrcfile.mrcinterpreter")),
    (0, b"\x89HDF", ("h5py",)),
    (0, b"PK", ("zipfile",)),
)
"""Libraries that a file may need, by what it has at some byte."""


def libraries_for(head: bytes) -> list[str]:
    """Modules that a file may need which begins with ``head``: more than it does, and never less."""
    return [name for at, mark, names in LIBRARIES if head[at:].startswith(mark) for name in names]


def split_part(name: str) -> tuple[str, dict[str, str]]:
    """A volume's name without what follows its last #, and what that chooses: ``#time=3``, or a path in the file.

    Raises VolumeError for a key that is none of KEYS.
    """
    place, mark, text = name.rpartition("#")
    if not mark or not place:
        return name, {}
    chosen: dict[str, str] = {}
    for each in text.split("&"):
        key, equals, value = each.partition("=")
        if equals and key not in KEYS:
            raise VolumeError(f"'{each}' of '{name}' chooses nothing: give one of {', '.join(KEYS)}.")
        chosen[key if equals else "part"] = value if equals else each
    return place, chosen
