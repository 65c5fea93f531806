"""Opening volumes of any kind but Zarr: the kind is told by how a file begins, and then by its
name.
"""

import zlib
from pathlib import Path
from typing import IO, Any

from isogi_core.errors import VolumeError, advice
from isogi_core.files.formats import (
    array_files,
    brain_files,
    dicom,
    hdf5,
    image_files,
    mrc,
    nrrd,
    tiff,
)
from isogi_core.files.formats.chemistry import cube, opendx, vasp, xsf
from isogi_core.files.formats.source import FILE_CHOICES, Reader, Source
from isogi_core.files.grid import Grid

PICTURE_HINT = (
    "a picture, and a volume is many slices: give the folder of a stack of TIFFs, or one NRRD"
)
MESH_HINT = "a mesh of triangles, which has no values inside: give the volume that it was made from"
BARE_VOXELS_HINT = (
    "bare voxels without a header: say what they are by --raw "
    "256x256x128,uint8,little, or in the name of the file"
)
LIGHT_PROBE_HINT = (
    "a light probe: give it as --environment, or name it in a scene, environment = 'file.hdr'"
)

KINDS: tuple[tuple[bytes, str], ...] = (
    (b"\x89PNG", PICTURE_HINT),
    (b"\xff\xd8\xff", PICTURE_HINT),
    (b"GIF8", PICTURE_HINT),
    (b"#?R", LIGHT_PROBE_HINT),
    (b"%PDF", "a PDF document: give the file of the volume itself"),
    (b"solid ", MESH_HINT),
    (b"ply\n", MESH_HINT),
    (b"ply\r", MESH_HINT),
    (b"glTF", MESH_HINT),
    (b"<!DOCTYPE html", "a web page, as of a download that went wrong: fetch the file again"),
    (b"<html", "a web page, as of a download that went wrong: fetch the file again"),
    (b"version https://git-lfs", "a pointer of Git LFS, not the file: fetch that by git lfs pull"),
)
"""How files begin, and what they are."""

WRONG_SUFFIXES = {
    ".stl": MESH_HINT,
    ".obj": MESH_HINT,
    ".ply": MESH_HINT,
    ".raw": BARE_VOXELS_HINT,
    ".gz": BARE_VOXELS_HINT,
    ".bin": BARE_VOXELS_HINT,
}
"""What the endings of names say of files that begin as nothing that is known."""


def sort_of(head: bytes, suffix: str = "") -> str:
    """What a file that begins with ``head`` seems to be, and what to do then; empty where nothing
    tells.
    """
    return next(
        (words for mark, words in KINDS if head.startswith(mark)), WRONG_SUFFIXES.get(suffix, "")
    )


HEAD_BYTES = 2048
"""Bytes by which a kind is told."""

KNOWN_KINDS = (
    "NRRD, NIfTI, DICOM, TIFF, MRC, HDF5, NetCDF, NumPy, MGH, Analyze, AFNI, MINC, "
    "MetaImage, VTI, Gaussian cube, CHGCAR, OpenDX, XSF or Zarr"
)


def opener_for(head: bytes, unpacked: bytes, suffix: str) -> Reader | None:
    """The function that opens files which begin with ``head``; by their ``suffix`` where that says
    nothing.

    ``unpacked`` is how the content of a packed file begins: NIfTI, MRC and others are read out of
    such.
    """
    kinds: list[tuple[bool, Reader]] = [
        (head.startswith(b"NRRD") or suffix in (".nrrd", ".nhdr"), nrrd.open_nrrd),
        (brain_files.is_nifti(unpacked), brain_files.open_nifti),
        (brain_files.is_analyze(unpacked, suffix), brain_files.open_analyze),
        (brain_files.is_mgh(unpacked, suffix), brain_files.open_mgh),
        (brain_files.is_afni(head, suffix), brain_files.open_afni),
        (dicom.is_dicom(head), dicom.open_dicom),
        (tiff.is_tiff(head), tiff.open_tiff),
        (mrc.is_mrc(unpacked), mrc.open_mrc),
        (brain_files.is_minc(head, suffix), brain_files.open_minc),
        (head.startswith(hdf5.HDF5_MAGIC), hdf5.open_hdf5),
        (head.startswith(hdf5.NETCDF_MAGIC), hdf5.open_netcdf),
        (head.startswith(array_files.NPY_MAGIC), array_files.open_numpy),
        (head.startswith(array_files.ZIP_MAGIC), open_archive),
        (b"<VTKFile" in head and b"ImageData" in head, image_files.open_vti),
        (
            b"NDims" in head or b"ObjectType" in head or head.startswith(b"# vtk DataFile"),
            image_files.open_itk,
        ),
        (xsf.is_xsf(unpacked), xsf.open_xsf),
        (opendx.is_dx(unpacked), opendx.open_dx),
        (cube.is_cube(unpacked), cube.open_cube),
        (vasp.is_vasp(unpacked), vasp.open_vasp),
        (suffix in (".dcm", ".ima"), dicom.open_dicom),
        (suffix == ".vti", image_files.open_vti),
        (suffix in image_files.ITK_SUFFIXES, image_files.open_itk),
    ]
    return next((opener for fits, opener in kinds if fits), None)


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
    """Open an untrusted file as a grid: no other file is opened, and no memory is taken on a
    header's word.

    Raises VolumeError, also where it has more than ``most`` voxels.
    """
    return _open_by_head(Source(name, file=file, voxels=most))


