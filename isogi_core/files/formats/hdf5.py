"""HDF5 and NetCDF-4, read by h5py, and classic NetCDF, CDF-1 and CDF-2, read by nibabel's copy of
SciPy's reader.

One dataset, or variable, is chosen by its path in the file.
"""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import Along, along, place_by, role_of, roles_of, unread_spacing
from isogi_core.files.formats.hdf5_dialects import (
    CHOICES,
    DESCRIPTIONS,
    LEVELLED,
    MOST_XML_BYTES,
    Said,
)
from isogi_core.files.formats.side_headers import data_of
from isogi_core.files.formats.source import (
    LAYERED,
    TIME_STEPS,
    Picked,
    Source,
    library,
    pick_roles,
    reader,
)
from isogi_core.files.grid import SINGLE_MOMENT, Grid
from isogi_core.files.packing import (
    NETCDF_FILL_VALUES,
    PACKING_ATTRIBUTES,
    Packing,
    as_stored,
    climate_packing,
)

MINC_NOTE = (
    "The file is MINC: the scaling of its slices, and where it lies, are read of files "
    "named .mnc alone."
)


@reader("HDF5", "part", "time", "channel", "level")
def open_hdf5(source: Source) -> Grid:
    """Open a dataset of an HDF5 file as a grid: only its description is read now. Raises
    VolumeError.
    """
    with _dataset(source) as data:
        if data.dtype.kind not in "biufc":
            raise VolumeError(
                f"'{source.name}#{data.name}' holds {data.dtype} values: choose a dataset of "
                "numbers."
            )
        _check_storage(source, data)
        others = _sources(source, data)
        _check_filters(source, data)
        said = _said(source, data)
        picked, moment, first = pick_roles(source, tuple(map(int, data.shape)), said.axes)
        picked = picked.cropped(said.shape)
        source.check(picked.shape)
        minc = (MINC_NOTE,) if "minc-2.0" in data.file else ()
        stored = np.dtype(f"u{data.dtype.itemsize}") if said.unsigned else data.dtype
        packing = climate_packing(_climate(data), stored, data.fillvalue)
        chunks = data.chunks or (1,) * data.ndim
        name = data.name
    if said.moment != SINGLE_MOMENT:
        moment, first = said.moment, said.unchosen
    slabs = partial(_dataset_slabs, source, name, picked, chunks[picked.order[0]], packing)
    return Grid(
        picked.shape,
        packing.dtype,
        said.place.spacing,
        slabs,
        partial(source.stamp, *others),
        said.place.affine,
        said.place.unit,
        (*packing.notes, *minc, *said.notes, *said.place.notes),
        moment,
        first,
        read_as=packing.read_as("HDF5", said.placed),
    )


BDV_HDF5 = re.compile(r"<hdf5\b[^>]*>([^<]+)</hdf5>")


@reader("BigDataViewer's XML", "part", "time", "channel", "level")
def open_bdv(source: Source) -> Grid:
    """Open the HDF5 file that an XML file of BigDataViewer names. Raises VolumeError."""
    with source.open() as file:
        text = file.read(MOST_XML_BYTES).decode("utf-8", "replace")
    named = BDV_HDF5.search(text)
    if named is None:
        raise VolumeError(
            f"'{source.name}' is BigDataViewer's XML of data that is not HDF5: give the Zarr or "
            "the images that it names."
        )
    return open_hdf5(replace(data_of(source, named[1].strip()), chosen=source.chosen))


def _said(source: Source, data: Any) -> Said:
    """Return the description of a dataset in its dialect, else by the names of its axes and their
    coordinates.
    """
    known = next((said for each in DESCRIPTIONS if (said := each(source, data))), Said())
    if known.axes:
        return known
    scales = [_scale(data, axis) for axis in range(data.ndim)]
    found = [_role(data, axis, scale) for axis, scale in enumerate(scales)]
    if data.ndim > 3 and not any(found):
        return known
    roles = roles_of(found)
    notes = (*known.notes, *layered("t" in found and "t" not in roles))
    if known.place.said:
        return replace(known, axes=roles, notes=notes)
    used = [scales[roles.index(name)] for name in "xyz"]
    if "t" in found and "t" not in roles:
        used = []  # of a film no axis is a depth
    axes = [None if scale is None else along(scale[()], _read(scale)) for scale in used]
    place = place_by(axes)
    if not place.said:
        notes = (*notes, *unread_spacing(_small(data)), *unread_spacing(_small(data.parent)))
    placed = "the coordinates of its axes" if place.said and not place.notes else known.placed
    return replace(known, axes=roles, place=place, placed=placed, notes=notes)


