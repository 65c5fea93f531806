"""HDF5 and NetCDF-4, read by h5py: one dataset, chosen by its path in the file."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Scaling, Source, library, moment_of, pick_axes, reading
from isogi_core.files.grid import Affine, Grid, layers_of

MAGIC = b"\x89HDF\r\n\x1a\n"

EVEN = 1e-3
"""Largest part of a step by which a coordinate may stray for its axis to be even."""

MICROMETRES = "element_size_um"
"""The attribute by which microscopists' tools give spacing, z first."""


def open_hdf5(source: Source) -> Grid:
    """Open a dataset of an HDF5 file as a grid: only its description is read now. Raises VolumeError."""
    source.refuse_others("part", "time", "channel")
    with reading(source.name, "HDF5"), _dataset(source) as data:
        if data.dtype.kind not in "biufc":
            raise VolumeError(f"'{source.name}#{data.name}' holds {data.dtype} values: choose a dataset of numbers.")
        picked, shape = pick_axes(source, data.shape), tuple(int(n) for n in data.shape[-3:])
        source.check(shape)
        _check_storage(source, data)
        moment = moment_of(source, data.shape[:-3], picked)
        scaling, holes = _packing(data)
        dtype = np.result_type(scaling.dtype(data.dtype), np.float32) if holes else scaling.dtype(data.dtype)
        spacing, affine, unit, notes = _place(data, shape)
    slabs = partial(_slabs, source, picked, scaling, holes)
    return Grid(shape, dtype, spacing, slabs, source.stamp, affine, unit, notes, moment)


@contextmanager
def _dataset(source: Source) -> Iterator[Any]:
    """The dataset that is chosen, the only one of three dimensions or more by default."""
    h5py = library("h5py", "HDF5")
    with source.open() as file, h5py.File(file, "r") as whole:
        part = source.chosen.get("part")
        found = whole.get(part) if part else None
        if isinstance(found, h5py.Dataset) and found.ndim >= 3:
            yield found
            return
        fields: list[Any] = []
        whole.visititems(lambda _, each: fields.append(each) if isinstance(each, h5py.Dataset) else None)
        fields = [each for each in fields if each.ndim >= 3]
        if part is None and len(fields) == 1:
            yield fields[0]
            return
        listed = ", ".join(f"'{source.name}#{each.name.strip('/')}'" for each in fields[:8])
        wrong = f"'{source.name}' has no volume '{part}'" if part else f"'{source.name}' holds several volumes"
        raise VolumeError(f"{wrong}: choose of {listed}." if fields else f"'{source.name}' holds no volume.")


def _check_storage(source: Source, data: Any) -> None:
    """Raise VolumeError where values are elsewhere, which an upload lacks, or a chunk has more than may be read."""
    if source.path is None and (data.is_virtual or data.external):
        raise VolumeError(f"The values of '{source.name}#{data.name}' are in other datasets: save it with its values.")
    voxels = math.prod(data.chunks or ())
    if voxels > source.voxels:
        most = f"{source.voxels} are the most that may be"
        raise VolumeError(
            f"Chunks of '{source.name}#{data.name}' have {voxels} voxels, and {most}: save it in smaller."
        )


def _packing(data: Any) -> tuple[Scaling, tuple[Any, ...]]:
    """Slope and intercept, and values that mean "missing", after NetCDF's climate and forecast conventions."""
    slope, intercept = (_number(data, name, rest) for name, rest in (("scale_factor", 1.0), ("add_offset", 0.0)))
    holes = tuple(np.ravel(data.attrs[name])[0] for name in ("_FillValue", "missing_value") if name in data.attrs)
    return Scaling(slope, intercept), holes


def _number(data: Any, name: str, fallback: float) -> float:
    return float(np.ravel(data.attrs[name])[0]) if name in data.attrs else fallback


def _slabs(source: Source, picked: tuple[int, ...], scaling: Scaling, holes: tuple[Any, ...]) -> Iterator[np.ndarray]:
    """Some layers of chunks at a time."""
    with reading(source.name, "HDF5"), _dataset(source) as data:
        depth, ny, nx = data.shape[-3:]
        deep = data.chunks[-3] if data.chunks else 1
        step = max(layers_of(ny * nx * data.dtype.itemsize) // deep, 1) * deep
        for z in range(0, depth, step):
            stored = data[(*picked, slice(z, z + step))]
            values = scaling.apply(stored)
            for hole in holes:
                values = np.where(stored == hole, np.float32(np.nan), values)
            yield values


Place = tuple[tuple[float, float, float], Affine | None, str, tuple[str, ...]]


def _place(data: Any, shape: tuple[int, ...]) -> Place:
    """Spacing, affine, unit and notes of a dataset: by its own attribute, or by the coordinates of its dimensions."""
    if MICROMETRES in data.attrs and len(np.ravel(data.attrs[MICROMETRES])) == 3:
        z, y, x = (float(step) for step in data.attrs[MICROMETRES])
        return (x, y, z), None, "µm", ()
    scales = [_coordinates(data, data.ndim - 1 - axis) for axis in range(3)]
    known = [scale for scale in scales if scale is not None]
    if len(known) < 3 or len({unit for _, unit in known}) > 1:
        return (1.0, 1.0, 1.0), None, "", ()
    steps = [np.diff(values) for values, _ in known]
    mean = [float(step.mean()) if step.size else 1.0 for step in steps]
    uneven = any(step.size and np.abs(step - m).max() > EVEN * abs(m) for step, m in zip(steps, mean, strict=True))
    if uneven or 0.0 in mean:
        return (1.0, 1.0, 1.0), None, "", ("The coordinates of its axes are uneven: its voxels are taken as cubes.",)
    x, y, z = (abs(m) for m in mean)
    affine = np.column_stack([np.diag(mean), [float(values[0]) for values, _ in known]])
    return (x, y, z), Affine.of(affine), known[0][1], ()


def _coordinates(data: Any, axis: int) -> tuple[np.ndarray, str] | None:
    """The coordinates along an axis, and their unit; None where the file gives none."""
    for scale in data.dims[axis].values():
        unit = scale.attrs.get("units", "")
        if scale.shape == (data.shape[axis],) and scale.dtype.kind in "iuf":
            return np.asarray(scale[()], np.float64), unit.decode() if isinstance(unit, bytes) else str(unit)
    return None
