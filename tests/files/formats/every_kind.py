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
        for write in (numpy_files, nifti, dicom, tiff, mrc, hdf5, netcdf, vti, chemistry)
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


def chemistry(folder: Path) -> Iterator[Path]:
    """Text of four kinds, one of them packed."""
    nz, ny, nx = F.shape
    values = F.astype(float)
    (cube, crystal, dx, xsf) = (folder / name for name in ("f.cube", "ELFCAR.gz", "f.dx", "f.xsf"))
    head = f"made\nfor a test\n 1 0 0 0\n {nx} 1 0 0\n {ny} 0 1.25 0\n {nz} 0 0 1.5\n 6 6 0 0 0\n"
    cube.write_text(head + numbers(values.T))
    cell = f"{nx} 0 0\n0 {1.25 * ny} 0\n0 0 {1.5 * nz}\n"
    head = f"made\n1.0\n{cell} C\n 1\nDirect\n 0 0 0\n\n {nx} {ny} {nz}\n"
    crystal.write_bytes(gzip.compress((head + numbers(values)).encode(), mtime=0))
    head = f"object 1 class gridpositions counts {nx} {ny} {nz}\norigin 0 0 0\n"
    head += "delta 1 0 0\ndelta 0 1.25 0\ndelta 0 0 1.5\n"
    head += f"object 3 class array type float rank 0 items {F.size} data follows\n"
    dx.write_text(head + numbers(values.T))
    head = "ATOMS\n 6 0 0 0\nBEGIN_BLOCK_DATAGRID_3D\n made\n DATAGRID_3D_f\n"
    xsf.write_text(f"{head} {nx} {ny} {nz}\n 0 0 0\n{cell}{numbers(values)} END_DATAGRID_3D\n")
    yield from (cube, crystal, dx, xsf)


def numbers(field: np.ndarray) -> str:
    """Numbers of an array in its own order, six a line."""
    flat = [f" {value:.5E}" for value in field.ravel()]
    return "".join("".join(flat[n : n + 6]) + "\n" for n in range(0, len(flat), 6))


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
