"""MetaImage (.mha, .mhd) and what else SimpleITK reads, and VTK's image files (.vti, .pvti) and
rectilinear grids (.vtr), read by VTK: both are extras.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import Along, place_by
from isogi_core.files.formats.source import Source, library, pick, pick_step, reader
from isogi_core.files.grid import (
    PATIENT_AXES,
    SINGLE_MOMENT,
    Affine,
    Grid,
    Shape,
    read_as,
    slab_layers,
)

ITK_SUFFIXES = (".mha", ".mhd", ".vtk", ".gipl", ".hdr", ".img")
ITK_TO_RAS = np.diag([-1.0, -1.0, 1.0])
"""From a patient's left, posterior, superior, which ITK means, to right, anterior, superior."""

ITK_KINDS = {".mha": "MetaImage", ".mhd": "MetaImage", ".vtk": "legacy VTK", ".gipl": "GIPL"}

ANATOMICAL_SUFFIXES = (".mha", ".mhd", ".gipl")


@reader("an image", "time", "channel")
def open_itk(source: Source) -> Grid:
    """Open an image as a grid: only its header is read now. Raises VolumeError."""
    if source.path is None:
        raise VolumeError(
            f"'{source.name}' is read neither from an upload nor from a ZIP file: save it as NIfTI "
            "or NRRD."
        )
    if not source.path.is_file():
        raise VolumeError(f"There is no file '{source.path}': check the volume's path.")
    image, size = _reader(source)
    channel = pick(source, "channel", int(image.GetNumberOfComponents()), "channels")
    if not 3 <= len(size) <= 4:
        raise VolumeError(
            f"'{source.name}' has {len(size)} dimensions, not 3: save one scalar field of it."
        )
    if len(size) == 4:
        time, unchosen = pick_step(source, size[3])
    else:
        time = None
        unchosen = False
    nx, ny, nz = size[:3]
    source.check((nz, ny, nx))
    dtype = _block(source, (time, channel), 0, 1).dtype
    steps = np.array(image.GetSpacing()[:3])
    direction = np.array(image.GetDirection()).reshape(len(size), len(size))[:3, :3]
    origin = np.array(image.GetOrigin()[:3])
    anatomical = source.path.suffix.lower() in ANATOMICAL_SUFFIXES
    affine = np.column_stack([direction * steps, origin])
    if anatomical:
        placed = Affine.of(ITK_TO_RAS @ affine, PATIENT_AXES)
    else:
        placed = Affine.of(affine)
    spacing = (float(steps[0]), float(steps[1]), float(steps[2]))
    slabs = partial(_itk_slabs, source, (time, channel), (nz, ny, nx), dtype.itemsize)
    unit = "mm" if anatomical else ""
    if time is None:
        moment = SINGLE_MOMENT
    else:
        moment = (time, int(size[3]))
    stamp = partial(source.stamp, *_data_files(source))
    known = read_as(
        f"{ITK_KINDS.get(source.path.suffix.lower(), 'an image of ITK')}",
        dtype,
        "its directions and origin",
    )
    return Grid(
        (nz, ny, nx),
        dtype,
        spacing,
        slabs,
        stamp,
        placed,
        unit,
        moment=moment,
        unchosen=unchosen,
        read_as=known,
    )


def _reader(source: Source) -> tuple[Any, tuple[int, ...]]:
    """Return a reader that has read the header, and the size along x, y, z and time."""
    sitk = library("SimpleITK", "MetaImage", "'isogi[itk]'")
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(source.path))
    reader.ReadImageInformation()
    return reader, tuple(int(n) for n in reader.GetSize())


def _data_files(source: Source) -> list[Any]:
    """Return the files next to the header that may hold its voxels."""
    assert source.path is not None, "an image of ITK has a path"
    beside = [source.path.with_suffix(suffix) for suffix in (".raw", ".zraw", ".img")]
    return [path for path in beside if path.is_file() and path != source.path]


Chosen = tuple[int | None, int]
"""The step in time, None if there is no such axis, and the number of each voxel."""


def _itk_slabs(
    source: Source, chosen: Chosen, shape: tuple[int, ...], itemsize: int
) -> Iterator[np.ndarray]:
    step = slab_layers(shape[1] * shape[2] * itemsize)
    for z in range(0, shape[0], step):
        yield _block(source, chosen, z, min(step, shape[0] - z))


def _block(source: Source, chosen: Chosen, first: int, count: int) -> np.ndarray:
    """Return some layers, (count, ny, nx)."""
    reader, size = _reader(source)
    extra = [step for step in chosen[:1] if step is not None]
    reader.SetExtractIndex([0, 0, first, *extra])
    reader.SetExtractSize([size[0], size[1], count, *(0 for _ in extra)])
    sitk = library("SimpleITK", "MetaImage", "'isogi[itk]'")
    voxels = np.asarray(sitk.GetArrayFromImage(reader.Execute()))
    if voxels.ndim > 3:
        return voxels[..., chosen[1]]
    return voxels


