"""The letter F in a file of each kind that may be uploaded, by the libraries that are installed."""

import gzip
import importlib.util
import zlib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.files.light_files import LitVolume, vti_bytes
from tests.files.formats.dicom_files import dataset
from tests.files.formats.phantom import affine, letter

F = letter()


def present(name: str) -> bool:
    """Whether a library is installed."""
    return importlib.util.find_spec(name) is not None


def written(folder: Path) -> list[Path]:
    """Files in a ``folder``, which is made."""
    folder.mkdir(exist_ok=True)
    return [
        path
        for write in (numpy_files, nifti, dicom, tiff, mrc, hdf5, netcdf, vti)
        for path in write(folder)
    ]


def numpy_files(folder: Path) -> Iterator[Path]:
    np.save(folder / "f.npy", F)
    np.savez_compressed(folder / "f.npz", F)
    yield from (folder / "f.npy", folder / "f.npz")


def nifti(folder: Path) -> Iterator[Path]:
    if present("nibabel"):
        nib = import_module("nibabel")

        nib.save(nib.Nifti1Image(F.T, affine()), folder / "f.nii")
        (folder / "f.nii.gz").write_bytes(gzip.compress((folder / "f.nii").read_bytes(), mtime=0))
        yield from (folder / "f.nii", folder / "f.nii.gz")


def dicom(folder: Path) -> Iterator[Path]:
    if present("pydicom"):
        made: Any = dataset(
            F[0], affine(), 0, NumberOfFrames=12, PixelData=F.astype("<i2").tobytes()
        )
        made.save_as(folder / "f.dcm", enforce_file_format=True)
        yield folder / "f.dcm"


def tiff(folder: Path) -> Iterator[Path]:
    if present("tifffile"):
        import tifffile

        tifffile.imwrite(folder / "f.tif", F, photometric="minisblack")
        tifffile.imwrite(folder / "g.tif", F, photometric="minisblack", compression="zlib")
        yield from (folder / "f.tif", folder / "g.tif")


def mrc(folder: Path) -> Iterator[Path]:
    if present("mrcfile"):
        mrcfile = import_module("mrcfile")

        with mrcfile.new(folder / "f.mrc") as made:
            made.set_data(F)
        yield folder / "f.mrc"


def hdf5(folder: Path) -> Iterator[Path]:
    if present("h5py"):
        h5py = import_module("h5py")

        with h5py.File(folder / "f.h5", "w") as file:
            file.create_dataset("x", data=F, chunks=(4, 8, 8), compression="gzip")
        yield folder / "f.h5"


def netcdf(folder: Path) -> Iterator[Path]:
    if present("nibabel") and present("scipy"):
        write_classic(folder / "f.nc", {"v": F})
        yield folder / "f.nc"


def write_classic(
    path: Path, fields: dict[str, np.ndarray], version: int = 1, **coordinates: tuple[Any, str]
) -> None:
    """Write a classic NetCDF file of ``fields`` (z, y, x), or with time before these, which is its
    record.

    ``coordinates`` of dimensions are values and a unit.
    """
    with import_module("scipy.io").netcdf_file(path, "w", version=version) as file:
        sizes = {
            name: n
            for field in fields.values()
            for name, n in zip("xyzt", field.shape[::-1], strict=False)
        }
        for name in sorted(sizes, key="tzyx".index):  # records come first
            file.createDimension(name, None if name == "t" else sizes[name])
        for name, (values, unit) in coordinates.items():
            made = file.createVariable(name, "f8", (name,))
            made[:] = values
            made.units = unit
        for name, field in fields.items():
            file.createVariable(name, field.dtype, tuple("tzyx"[-field.ndim :]))[:] = field


def metaimage(folder: Path) -> Iterator[Path]:
    """Files that no upload may be: what reads them needs a path."""
    nz, ny, nx = F.shape
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "BinaryData = True",
        "BinaryDataByteOrderMSB = False",
    ]
    lines += [
        "CompressedData = {packed}",
        f"DimSize = {nx} {ny} {nz}",
        "ElementSpacing = 1 1.25 1.5",
    ]
    header = "\n".join([*lines, "ElementType = MET_SHORT", "ElementDataFile = LOCAL", ""])
    body = F.astype("<i2").tobytes()
    for name, packed, data in (("f.mha", "False", body), ("g.mha", "True", zlib.compress(body))):
        (folder / name).write_bytes(header.format(packed=packed).encode() + data)
        yield folder / name


def vti(folder: Path) -> Iterator[Path]:
    if present("vtk"):
        (folder / "f.vti").write_bytes(vti_bytes(LitVolume({"value": F}, affine()[:3])))
        yield folder / "f.vti"
