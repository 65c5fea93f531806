"""MetaImage (.mha, .mhd) and what else SimpleITK reads, an extra of its own."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, library, pick, pick_step, reader
from isogi_core.files.grid import PATIENT_AXES, SINGLE_MOMENT, Affine, Grid, read_as, slab_layers

ITK_SUFFIXES = (".mha", ".mhd", ".vtk", ".gipl", ".hdr", ".img")
ITK_TO_RAS = np.diag([-1.0, -1.0, 1.0])
"""From a patient's left, posterior, superior, which ITK means, to right, anterior, superior."""

ITK_KINDS = {".mha": "MetaImage", ".mhd": "MetaImage", ".vtk": "legacy VTK", ".gipl": "GIPL"}

ANATOMICAL_SUFFIXES = (".mha", ".mhd", ".gipl")


@reader("an image", "time", "channel")
def open_itk(source: Source) -> Grid:
    """Open an image as a grid: only its header is read now. Raises VolumeError."""
    if source.path is None:
        raise VolumeError(f"'{source.name}' cannot be uploaded in this form: save it as NIfTI or NRRD.")
    if not source.path.is_file():
        raise VolumeError(f"There is no file '{source.path}': check the volume's path.")
    image, size = _reader(source)
    channel = pick(source, "channel", int(image.GetNumberOfComponents()), "channels")
    if not 3 <= len(size) <= 4:
        raise VolumeError(f"'{source.name}' has {len(size)} dimensions, not 3: save one scalar field of it.")
    time, unchosen = pick_step(source, size[3]) if len(size) == 4 else (None, False)
    nx, ny, nz = size[:3]
    source.check((nz, ny, nx))
    dtype = _block(source, (time, channel), 0, 1).dtype
    steps = np.array(image.GetSpacing()[:3])
    direction = np.array(image.GetDirection()).reshape(len(size), len(size))[:3, :3]
    origin = np.array(image.GetOrigin()[:3])
    anatomical = source.path.suffix.lower() in ANATOMICAL_SUFFIXES
    affine = np.column_stack([direction * steps, origin])
    placed = Affine.of(ITK_TO_RAS @ affine, PATIENT_AXES) if anatomical else Affine.of(affine)
    spacing = (float(steps[0]), float(steps[1]), float(steps[2]))
    slabs = partial(_itk_slabs, source, (time, channel), (nz, ny, nx), dtype.itemsize)
    unit, moment = "mm" if anatomical else "", SINGLE_MOMENT if time is None else (time, int(size[3]))
    stamp = partial(source.stamp, *_data_files(source))
    known = read_as(
        f"{ITK_KINDS.get(source.path.suffix.lower(), 'an image of ITK')}", dtype, "its directions and origin"
    )
    return Grid(
        (nz, ny, nx), dtype, spacing, slabs, stamp, placed, unit, moment=moment, unchosen=unchosen, read_as=known
    )


def _reader(source: Source) -> tuple[Any, tuple[int, ...]]:
    """A reader that has read the header, and the size along x, y, z and time."""
    sitk = library("SimpleITK", "MetaImage", "'isogi[itk]'")
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(source.path))
    reader.ReadImageInformation()
    return reader, tuple(int(n) for n in reader.GetSize())


def _data_files(source: Source) -> list[Any]:
    """Files beside the header that may hold its voxels."""
    assert source.path is not None, "an image of ITK has a path"
    beside = [source.path.with_suffix(suffix) for suffix in (".raw", ".zraw", ".img")]
    return [path for path in beside if path.is_file() and path != source.path]


Chosen = tuple[int | None, int]
"""The step in time, None where there is no such axis, and the number of each voxel."""


def _itk_slabs(source: Source, chosen: Chosen, shape: tuple[int, ...], itemsize: int) -> Iterator[np.ndarray]:
    step = slab_layers(shape[1] * shape[2] * itemsize)
    for z in range(0, shape[0], step):
        yield _block(source, chosen, z, min(step, shape[0] - z))


def _block(source: Source, chosen: Chosen, first: int, count: int) -> np.ndarray:
    """Some layers, (count, ny, nx)."""
    reader, size = _reader(source)
    extra = [step for step in chosen[:1] if step is not None]
    reader.SetExtractIndex([0, 0, first, *extra])
    reader.SetExtractSize([size[0], size[1], count, *(0 for _ in extra)])
    sitk = library("SimpleITK", "MetaImage", "'isogi[itk]'")
    voxels = np.asarray(sitk.GetArrayFromImage(reader.Execute()))
    return voxels[..., chosen[1]] if voxels.ndim > 3 else voxels