def _scale(data: Any, axis: int) -> Any:
    """Find the numbers along an axis of a dataset; None if the file gives none."""
    for scale in data.dims[axis].values():
        if scale.shape == (data.shape[axis],) and scale.dtype.kind in "iuf":
            return scale
    return None


def _role(data: Any, axis: int, scale: Any) -> str:
    """Return the role of an axis, by its label, or by the name of its scale, as a scale or as a
    dataset.
    """
    dimension = data.dims[axis]
    names = [dimension.label, *dimension.keys(), "" if scale is None else str(scale.name)]
    attributes = {} if scale is None else _read(scale)
    return next((role for name in names if (role := role_of(str(name), attributes))), "")


def _small(held: Any) -> dict[str, Any]:
    """Read the attributes of a dataset or a group that are numbers, of three at most."""
    found = {}
    for name in held.attrs:
        with suppress(OSError, TypeError, ValueError):
            kind = held.attrs.get_id(name)
            if kind.shape in ((3,), (1, 3), (3, 1)) and kind.dtype.kind in "iuf":
                found[str(name)] = held.attrs[name]
    return found


AXIS_ATTRIBUTES = ("units", "axis", "positive", "standard_name")


def _read(scale: Any) -> dict[str, Any]:
    """Read the attributes that describe an axis; others may be of types that h5py does not know."""
    return {name: scale.attrs[name] for name in AXIS_ATTRIBUTES if name in scale.attrs}


HDF5_FILTERS = {
    **{
        307: "bzip2",
        32001: "Blosc",
        32004: "LZ4",
        32008: "Bitshuffle",
        32013: "ZFP",
        32015: "Zstandard",
    },
    **{32017: "SZ", 32018: "FCIDECOMP", 32023: "Sperr", 32024: "SZ3", 32026: "Blosc2"},
}
"""Names of filters that h5py does not have, by their registered numbers; hdf5plugin has all of
them.
"""


def _check_filters(source: Source, data: Any) -> None:
    """Raise VolumeError if a filter that packs the dataset is not installed."""
    h5z = library("h5py", "HDF5").h5z
    packed = data.id.get_create_plist()
    numbers = [packed.get_filter(n)[0] for n in range(packed.get_nfilters())]
    if not all(map(h5z.filter_avail, numbers)):
        with suppress(ImportError):
            import_module("hdf5plugin")
    lacking = [
        HDF5_FILTERS.get(number, f"filter {number}")
        for number in numbers
        if not h5z.filter_avail(number)
    ]
    if lacking:
        needed = (
            f"The voxels of '{source.name}#{data.name.strip('/')}' are packed by "
            f"{' and '.join(lacking)}"
        )
        raise VolumeError(f"{needed}, which is not installed: pip install hdf5plugin.")


def _check_storage(source: Source, data: Any) -> None:
    """Raise VolumeError if values are in other files, which an upload lacks, or a chunk has more
    voxels than may be read.
    """
    if source.path is None and (data.is_virtual or data.external):
        raise VolumeError(
            f"The values of '{source.name}#{data.name}' are in other datasets: save it with "
            "its values."
        )
    voxels = math.prod(data.chunks or ())
    if voxels > source.voxels:
        most = f"{source.voxels} are the most that may be"
        raise VolumeError(
            f"Chunks of '{source.name}#{data.name}' have {voxels} voxels, and {most}: save it "
            "in smaller."
        )


def _sources(source: Source, data: Any) -> list[Path]:
    """Return the other files that hold voxels of a dataset. Raises VolumeError if one is missing,
    as HDF5 would fill its part.
    """
    if data.is_virtual:
        names = {each.file_name for each in data.virtual_sources()} - {"."}
    else:
        names = set()
    names |= {str(name) for name, _, _ in data.external or ()}
    files = [source.path.parent / name for name in sorted(names) if source.path is not None]
    missing = next((path.name for path in files if not path.is_file()), None)
    if missing is not None:
        raise VolumeError(
            f"'{source.name}' is made of other files, and '{missing}' is not beside it: put it "
            "there."
        )
    return files