VTK_EXTRA = "'isogi[vtk]'"

CLOSING_TAG = b"</VTKFile>"
TAIL_BYTES = 64
"""How a file ends that is whole, and how many of its last bytes are looked at: VTK reads others as
if they were.
"""


@reader("VTI", "part", "channel")
def open_vti(source: Source) -> Grid:
    """Open an array of an image file as a grid: only its description is read now. Raises
    VolumeError.
    """
    return _grid_of(ImageFile(source), source, "VTI")


PIECE_SOURCE = re.compile(rb"<Piece\b[^>]*\bSource\s*=\s*[\"']([^\"']+)[\"']")
MOST_LIST_BYTES = 1 << 24
"""Bytes of a list of pieces that are looked at."""


@reader("PVTI", "part", "channel")
def open_pvti(source: Source) -> Grid:
    """Open an image file whose pieces are other files, as programs on many processors write it.
    Raises VolumeError.
    """
    if source.path is None:
        raise VolumeError(
            f"'{source.name}' lists pieces in other files: save it as one .vti file, in ParaView."
        )
    with source.open() as file:
        names = PIECE_SOURCE.findall(file.read(MOST_LIST_BYTES))
    pieces = [source.path.parent / name.decode("utf-8", "replace") for name in names]
    missing = [piece.name for piece in pieces if not piece.is_file()]
    if missing:
        raise VolumeError(
            f"'{source.name}' lists pieces in other files, and '{missing[0]}' is not there: put it "
            "there."
        )
    grid = _grid_of(ImageFile(source, "vtkXMLPImageDataReader"), source, "PVTI")
    return replace(grid, stamp=partial(source.stamp, *pieces))


@reader("VTR", "part", "channel")
def open_vtr(source: Source) -> Grid:
    """Open an array of a rectilinear grid, by the coordinates of its axes. Raises VolumeError."""
    image = ImageFile(source, "vtkXMLRectilinearGridReader")
    grid = _grid_of(image, source, "VTR")
    axes = image.coordinates()
    # If the coordinates are those of corners, the values belong to cells: take their middles.
    if grid.shape != tuple(len(each) for each in axes[::-1]):
        axes = [(each[1:] + each[:-1]) / 2.0 for each in axes]
    place = place_by([Along(each) for each in axes])
    # Uneven coordinates, of which there is a note, do not place the voxels.
    placed = "its coordinates" if place.said and not place.notes else ""
    return replace(
        grid,
        spacing=place.spacing,
        affine=place.affine,
        notes=(*grid.notes, *place.notes),
        read_as=read_as("VTR", grid.dtype, placed),
    )


def _grid_of(image: "ImageFile", source: Source, kind: str) -> Grid:
    """Make the grid of the array of an image file that is chosen. Raises VolumeError."""
    name = _name(source, image.names)
    shape = image.shape(name)
    source.check(shape)
    number = pick(source, "channel", image.numbers(name), "channels")
    dtype = image.layers(name, 0, 1).dtype
    matrix = image.direction * image.spacing
    origin = image.origin + matrix @ (np.array(image.extent[::2]) + 0.5 * image.of_cells(name))
    steps = image.spacing
    spacing = (float(steps[0]), float(steps[1]), float(steps[2]))
    slabs = partial(
        _point_slabs,
        image,
        (name, number),
        shape[0],
        slab_layers(shape[1] * shape[2] * dtype.itemsize),
    )
    affine = Affine.of(np.column_stack([matrix, origin]))
    return Grid(
        shape,
        dtype,
        spacing,
        slabs,
        source.stamp,
        affine,
        read_as=read_as(kind, dtype, "its origin and spacing"),
    )


