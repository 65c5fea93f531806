"""Files of each kind: seconds of one command from the file to a lit picture, and memory where the
file is large.

    python -m benchmarks.scaling kinds [--size 96] [--large 1024] [--volume-mb 128] [--seconds 90]
    [--folder DIR]

One field is written as each kind by the library that its field keeps. `isogi render` draws each,
with caches of its own, so that the copy of a large one is made and its light is baked anew. The
field repeats a block of 128 voxels: `--large 1024` makes a NIfTI of 2 GiB (int16) and a TIFF of 1
GiB (uint8). Memory is the most that the command's own process, and its worker, had at once: its own
and pages of files together.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import click
import nrrd
import numpy as np
import zarr

from benchmarks.common.measurement import Measurement
from benchmarks.common.suite import part
from benchmarks.scaling.large import gyroid
from benchmarks.scaling.residents import Residents
from tests.files.formats.dicom_files import write_series

BLOCK = 128
"""Voxels along a side of what a large field repeats."""

ERROR = "0.1"
"""Error at which a picture is done."""

Writer = Callable[[Path, np.ndarray], object]


def field(size: int, dtype: type[np.generic]) -> np.ndarray:
    """A gyroid in a ball, repeated where ``size`` is above BLOCK; its skin is at half of 120."""
    block = (gyroid(min(size, BLOCK), 0, min(size, BLOCK)) // 500).astype(dtype)
    times = -(-size // len(block))
    return np.tile(block, (times,) * 3)[:size, :size, :size]


def write_nifti(path: Path, array: np.ndarray) -> None:
    """NIfTI-1, packed where the name says so."""
    nib = import_module("nibabel")

    nib.save(nib.Nifti1Image(array.T, np.eye(4)), path)


def write_tiff(path: Path, array: np.ndarray) -> None:
    """A stack of pages."""
    tifffile = import_module("tifffile")

    tifffile.imwrite(path, array, photometric="minisblack", bigtiff=array.nbytes > 1 << 31)


def write_mrc(path: Path, array: np.ndarray) -> None:
    """MRC2014."""
    mrcfile = import_module("mrcfile")

    with mrcfile.new(path, data=array):
        pass


def write_hdf5(path: Path, array: np.ndarray) -> None:
    """One packed dataset."""
    h5py = import_module("h5py")

    with h5py.File(path, "w") as file:
        chunks = tuple(min(n, most) for n, most in zip(array.shape, (16, 64, 64), strict=True))
        file.create_dataset("x", data=array, chunks=chunks, compression="gzip")


def write_itk(path: Path, array: np.ndarray) -> None:
    """MetaImage."""
    sitk = import_module("SimpleITK")

    sitk.WriteImage(sitk.GetImageFromArray(array), str(path))


def write_vti(path: Path, array: np.ndarray) -> None:
    """VTK's image data, raw at the file's end."""
    vtk = import_module("vtk")
    numpy_to_vtk = import_module("vtk.util.numpy_support").numpy_to_vtk

    image = vtk.vtkImageData()
    image.SetDimensions(array.shape[::-1])
    values = numpy_to_vtk(array.ravel())
    values.SetName("value")
    image.GetPointData().SetScalars(values)
    writer = vtk.vtkXMLImageDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    writer.Write()


def write_cube(path: Path, array: np.ndarray) -> None:
    """Gaussian cube, its values as text; x is the slowest of its axes."""
    axes = "".join(
        f"{n} {' '.join('1.0' if axis == step else '0.0' for axis in range(3))}\n"
        for step, n in enumerate(array.shape[::-1])
    )
    with path.open("w", encoding="ascii") as file:
        file.write(f"A gyroid in a ball\nby rows along z\n1 0.0 0.0 0.0\n{axes}1 1.0 0.0 0.0 0.0\n")
        np.savetxt(file, array.T.reshape(-1, array.shape[0]), fmt="%13.5E")


def write_zarr(path: Path, array: np.ndarray) -> None:
    """A Zarr array, v3."""
    zarr.create_array(path, shape=array.shape, chunks=(32,) * 3, dtype=array.dtype)[:] = array


def write_dicom(path: Path, array: np.ndarray) -> None:
    """A folder with a file for each layer."""
    write_series(path, array, np.eye(4))


WRITERS: dict[str, Writer] = {
    "f.nrrd": lambda path, array: nrrd.write(str(path), array, index_order="C"),
    "f.npy": np.save,
    "f.nii": write_nifti,
    "f.nii.gz": write_nifti,
    "f.tif": write_tiff,
    "f.mrc": write_mrc,
    "f.h5": write_hdf5,
    "f.mha": write_itk,
    "f.vti": write_vti,
    "f.cube": write_cube,
    "f.zarr": write_zarr,
    "dicom": write_dicom,
}
"""How a file of each name is written."""


def render(volume: Path, folder: Path, *more: str, **environment: str) -> dict[str, float]:
    """Seconds of `isogi render`, how much of its picture is lit, and memory; its caches are in
    ``folder``.
    """
    places = {"ISOGI_VOLUME_CACHE": str(folder / "copies"), **environment}
    given = [
        "-o",
        str(folder / "picture.png"),
        "--store",
        str(folder / "store"),
        "--workers",
        "1",
        "--json",
    ]
    size = ["--width", "128", "--height", "128", "--isovalue", "60", "--target-error", ERROR]
    begun = time.monotonic()
    told = [sys.executable, "-m", "isogi_server", "render", str(volume), *given, *size, *more]
    process = subprocess.Popen(told, env={**os.environ, **places}, stdout=subprocess.PIPE)
    residents = Residents(process.pid)
    output, _ = process.communicate()
    residents.stop()
    if process.returncode:
        raise click.ClickException(
            f"isogi render of {volume.name} ended with {process.returncode}."
        )
    facts = json.loads(output)
    seconds = time.monotonic() - begun
    lit = facts["coverage"]["final"] + facts["coverage"]["converging"]
    held = {
        f"{role}: memory at most, MiB": residents.most[f"{role}: both, MiB"]
        for role in ("main", "worker")
    }
    return {"seconds": seconds, "final share": facts["final"], "lit share": lit, **held}


@part()
@click.option(
    "--size", type=click.IntRange(32, 512), default=96, show_default=True, help="Voxels a side."
)
@click.option(
    "--large",
    type=click.IntRange(128, 2048),
    help="Voxels a side of a large NIfTI and a large TIFF.",
)
@click.option(
    "--volume-mb",
    type=click.IntRange(1),
    default=128,
    show_default=True,
    help="ISOGI_VOLUME_MB of these.",
)
@click.option(
    "--seconds",
    type=click.IntRange(1),
    default=90,
    show_default=True,
    help="To light each of these.",
)
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), help="Where large files go."
)
def kinds(
    size: int, large: int | None, volume_mb: int, seconds: int, folder: Path | None
) -> Iterator[Measurement]:
    """Files of each kind: seconds from a file to a lit picture, and memory where it is large."""
    if large is None:
        yield Measurement(f"A lit picture from files of {size}³ voxels, int16", all_kinds(size))
    else:
        with tempfile.TemporaryDirectory(dir=folder) as temporary:
            figures = large_files(Path(temporary), large, volume_mb, seconds)
        yield Measurement(f"A NIfTI and a TIFF of {large}³ voxels", figures, variant="large")


def all_kinds(size: int) -> dict[str, float]:
    """The figures of files of each kind; where the library that writes a kind is missing, it is
    named and left out.
    """
    figures: dict[str, float] = {}
    array = field(size, np.int16)
    for name, write in WRITERS.items():
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            try:
                write(folder / name, array)
            except ModuleNotFoundError as error:
                click.echo(f"{name} is left out: {error.name} is not installed.", err=True)
                continue
            figures |= {
                f"{name}: {what}": value for what, value in render(folder / name, folder).items()
            }
    return figures


def large_files(folder: Path, size: int, volume_mb: int, seconds: int) -> dict[str, float]:
    """The figures of two large files, lit for some ``seconds``, in a lattice with about a texel a
    pixel.
    """
    figures: dict[str, float] = {}
    files: dict[str, type[np.generic]] = {"f.nii": np.int16, "f.tif": np.uint8}
    for name, dtype in files.items():
        place = folder / name.removeprefix("f.")
        place.mkdir()
        WRITERS[name](place / name, field(size, dtype))
        (place / "s.toml").write_text(f'volume = "{name}"\nlattice = 0.125\nrotating = false\n')
        figures[f"{name}: file, MiB"] = (place / name).stat().st_size / 2**20
        found = render(
            place / "s.toml", place, "--time", f"{seconds}s", ISOGI_VOLUME_MB=str(volume_mb)
        )
        figures |= {f"{name}: {what}": value for what, value in found.items()}
    return figures