def layered(film: bool) -> tuple[str, ...]:
    """Return a note that planes of a ``film`` are shown as layers; none for other fields."""
    if film:
        return (LAYERED.format(what=TIME_STEPS),)
    return ()


@contextmanager
def _dataset(source: Source) -> Iterator[Any]:
    """Yield the open dataset that is chosen by its path or the end of its path.

    By default it is the one that the file's dialect names, else the only one of three dimensions or
    more, else the only one with axes in space. Raises VolumeError, which lists all, if none is
    meant.
    """
    h5py = library("h5py", "HDF5")
    with source.open() as file, h5py.File(source.path or file, "r", locking=False) as whole:
        part = source.chosen.get("part")
        # A part that is a whole path is taken as it is.
        found = whole.get(part) if part else None
        if isinstance(found, h5py.Dataset) and found.ndim >= 3:
            yield found
            return
        # List all datasets that may be volumes.
        fields: list[Any] = []
        whole.visititems(
            lambda _, each: fields.append(each) if isinstance(each, h5py.Dataset) else None
        )
        fields = [each for each in fields if each.ndim >= 3]
        # Without a part, take the dataset that a dialect names, or the only one; with one, the only
        # dataset whose path ends with it.
        if part is None:
            found = next((data for each in CHOICES if (data := each(source, whole))), None)
            fields_in_space = [each for each in fields if _is_in_space(each)]
            only = [each for each in (fields, fields_in_space) if len(each) == 1]
            meant = found or (only[0][0] if only else None)
        else:
            ending = [each for each in fields if ends_in(each.name, part)]
            meant = ending[0] if len(ending) == 1 else None
        if meant is None:
            raise unchosen(source, [each.name.strip("/") for each in fields])
        # Files of dialects without levels of resolution have no other choices.
        if not any(each in LEVELLED and each(source, whole) for each in CHOICES):
            source.refuse_others("part", "time", "channel")
        yield meant


def ends_in(name: str, part: str) -> bool:
    """Return True if the path ``name`` ends in the path ``part``, whole names compared."""
    return f"/{name.strip('/')}".endswith(f"/{part.strip('/')}")


def _is_in_space(data: Any) -> bool:
    """Return True if a dataset's axes are named as x, y, z, and perhaps time and channel."""
    found = [_role(data, axis, _scale(data, axis)) for axis in range(data.ndim)]
    return {"x", "y", "z"} <= set(found)


def unchosen(source: Source, names: Sequence[str]) -> VolumeError:
    """Return the error for a file that has no volume, or several if none of them is chosen, or not
    exactly one of the name that is chosen.

    The error lists the first eight of ``names``, the paths of all volumes in the file, or of those
    that end in the chosen name, if there are several.
    """
    part = source.chosen.get("part")
    alike = [name for name in names if part and ends_in(name, part)]
    listed = ", ".join(f"'{source.name}#{name}'" for name in (alike or names)[:8])
    if alike:
        wrong = f"'{source.name}' holds several volumes '{part}'"
    elif part:
        wrong = f"'{source.name}' has no volume '{part}'"
    else:
        wrong = f"'{source.name}' holds several volumes"
    if not names:
        return VolumeError(
            f"'{source.name}' holds no dataset of three axes or more: give a file that has one."
        )
    return VolumeError(f"{wrong}: choose of {listed}.")


def _climate(data: Any) -> dict[str, Any]:
    """Read the attributes of a dataset that are of CF's vocabulary; others may be of types that
    h5py does not know.
    """
    return {name: data.attrs[name] for name in PACKING_ATTRIBUTES if name in data.attrs}


def _dataset_slabs(
    source: Source, name: str, picked: Picked, deep: int, packing: Packing
) -> Iterator[np.ndarray]:
    """Read some layers of chunks at a time."""
    h5py = library("h5py", "HDF5")
    with source.open() as file, h5py.File(source.path or file, "r", locking=False) as whole:
        data = whole[name]
        for z, end in picked.blocks(deep, data.dtype.itemsize):
            yield packing.apply(picked.turned(data[picked.layers(z, end)]))


NETCDF_MAGIC = b"CDF"
READ_VERSIONS = (1, 2)
"""How files begin, and the versions that are read, of the byte after that; the fifth has sizes of
64 bits.
"""