class ImageFile:
    """An image file that VTK reads: from its path, or, of an upload, from memory. Raises
    VolumeError on damage.
    """

    def __init__(self, source: Source, reader: str = "vtkXMLImageDataReader") -> None:
        """Read the description, by a ``reader`` of VTK."""
        self.name = source.name
        self._errors: list[str] = []
        self._check_end(source)
        library("vtk", "VTI", VTK_EXTRA)
        self._reader = getattr(library("vtkmodules.vtkIOXML", "VTI", VTK_EXTRA), reader)()
        self._reader.AddObserver("ErrorEvent", lambda _, event: self._errors.append(event))
        if source.path is not None:
            self._reader.SetFileName(str(source.path))
        else:
            with source.open() as file:
                self._reader.ReadFromInputStringOn()
                self._reader.SetInputString(file.read())
        self._reader.UpdateInformation()
        self._check()
        about = self._reader.GetOutputInformation(0)
        keys = library("vtkmodules.vtkCommonDataModel", "VTI", VTK_EXTRA).vtkDataObject
        steps = library(
            "vtkmodules.vtkCommonExecutionModel", "VTI", VTK_EXTRA
        ).vtkStreamingDemandDrivenPipeline
        self.extent = [int(n) for n in about.Get(steps.WHOLE_EXTENT())]
        even = about.Has(keys.SPACING())
        self.spacing = np.array(about.Get(keys.SPACING())) if even else np.ones(3)
        self.origin = np.array(about.Get(keys.ORIGIN())) if even else np.zeros(3)
        if about.Has(keys.DIRECTION()):
            turned = about.Get(keys.DIRECTION())
        else:
            turned = np.eye(3).ravel()
        self.direction = np.array(turned).reshape(3, 3)

    @property
    def names(self) -> list[str]:
        """The arrays of points, and those of cells."""
        return [*self._points, *(name for name in self._cells if name not in self._points)]

    @property
    def _points(self) -> list[str]:
        return [
            self._reader.GetPointArrayName(n) for n in range(self._reader.GetNumberOfPointArrays())
        ]

    @property
    def _cells(self) -> list[str]:
        return [
            self._reader.GetCellArrayName(n) for n in range(self._reader.GetNumberOfCellArrays())
        ]

    def of_cells(self, name: str) -> bool:
        """Return True if an array has a value for each cell, which is a voxel then, and not for
        each point.
        """
        return name not in self._points

    def shape(self, name: str) -> Shape:
        """Return the size of an array along z, y, x."""
        points = [
            last - first + 1
            for first, last in zip(self.extent[::2], self.extent[1::2], strict=True)
        ]
        return tuple(n - self.of_cells(name) for n in points[::-1])

    def layers(self, name: str, first: int, count: int) -> np.ndarray:
        """Return some layers of an array, (count, ny, nx, numbers of a point)."""
        lowest = self.extent[4] + first
        cells = self.of_cells(name)
        self._reader.UpdateExtent([*self.extent[:4], lowest, lowest + count - (not cells)])
        self._check()
        image = self._reader.GetOutput()
        array = (image.GetCellData() if cells else image.GetPointData()).GetArray(name)
        if array is None:
            raise VolumeError(f"'{self.name}#{name}' is no array of numbers: choose another.")
        values = library("vtkmodules.util.numpy_support", "VTI", VTK_EXTRA).vtk_to_numpy(array)
        nx, ny, nz = (n - cells for n in image.GetDimensions())
        start = lowest - image.GetExtent()[4]
        return np.array(values.reshape(nz, ny, nx, -1)[start : start + count])

    def coordinates(self) -> list[np.ndarray]:
        """Read the coordinates of a rectilinear grid along x, y, z: of a row along each axis."""
        convert = library("vtkmodules.util.numpy_support", "VTI", VTK_EXTRA).vtk_to_numpy
        found = []
        for axis, name in enumerate("XYZ"):
            row = list(self.extent)
            for other in {0, 1, 2} - {axis}:
                row[2 * other + 1] = row[2 * other]
            self._reader.UpdateExtent(row)
            self._check()
            found.append(
                np.array(convert(getattr(self._reader.GetOutput(), f"Get{name}Coordinates")()))
            )
        return found

    def numbers(self, name: str) -> int:
        """Return the number of numbers of each point of an array."""
        return int(self.layers(name, 0, 1).shape[-1])

    def _check_end(self, source: Source) -> None:
        with source.open() as file:
            size = file.seek(0, 2)
            file.seek(max(size - TAIL_BYTES, 0))
            if CLOSING_TAG not in file.read(TAIL_BYTES):
                raise VolumeError(
                    f"'{self.name}' ends too early for an image file of VTK: copy it again."
                )
            file.seek(0)

    def _check(self) -> None:
        if self._errors:
            raise VolumeError(f"'{self.name}' is a damaged image file of VTK: write it again.")


def _name(source: Source, names: list[str]) -> str:
    """Return the name of the array that is chosen, the only one by default."""
    chosen = source.chosen.get("part") or (
        "value" if "value" in names else names[0] if len(names) == 1 else None
    )
    if chosen not in names:
        if not names:
            raise VolumeError(f"'{source.name}' holds no array of values: write it again.")
        listed = ", ".join(f"'{source.name}#{name}'" for name in names)
        raise VolumeError(
            f"'{source.name}' holds several arrays, or none of that name: choose of {listed}."
        )
    return str(chosen)


def _point_slabs(
    image: ImageFile, chosen: tuple[str, int], depth: int, step: int
) -> Iterator[np.ndarray]:
    for z in range(0, depth, step):
        yield image.layers(chosen[0], z, min(step, depth - z))[..., chosen[1]]
