"""Classic NetCDF, CDF-1 and CDF-2, read by nibabel's copy of SciPy's reader: one variable, chosen by its name."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.hdf5 import attribute_text, layered, place_by, says_time, unchosen
from isogi_core.files.formats.source import Source, is_unchosen, library, moment_of, pick_axes, reading
from isogi_core.files.grid import Grid, slab_layers
from isogi_core.files.packing import NETCDF_FILL_VALUES, Packing, as_stored, climate_packing

NETCDF_MAGIC, READ_VERSIONS = b"CDF", (1, 2)
"""How files begin, and the versions that are read, of the byte after that; the fifth has sizes of 64 bits."""

CDF5_REFUSAL = "is NetCDF with sizes of 64 bits (CDF-5): write it as NetCDF-4, by nccopy -k netCDF-4 IN OUT"


def open_netcdf(source: Source) -> Grid:
    """Open a variable of a classic NetCDF file as a grid. Raises VolumeError.

    The library reads the whole file at once, now and when the voxels are read.
    """
    source.refuse_others("part", "time", "channel")
    with reading(source.name, "NetCDF"), _variables(source) as variables:
        data = _chosen(source, variables)
        stored, names = data.data.dtype, tuple(map(str, data.dimensions))
        extra, shape = tuple(map(int, data.data.shape[:-3])), tuple(map(int, data.data.shape[-3:]))
        film = says_time(names[:1], _units(variables, names[0]))
        in_time = len(extra) > 0 and film
        picked = pick_axes(source, (*extra, *shape), in_time)
        source.check(shape)
        first = is_unchosen(source, (*extra, *shape), in_time)
        packing = climate_packing(data._attributes, stored, _filled(data.data[picked]))
        spacing, affine, unit, notes = place_by([_coordinates(variables, name) for name in names[:-4:-1]])
    slabs, notes = (
        partial(_variable_slabs, source, picked, packing),
        (*packing.notes, *layered(film and not extra), *notes),
    )
    known = packing.read_as("classic NetCDF", "the coordinates of its axes" if affine else "")
    moment = moment_of(source, extra, picked)
    return Grid(shape, packing.dtype, spacing, slabs, source.stamp, affine, unit, notes, moment, first, read_as=known)


@contextmanager
def _variables(source: Source) -> Iterator[dict[str, Any]]:
    """The variables of a file, by their names; of one that ends too early what it has is no more than its bytes."""
    reader = library("nibabel.externals.netcdf", "NetCDF").netcdf_file
    with source.open() as file:
        content = BytesIO(file.read())
    if content.getbuffer()[len(NETCDF_MAGIC) : len(NETCDF_MAGIC) + 1].tobytes()[0] not in READ_VERSIONS:
        raise VolumeError(f"'{source.name}' {CDF5_REFUSAL}.")
    yield reader(content, mmap=False).variables


def _chosen(source: Source, variables: dict[str, Any]) -> Any:
    """The variable that is chosen, the only one of three dimensions or more by default."""
    fields = {
        name: each for name, each in variables.items() if len(each.dimensions) > 2 and each.data.dtype.kind in "if"
    }
    part = source.chosen.get("part")
    found = fields.get(part.strip("/")) if part else next(iter(fields.values()), None) if len(fields) == 1 else None
    if found is None:
        raise unchosen(source, list(fields))
    return found


def _filled(field: np.ndarray) -> Any:
    """What NetCDF fills variables of a type with by default, where any voxel of a ``field`` has it; else None."""
    mark = as_stored(NETCDF_FILL_VALUES.get(field.dtype.str[1:], math.nan), field.dtype)
    return mark if (field == mark).any() else None


def _units(variables: dict[str, Any], name: str) -> list[str]:
    """The unit of a dimension's coordinates, as a list; empty where it has none."""
    found = variables.get(name)
    return [] if found is None else [attribute_text(found._attributes.get("units", ""))]


def _coordinates(variables: dict[str, Any], name: str) -> tuple[np.ndarray, str] | None:
    """The coordinates of a dimension, and their unit; None where the file gives none."""
    found = variables.get(name)
    if found is None or found.dimensions != (name,) or found.data.dtype.kind not in "if":
        return None
    return np.array(found.data, np.float64), _units(variables, name)[0]


def _variable_slabs(source: Source, picked: tuple[int, ...], packing: Packing) -> Iterator[np.ndarray]:
    """Some layers at a time."""
    with reading(source.name, "NetCDF"), _variables(source) as variables:
        field = _chosen(source, variables).data[picked]
        step = slab_layers(field[0].nbytes)
        for z in range(0, len(field), step):
            yield packing.apply(np.array(field[z : z + step]))
