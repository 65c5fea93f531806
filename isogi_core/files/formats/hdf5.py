"""HDF5 and NetCDF-4, read by h5py, and classic NetCDF, CDF-1 and CDF-2, read by nibabel's copy of
SciPy's reader.

One dataset, or variable, is chosen by its path in the file.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import (
    LAYERED,
    TIME_STEPS,
    Source,
    library,
    pick_axes,
    reader,
)
from isogi_core.files.grid import Affine, Grid, slab_layers
from isogi_core.files.packing import (
    NETCDF_FILL_VALUES,
    PACKING_ATTRIBUTES,
    Packing,
    as_stored,
    climate_packing,
)

EVEN_STEP_SHARE = 1e-3
"""Largest part of a step by which a coordinate may stray for its axis to be even."""

MINC_NOTE = (
    "The file is MINC: the scaling of its slices, and where it lies, are read of files "
    "named .mnc alone."
)

MICROMETRES_ATTRIBUTE = "element_size_um"
"""The attribute by which microscopists' tools give spacing, z first."""


@reader("HDF5", "part", "time", "channel")
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
        film = _is_time(data.dims[0])
        picked, moment, first = pick_axes(source, tuple(map(int, data.shape)), film)
        shape = tuple(int(n) for n in data.shape[-3:])
        source.check(shape)
        minc = (MINC_NOTE,) if "minc-2.0" in data.file else ()
        packing = climate_packing(_climate(data), data.dtype, data.fillvalue)
        spacing, affine, unit, notes = _place(data, shape)
    slabs = partial(_dataset_slabs, source, picked, packing)
    notes = (*packing.notes, *minc, *layered(film and not picked), *notes)
    stamp = partial(source.stamp, *others)
    if affine:
        placed = "the coordinates of its axes"
    elif unit:
        placed = f"'{MICROMETRES_ATTRIBUTE}'"
    else:
        placed = ""
    facts = spacing, slabs, stamp, affine, unit, notes, moment, first
    return Grid(shape, packing.dtype, *facts, read_as=packing.read_as("HDF5", placed))


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
    """Raise VolumeError where a filter that packs the dataset is not installed."""
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
    """Raise VolumeError where values are elsewhere, which an upload lacks, or a chunk has more than
    may be read.
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
    """The other files that hold voxels of a dataset. VolumeError where one is missing: HDF5 would
    fill its part.
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


def _is_time(axis: Any) -> bool:
    """Whether a dimension is time, by its name, or by its coordinates' unit, such as days since
    1970-01-01.
    """
    return says_time(
        (axis.label, *axis.keys()), [scale.attrs.get("units", "") for scale in axis.values()]
    )


def says_time(names: Iterable[str], units: Iterable[Any]) -> bool:
    """Whether one of a dimension's ``names`` is time, or one of its coordinates' ``units`` counts
    since a date.
    """
    return any(name.lower() in ("time", "t") for name in names) or any(
        " since " in attribute_text(unit) for unit in units
    )


def layered(film: bool) -> tuple[str, ...]:
    """The note that planes of a ``film`` are shown as layers; none of what is none."""
    if film:
        return (LAYERED.format(what=TIME_STEPS),)
    return ()


