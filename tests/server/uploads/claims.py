"""Small files that claim much: each would have its reader take gigabytes on its word."""

import io
import struct
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tests.files.formats.dicom_files import dataset
from tests.files.formats.phantom import affine, letter

F = letter()
HUGE = 2**31 - 1


def written(folder: Path) -> list[Path]:
    """The files in a ``folder``, which is made."""
    folder.mkdir(exist_ok=True)
    paths = []
    for make in (mrc, nifti, dicom, tiff, hdf5, numpy_files, vti):
        for name, data in make(folder):
            paths.append(folder / name)
            paths[-1].write_bytes(data)
    return paths


Files = Iterator[tuple[str, bytes]]


def mrc(folder: Path) -> Files:
    """Extended headers and sizes that are not there."""
    import mrcfile

    with mrcfile.new(folder / "good", F.astype(np.float32), overwrite=True):
        pass
    good = (folder / "good").read_bytes()
    yield "extended.mrc", good[:92] + struct.pack("<i", HUGE) + good[96:]
    yield "backward.mrc", good[:92] + struct.pack("<i", -1024) + good[96:]
    yield "sizes.mrc", struct.pack("<3i", 400, 400, 400) + good[12:]


def nifti(folder: Path) -> Files:
    """An extension, an offset and sizes that are not there."""
    nib = import_module("nibabel")
    nib.save(nib.Nifti1Image(F.T, affine()), folder / "good.nii")
    good = (folder / "good.nii").read_bytes()
    extension = struct.pack("<4B2i", 1, 0, 0, 0, HUGE // 16 * 16, 0)
    yield (
        "extension.nii",
        good[:108] + struct.pack("<f", 2.0**31) + good[112:348] + extension + good[352:],
    )
    yield "offset.nii", good[:108] + struct.pack("<f", 2.0**40) + good[112:]
    yield "sizes.nii", good[:40] + struct.pack("<4h", 3, 400, 400, 400) + good[48:]


def dicom(folder: Path) -> Files:
    """Deflated zeros, and frames that are not there."""
    deflated = "1.2.840.10008.1.2.1.99"
    made: Any = dataset(F[0], affine(), 0, NumberOfFrames=12, PixelData=F.astype("<i2").tobytes())
    made.save_as(folder / "good", enforce_file_format=True)
    made.file_meta.TransferSyntaxUID = deflated
    made.PixelData = bytes(300 << 20)
    made.save_as(folder / "bomb", enforce_file_format=True)
    yield "deflated.dcm", (folder / "bomb").read_bytes()
    made.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2.1"
    made.PixelData = F.astype("<i2").tobytes()
    made.NumberOfFrames = HUGE
    made.save_as(folder / "many", enforce_file_format=True)
    yield "frames.dcm", (folder / "many").read_bytes()
    made.NumberOfFrames = 12
    made.Rows = 65535
    made.Columns = 65535
    made.save_as(folder / "wide", enforce_file_format=True)
    yield "sizes.dcm", (folder / "wide").read_bytes()


def tiff(folder: Path) -> Files:
    """A page of many voxels, a tile larger than its page, a tag of many values, and zeros that are
    packed.
    """
    import tifffile

    tifffile.imwrite(folder / "good", F, photometric="minisblack")
    yield "width.tif", patched((folder / "good").read_bytes(), 256, HUGE)
    yield "counts.tif", patched((folder / "good").read_bytes(), 273, HUGE, at=4)
    tifffile.imwrite(
        folder / "tiled", np.zeros((4, 64, 64), np.uint8), tile=(64, 64), photometric="minisblack"
    )
    tiled = (folder / "tiled").read_bytes()
    yield "tiles.tif", patched(patched(tiled, 322, 1 << 15), 323, 1 << 15)
    big = io.BytesIO()
    tifffile.imwrite(
        big, np.zeros((2, 20000, 20000), np.uint8), compression="zlib", photometric="minisblack"
    )
    yield "packed.tif", big.getvalue()


def patched(data: bytes, tag: int, value: int, at: int = 8) -> bytes:
    """A little-endian TIFF whose first page has a number in a tag: its value, or ``at`` 4 its
    count.
    """
    start = struct.unpack_from("<I", data, 4)[0]
    count = struct.unpack_from("<H", data, start)[0]
    for place in range(start + 2, start + 2 + 12 * count, 12):
        if struct.unpack_from("<H", data, place)[0] == tag:
            if at == 8:
                kind = b"\x04\x00"
            else:
                kind = data[place + 2 : place + 4]
            entry = bytearray(data[place : place + 12])
            entry[2:4] = kind
            struct.pack_into("<I", entry, at, value)
            return data[:place] + bytes(entry) + data[place + 12 :]
    raise AssertionError(f"there is no tag {tag}")


def hdf5(folder: Path) -> Files:
    """A virtual dataset, chunks that are larger than what is read of them, and values that are
    elsewhere.
    """
    h5py = import_module("h5py")

    def file(name: str, make: Callable[[Any], object]) -> tuple[str, bytes]:
        with h5py.File(folder / name, "w") as whole:
            make(whole)
        return name, (folder / name).read_bytes()

    def virtual(whole: Any) -> None:
        layout = h5py.VirtualLayout((400, 400, 400), "f8")
        whole.create_dataset("small", data=np.ones((2, 2)))
        for z in range(400):
            layout[z, :2, :2] = h5py.VirtualSource(".", "small", (2, 2))
        whole.create_virtual_dataset("field", layout, fillvalue=1.0)

    def one_chunk(kind: str, side: int, *chunk: int) -> Callable[[Any], object]:
        shape = {"shape": (side,) * 3, "maxshape": (None,) * 3}

        def make(whole: Any) -> None:
            whole.create_dataset("field", **shape, dtype=kind, chunks=chunk, compression="gzip")[
                0, 0, 0
            ] = 1

        return make

    yield file("virtual.h5", virtual)
    yield file("chunk.h5", one_chunk("f8", 400, 400, 400, 400))
    yield file("chunks.h5", one_chunk("u1", 4, 100, 1000, 1000))
    yield file("hole.h5", lambda whole: whole.create_dataset("field", (4000, 4000, 4000), "f8"))
    external = [("/etc/passwd", 0, 400**3)]
    yield file(
        "external.h5",
        lambda whole: whole.create_dataset("field", (400, 400, 400), "u1", external=external),
    )
    lines = h5py.string_dtype()
    yield file("strings.h5", lambda whole: whole.create_dataset("field", (400, 400, 400), lines))


def numpy_files(folder: Path) -> Files:
    """Sizes that are not there, and zeros that are packed."""
    good = io.BytesIO()
    np.save(good, F)
    shape = str(F.shape).encode()
    yield "sizes.npy", good.getvalue().replace(shape + b", }", b"(400,400,400), }")
    yield (
        "fortran.npy",
        good.getvalue().replace(b"False", b"True ").replace(shape + b", }", b"(400,400,400), }"),
    )
    np.savez_compressed(folder / "zeros.npz", np.zeros((3, 400, 400, 400), np.float32))
    yield "zeros.npz", (folder / "zeros.npz").read_bytes()


def vti(folder: Path) -> Files:
    """Points that are not there."""
    extent = "0 399 0 399 0 399"
    piece = f'<Piece Extent="{extent}"><PointData>'
    array = (
        '<DataArray type="Float64" Name="a" format="ascii">1 2 3</DataArray></PointData></Piece>'
    )
    head = f'<?xml version="1.0"?><VTKFile type="ImageData"><ImageData WholeExtent="{extent}">'
    yield "points.vti", f"{head}{piece}{array}</ImageData></VTKFile>".encode()