def _open_by_head(source: Source) -> Grid:
    """Open a file as a grid, by how it begins, else by its name. Raises VolumeError."""
    suffix = Path(source.name).suffix.lower()
    with source.open() as file:
        head = file.read(HEAD_BYTES)
    if sort_of(head):
        raise unknown(source.name, head)
    if array_files.is_raw(source.name):
        bare = array_files.open_raw
    else:
        bare = None
    opener = opener_for(head, _unpacked_head(source), suffix) or bare
    if opener is None:
        raise unknown(source.name, head, suffix)
    return opener(source)


def _header_of(path: Path) -> Path:
    """The header of a pair of files of which the voxels are named; any other path itself."""
    voxels = brain_files.PAIR_ENDINGS.search(path.name) is not None and ".img" in path.name.lower()
    return (brain_files.beside(path, ".hdr") if voxels else brain_files.afni_header(path)) or path


def unknown(name: str, head: bytes, suffix: str = "") -> VolumeError:
    """What is wrong with a file that is no volume, with what it seems to be where that is known."""
    sort = sort_of(head, suffix)
    return VolumeError(
        f"'{name}' seems to be {sort}."
        if sort
        else f"'{name}' is no volume that is known here: give {KNOWN_KINDS}."
    )


def _unpacked_head(source: Source) -> bytes:
    """How a file's content begins; empty where it cannot be unpacked."""
    with source.unpacked() as file:
        try:
            return file.read(HEAD_BYTES)
        except (OSError, EOFError, ValueError, zlib.error):
            return b""


def _open_folder(source: Source) -> Grid:
    """Open a folder of slices: TIFF where it holds such, else DICOM."""
    if tiff.slices_in(source):
        return tiff.open_tiff_folder(source)
    return dicom.open_dicom(source)


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
    listed = ", ".join(path.name for path in paths[:4])
    raise VolumeError(
        f"'{source.name}' holds {len(paths)} files ({listed}{' …' if len(paths) > 4 else ''}) that "
        f"are no one volume: give {SLICES_HINT}."
    )


MOST_LOOKED_AT = 64
"""Files of an archive of which it is asked whether they are a volume alone."""


def _is_whole(source: Source) -> bool:
    """Whether a file is a volume alone, and no slice of one."""
    with source.open() as file:
        head = file.read(HEAD_BYTES)
    opener = opener_for(head, _unpacked_head(source), Path(source.name).suffix.lower())
    return opener is not None and opener not in (tiff.open_tiff, dicom.open_dicom)


ZARR_FILES = ("zarr.json", ".zarray", ".zgroup")
"""Names of files by which a folder is a Zarr."""


TIFF_CODECS = ("imcd", "zlib", "deflate", "jpeg8", "zstd")
"""Packings of TIFF that are worth the time to load them, in a library that may be missing."""

TIFF_MODULES = (
    "tifffile",
    "tifffile._imagecodecs",
    "xml.etree.ElementTree",
    "imagecodecs",
    *(f"imagecodecs._{codec}" for codec in TIFF_CODECS),
)

DICOM_DECODERS = ("rle", "pillow", "pylibjpeg", "pyjpegls", "gdcm")
PILLOW_FORMATS = ("Bmp", "Gif", "Ppm", "Png", "Jpeg", "Jpeg2K")
JPEG_MODULES = ("openjpeg", *(f"PIL.{name}ImagePlugin" for name in PILLOW_FORMATS))
"""What DICOM's packed pixels are unpacked by, where it is installed."""

VTK_MODULES = (
    "vtk",
    *(
        f"vtkmodules.{name}"
        for name in ("vtkIOXML", "vtkCommonExecutionModel", "util.numpy_support")
    ),
)

BRAIN_MODULES = ("nibabel", "nibabel.freesurfer.mghformat")

LIBRARIES: tuple[tuple[int, bytes, tuple[str, ...]], ...] = (
    (0, b"\0\0\0\1", BRAIN_MODULES),
    (0, b"\x1f\x8b", (*BRAIN_MODULES, "mrcfile.utils", "mrcfile.mrcinterpreter")),
    (0, b"BZh", (*BRAIN_MODULES, "mrcfile.utils", "mrcfile.mrcinterpreter")),
    (344, b"n", ("nibabel",)),
    (4, b"n", ("nibabel",)),
    (
        128,
        b"DICM",
        (
            "pydicom.pixels",
            *(f"pydicom.pixels.decoders.{name}" for name in DICOM_DECODERS),
            *JPEG_MODULES,
        ),
    ),
    (0, b"II", TIFF_MODULES),
    (0, b"MM", TIFF_MODULES),
    (208, b"MAP", ("mrcfile.utils", "mrcfile.mrcinterpreter")),
    (0, b"\x89HDF", ("h5py", "h5py._hl.dims", "h5py._hl.filters", "nibabel.minc2")),
    (0, b"CDF", ("nibabel.externals.netcdf", "nibabel.minc1")),
    (0, b"<", VTK_MODULES),
)
"""Libraries that a file may need, by what it has at some byte."""

ARCHIVE_MODULES = ("encodings.cp437", "zipfile")


def libraries_for(head: bytes) -> list[str]:
    """Modules that a file may need which begins with ``head``: more than it does, and never
    less. An archive may hold files of all kinds but VTK's.
    """
    if head.startswith(b"PK"):
        kinds = [names for _, _, names in LIBRARIES if names is not VTK_MODULES]
        return [*ARCHIVE_MODULES, *dict.fromkeys(name for names in kinds for name in names)]
    return [name for at, mark, names in LIBRARIES if head[at:].startswith(mark) for name in names]


def split_part(name: str) -> tuple[str, dict[str, str]]:
    """A volume's name without what follows its last #, and what that chooses: ``#time=3``, or a
    path in the file.

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