def attribute_text(value: Any) -> str:
    """An attribute as a text."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value)


@contextmanager
def _dataset(source: Source) -> Iterator[Any]:
    """The dataset that is chosen, the only one of three dimensions or more by default."""
    h5py = library("h5py", "HDF5")
    with source.open() as file, h5py.File(source.path or file, "r", locking=False) as whole:
        part = source.chosen.get("part")
        found = whole.get(part) if part else None
        if isinstance(found, h5py.Dataset) and found.ndim >= 3:
            yield found
            return
        fields: list[Any] = []
        whole.visititems(
            lambda _, each: fields.append(each) if isinstance(each, h5py.Dataset) else None
        )
        fields = [each for each in fields if each.ndim >= 3]
        if part is None and len(fields) == 1:
            yield fields[0]
            return
        raise unchosen(source, [each.name.strip("/") for each in fields])


def unchosen(source: Source, names: Sequence[str]) -> VolumeError:
    """What is wrong where no volume of a file is chosen, or one that it does not have; its volumes
    have ``names``.
    """
    part = source.chosen.get("part")
    listed = ", ".join(f"'{source.name}#{name}'" for name in names[:8])
    if part:
        wrong = f"'{source.name}' has no volume '{part}'"
    else:
        wrong = f"'{source.name}' holds several volumes"
    return VolumeError(
        f"{wrong}: choose of {listed}." if names else f"'{source.name}' holds no volume."
    )


def _climate(data: Any) -> dict[str, Any]:
    """The attributes of a dataset that are of CF's vocabulary; others may be of types that h5py
    cannot read.
    """
    return {name: data.attrs[name] for name in PACKING_ATTRIBUTES if name in data.attrs}


def _dataset_slabs(
    source: Source, picked: tuple[int, ...], packing: Packing
) -> Iterator[np.ndarray]:
    """Some layers of chunks at a time."""
    with _dataset(source) as data:
        depth, ny, nx = data.shape[-3:]
        deep = data.chunks[-3] if data.chunks else 1
        step = max(slab_layers(ny * nx * data.dtype.itemsize) // deep, 1) * deep
        for z in range(0, depth, step):
            yield packing.apply(data[(*picked, slice(z, z + step))])


Place = tuple[tuple[float, float, float], Affine | None, str, tuple[str, ...]]


def _place(data: Any, shape: tuple[int, ...]) -> Place:
    """Spacing, affine, unit and notes of a dataset: by its own attribute, or by the coordinates of
    its dimensions.
    """
    if (
        MICROMETRES_ATTRIBUTE in data.attrs
        and len(np.ravel(data.attrs[MICROMETRES_ATTRIBUTE])) == 3
    ):
        z, y, x = (float(step) for step in data.attrs[MICROMETRES_ATTRIBUTE])
        return (x, y, z), None, "µm", ()
    return place_by([_coordinates(data, data.ndim - 1 - axis) for axis in range(3)])


def place_by(scales: Sequence[tuple[np.ndarray, str] | None]) -> Place:
    """Spacing, affine, unit and notes by the coordinates along x, y, z and their units, None where
    there are none.
    """
    known = [scale for scale in scales if scale is not None]
    if len(known) < 3 or len({unit for _, unit in known}) > 1:
        return (1.0, 1.0, 1.0), None, "", ()
    steps = [np.diff(values) for values, _ in known]
    mean = [float(step.mean()) if step.size else 1.0 for step in steps]
    uneven = any(
        step.size and np.abs(step - m).max() > EVEN_STEP_SHARE * abs(m)
        for step, m in zip(steps, mean, strict=True)
    )
    if uneven or 0.0 in mean:
        return (
            (1.0, 1.0, 1.0),
            None,
            "",
            ("The coordinates of its axes are uneven: its voxels are taken as cubes.",),
        )
    x, y, z = (abs(m) for m in mean)
    affine = np.column_stack([np.diag(mean), [float(values[0]) for values, _ in known]])
    return (x, y, z), Affine.of(affine), known[0][1], ()


def _coordinates(data: Any, axis: int) -> tuple[np.ndarray, str] | None:
    """The coordinates along an axis, and their unit; None where the file gives none."""
    for scale in data.dims[axis].values():
        if scale.shape == (data.shape[axis],) and scale.dtype.kind in "iuf":
            return np.asarray(scale[()], np.float64), attribute_text(scale.attrs.get("units", ""))
    return None


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
        extra = tuple(map(int, data.data.shape[:-3]))
        shape = tuple(map(int, data.data.shape[-3:]))
        film = says_time(names[:1], _units(variables, names[0]))
        picked, moment, first = pick_axes(source, (*extra, *shape), film)
        source.check(shape)
        packing = climate_packing(data._attributes, stored, _filled(data.data[picked]))
        spacing, affine, unit, notes = place_by(
            [_classic_coordinates(variables, name) for name in names[:-4:-1]]
        )
    slabs = partial(_variable_slabs, source, picked, packing)
    notes = (*packing.notes, *layered(film and not extra), *notes)
    known = packing.read_as("classic NetCDF", "the coordinates of its axes" if affine else "")
    return Grid(
        shape,
        packing.dtype,
        spacing,
        slabs,
        source.stamp,
        affine,
        unit,
        notes,
        moment,
        first,
        read_as=known,
    )


@contextmanager
def _variables(source: Source) -> Iterator[dict[str, Any]]:
    """The variables of a file, by their names; of one that ends too early what it has is no more
    than its bytes.
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
    """The variable that is chosen, the only one of three dimensions or more by default."""
    fields = {
        name: each
        for name, each in variables.items()
        if len(each.dimensions) > 2 and each.data.dtype.kind in "if"
    }
    part = source.chosen.get("part")
    if part:
        found = fields.get(part.strip("/"))
    elif len(fields) == 1:
        found = next(iter(fields.values()), None)
    else:
        found = None
    if found is None:
        raise unchosen(source, list(fields))
    return found


def _filled(field: np.ndarray) -> Any:
    """What NetCDF fills variables of a type with by default, where any voxel of a ``field`` has it;
    else None.
    """
    mark = as_stored(NETCDF_FILL_VALUES.get(field.dtype.str[1:], math.nan), field.dtype)
    return mark if (field == mark).any() else None


def _units(variables: dict[str, Any], name: str) -> list[str]:
    """The unit of a dimension's coordinates, as a list; empty where it has none."""
    found = variables.get(name)
    if found is None:
        return []
    return [attribute_text(found._attributes.get("units", ""))]


def _classic_coordinates(variables: dict[str, Any], name: str) -> tuple[np.ndarray, str] | None:
    """The coordinates of a dimension, and their unit; None where the file gives none."""
    found = variables.get(name)
    if found is None or found.dimensions != (name,) or found.data.dtype.kind not in "if":
        return None
    return np.array(found.data, np.float64), _units(variables, name)[0]


def _variable_slabs(
    source: Source, picked: tuple[int, ...], packing: Packing
) -> Iterator[np.ndarray]:
    """Some layers at a time."""
    with _variables(source) as variables:
        field = _chosen(source, variables).data[picked]
        step = slab_layers(field[0].nbytes)
        for z in range(0, len(field), step):
            yield packing.apply(np.array(field[z : z + step]))
