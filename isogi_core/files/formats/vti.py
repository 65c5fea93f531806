"""VTK's image files (.vti), read by VTK, an extra of its own."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, library, reading
from isogi_core.files.grid import Affine, Grid, layers_of

INSTALL = "'isogi[vtk]'"


def open_vti(source: Source) -> Grid:
    """Open an array of an image file as a grid: only its description is read now. Raises VolumeError."""
    if source.path is None:
        raise VolumeError(f"'{source.name}' cannot be uploaded in this form: save it as NIfTI or NRRD.")
    source.refuse_others("part")
    with reading(source.name, "VTI"):
        reader, about = _reader(source)
        extent = _extent(about)
        shape = tuple(extent[2 * axis + 1] - extent[2 * axis] + 1 for axis in (2, 1, 0))
        source.check(shape)
        name = _name(source, reader)
        dtype = _block(source, name, extent, 0, 1).dtype
        pipeline = library("vtkmodules.vtkCommonDataModel", "VTI", INSTALL).vtkDataObject
        steps = np.array(about.Get(pipeline.SPACING()))
        direction = about.Get(pipeline.DIRECTION()) if about.Has(pipeline.DIRECTION()) else np.eye(3).ravel()
        matrix = np.array(direction).reshape(3, 3) * steps
        origin = np.array(about.Get(pipeline.ORIGIN())) + matrix @ np.array(extent[::2])
    spacing = (float(steps[0]), float(steps[1]), float(steps[2]))
    slabs = partial(_slabs, source, name, extent, layers_of(shape[1] * shape[2] * dtype.itemsize))
    affine = Affine.of(np.column_stack([matrix, origin]))
    return Grid(shape, dtype, spacing, slabs, source.stamp, affine)


def _reader(source: Source) -> tuple[Any, Any]:
    """A reader that has read the description, and that."""
    library("vtk", "VTI", INSTALL)
    reader = library("vtkmodules.vtkIOXML", "VTI", INSTALL).vtkXMLImageDataReader()
    if source.path is None or not reader.CanReadFile(str(source.path)):
        raise VolumeError(f"'{source.name}' is no image file of VTK: check the volume's path.")
    reader.SetFileName(str(source.path))
    reader.UpdateInformation()
    return reader, reader.GetOutputInformation(0)


def _extent(about: Any) -> list[int]:
    pipeline = library("vtkmodules.vtkCommonExecutionModel", "VTI", INSTALL).vtkStreamingDemandDrivenPipeline
    return [int(n) for n in about.Get(pipeline.WHOLE_EXTENT())]


def _name(source: Source, reader: Any) -> str:
    """The name of the array of points that is chosen, the only one by default."""
    names = [reader.GetPointArrayName(n) for n in range(reader.GetNumberOfPointArrays())]
    chosen = source.chosen.get("part") or ("value" if "value" in names else names[0] if len(names) == 1 else None)
    if chosen not in names:
        listed = ", ".join(f"'{source.name}#{name}'" for name in names) or "none"
        raise VolumeError(f"'{source.name}' holds several arrays, or none of that name: choose of {listed}.")
    return str(chosen)


def _slabs(source: Source, name: str, extent: list[int], step: int) -> Iterator[np.ndarray]:
    depth = extent[5] - extent[4] + 1
    for z in range(0, depth, step):
        with reading(source.name, "VTI"):
            slab = _block(source, name, extent, z, min(step, depth - z))
        yield slab


def _block(source: Source, name: str, extent: list[int], first: int, count: int) -> np.ndarray:
    """Some layers of an array, (count, ny, nx)."""
    reader, _ = _reader(source)
    reader.UpdateExtent([*extent[:4], extent[4] + first, extent[4] + first + count - 1])
    image = reader.GetOutput()
    array = image.GetPointData().GetArray(name)
    if array is None or array.GetNumberOfComponents() != 1:
        raise VolumeError(f"'{source.name}#{name}' is no array of one number a point: choose another.")
    values = library("vtkmodules.util.numpy_support", "VTI", INSTALL).vtk_to_numpy(array)
    nx, ny, nz = image.GetDimensions()
    first -= image.GetExtent()[4] - extent[4]
    return np.array(values.reshape(nz, ny, nx)[first : first + count])