CDF5_REFUSAL = (
    "is NetCDF with sizes of 64 bits (CDF-5): write it as NetCDF-4, by nccopy -k netCDF-4 IN OUT"
)


@reader("NetCDF", "part", "time", "channel")
def open_netcdf(source: Source) -> Grid:
    """Open a variable of a classic NetCDF file as a grid. Raises VolumeError.

    The library reads the whole file at once, now and when the voxels are read.
    """
    with _variables(source) as variables:
        data = _chosen(source, variables)
        stored = data.data.dtype
        names = tuple(map(str, data.dimensions))
        shape = tuple(map(int, data.data.shape))
        axes = [_attributes(variables, name) for name in names]
        found = [role_of(name, each) for name, each in zip(names, axes, strict=True)]
        roles = roles_of(found) if len(shape) == 3 or any(found) else ()
        picked, moment, first = pick_roles(source, shape, roles)
        source.check(picked.shape)
        packing = climate_packing(data._attributes, stored, _filled(data.data[picked.key]))
        film = "t" in found and "t" not in roles
        place = place_by(
            [
                _classic_coordinates(variables, names[n], axes[n])
                for n in (() if film else picked.order[::-1])
            ]
        )
    slabs = partial(_variable_slabs, source, picked, packing)
    notes = (*packing.notes, *layered(film), *place.notes)
    placed = "the coordinates of its axes" if place.said and not place.notes else ""
    return Grid(
        picked.shape,
        packing.dtype,
        place.spacing,
        slabs,
        source.stamp,
        place.affine,
        place.unit,
        notes,
        moment,
        first,
        read_as=packing.read_as("classic NetCDF", placed),
    )


@contextmanager
def _variables(source: Source) -> Iterator[dict[str, Any]]:
    """Yield the variables of a file, by their names. The file is read into memory first: a header
    that announces more than it holds takes no more.
    """
    reader = library("nibabel.externals.netcdf", "NetCDF").netcdf_file
    with source.open() as file:
        content = BytesIO(file.read())
    if (
        content.getbuffer()[len(NETCDF_MAGIC) : len(NETCDF_MAGIC) + 1].tobytes()[0]
        not in READ_VERSIONS
    ):
        raise VolumeError(f"'{source.name}' {CDF5_REFUSAL}.")
    yield reader(content, mmap=False).variables


def _chosen(source: Source, variables: dict[str, Any]) -> Any:
    """Find the variable that is chosen; by default the only one of three dimensions or more, else
    the only one in space.
    """
    fields = {
        name: each
        for name, each in variables.items()
        if len(each.dimensions) > 2 and each.data.dtype.kind in "if"
    }
    part = source.chosen.get("part")
    in_space = [
        each
        for each in fields.values()
        if {"x", "y", "z"}
        <= {role_of(name, _attributes(variables, name)) for name in each.dimensions}
    ]
    if part:
        found = fields.get(part.strip("/"))
    elif len(fields) == 1:
        found = next(iter(fields.values()), None)
    else:
        found = in_space[0] if len(in_space) == 1 else None
    if found is None:
        raise unchosen(source, list(fields))
    return found


def _filled(field: np.ndarray) -> Any:
    """Return the number with which NetCDF fills variables of a type by default, if any voxel of a
    ``field`` has it; else None.
    """
    mark = as_stored(NETCDF_FILL_VALUES.get(field.dtype.str[1:], math.nan), field.dtype)
    return mark if (field == mark).any() else None


def _attributes(variables: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the attributes of a dimension's coordinates; none if it has no coordinates."""
    found = variables.get(name)
    return {} if found is None else dict(found._attributes)


def _classic_coordinates(
    variables: dict[str, Any], name: str, attributes: dict[str, Any]
) -> Along | None:
    """Return the coordinates of a dimension; None if the file gives none."""
    found = variables.get(name)
    if found is None or found.dimensions != (name,) or found.data.dtype.kind not in "if":
        return None
    return along(np.array(found.data, np.float64), attributes)


def _variable_slabs(source: Source, picked: Picked, packing: Packing) -> Iterator[np.ndarray]:
    """Read some layers at a time."""
    with _variables(source) as variables:
        field = _chosen(source, variables).data
        for z, end in picked.blocks(1, field.dtype.itemsize):
            yield packing.apply(np.array(picked.turned(field[picked.layers(z, end)])))
