"""Dialects of HDF5: the metadata that programs write with their numbers, such as the data set to
show, its axes, spacing and direction.

Each dialect chooses a data set if none is chosen, and describes one: VTKHDF, openPMD, NeXus,
Imaris, BigDataViewer, ilastik, ITK and MATLAB. Sources: VTK's "VTKHDF File Format", openPMD 1.1.0,
NeXus' "NXdata", Imaris 5.5's "File Format", BigDataViewer's "XML/HDF5".
"""

import json
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import NOWHERE, Along, Place, along, place_by, role_of, text_of
from isogi_core.files.formats.source import Source, pick, pick_step
from isogi_core.files.grid import PATIENT_AXES, SINGLE_MOMENT, Affine, Shape
from isogi_core.files.vector import triple


@dataclass(frozen=True)
class Said:
    """The description of a data set in its file.

    - ``axes``: their roles, as ``coordinates.role_of`` names them; empty if the file gives none.
    - ``place``: that of its voxels; ``placed``: name of the entries of the file that give it.
    - ``shape``: number of voxels along z, y, x that count, if others are padding.
    - ``unsigned``: True if whole numbers are to be read without a sign.
    - ``notes``: sentences for the grid.
    - ``moment``: its step in time, and the number of steps; ``unchosen``: True if nobody chose that
      step.
    """

    axes: tuple[str, ...] = ()
    place: Place = NOWHERE
    placed: str = ""
    shape: Shape = ()
    unsigned: bool = False
    notes: tuple[str, ...] = ()
    moment: tuple[int, int] = SINGLE_MOMENT
    unchosen: bool = False


Choice = Callable[[Source, Any], Any]
"""Finds the data set that a file means, None if the file is of another dialect or means none."""

Description = Callable[[Source, Any], Said | None]
"""Describes a data set, None if it is of another dialect."""


def attribute(held: Any, name: str) -> str:
    """Read an attribute as a text; empty if there is none."""
    return text_of(held.attrs[name]) if name in held.attrs else ""


def floats(held: Any, name: str, count: int) -> np.ndarray | None:
    """Read an attribute of ``count`` numbers; None if it is none such."""
    if name not in held.attrs:
        return None
    try:
        found = np.ravel(np.asarray(held.attrs[name], np.float64))
    except (TypeError, ValueError):
        return None
    return found if found.size == count else None


def placed(matrix: np.ndarray, origin: np.ndarray, unit: str = "", letters: str = "") -> Place:
    """Place voxels by a matrix (3, 3) of steps along x, y, z, its columns, and an origin."""
    steps = triple(np.linalg.norm(matrix, axis=0))
    return Place(steps, Affine.of(np.column_stack([matrix, origin]), letters), unit, said=True)


VTK_GROUP = "VTKHDF"
VTK_ARRAYS = ("PointData", "CellData")


def choose_vtk(source: Source, whole: Any) -> Any:
    """Choose the only array of a VTKHDF image. Raises VolumeError for other VTKHDF files."""
    group = whole.get(VTK_GROUP)
    if group is None:
        return None
    kind = attribute(group, "Type")
    if kind != "ImageData":
        raise VolumeError(
            f"'{source.name}' is VTKHDF of the type {kind or 'unknown'}, which is no even grid: "
            "resample it in ParaView, by the filter Resample To Image, and save that as .vti."
        )
    fields = [
        each for name in VTK_ARRAYS for each in (group.get(name) or {}).values() if each.ndim >= 3
    ]
    return fields[0] if len(fields) == 1 else None


def describe_vtk(source: Source, data: Any) -> Said | None:
    """Place an array of a VTKHDF image; values of cells lie in the middle of these. None for an
    array outside of the group VTKHDF.

    Its axes are z, y, x, after one of time if the file has steps, and before one of components if a
    voxel has several.
    """
    parts = data.name.strip("/").split("/")
    if parts[0] != VTK_GROUP:
        return None
    group = data.file[VTK_GROUP]
    spacing = floats(group, "Spacing", 3)
    origin = floats(group, "Origin", 3)
    turn = floats(group, "Direction", 9)
    extent = floats(group, "WholeExtent", 6)
    matrix = np.eye(3) if turn is None else turn.reshape(3, 3)
    matrix = matrix * (np.ones(3) if spacing is None else spacing)
    # Indices begin at the lower ends of the extent; the first cell's middle is half a step further.
    first = np.zeros(3) if extent is None else extent[::2]
    if "CellData" in parts:
        first = first + 0.5
    start = (np.zeros(3) if origin is None else origin) + matrix @ first
    timed = "Steps" in group and data.ndim > 3
    roles = ("t", "z", "y", "x", "c")[0 if timed else 1 :][: data.ndim]
    # The roles of more axes are left open.
    known = roles if len(roles) == data.ndim else ()
    return Said(known, placed(matrix, start), "its spacing and origin")


PMD_UNITS = {1.0: "m", 1e-3: "mm", 1e-6: "µm", 1e-9: "nm"}


def describe_openpmd(source: Source, data: Any) -> Said | None:
    """Place a mesh of openPMD, or a component of one, by its attributes. Raises VolumeError for
    meshes that are not Cartesian.
    """
    mesh = data if "gridSpacing" in data.attrs else data.parent
    if "gridSpacing" not in mesh.attrs or data.ndim != 3:
        return None
    if attribute(mesh, "geometry") not in ("cartesian", ""):
        raise VolumeError(
            f"'{source.name}' holds a mesh of the geometry {attribute(mesh, 'geometry')}: save one "
            "on Cartesian axes."
        )
    steps = floats(mesh, "gridSpacing", 3)
    if steps is None:
        return None
    labels = [text_of(each).lower() for each in np.ravel(mesh.attrs.get("axisLabels", ()))]
    start = floats(mesh, "gridGlobalOffset", 3)
    shift = floats(data, "position", 3)
    start = np.zeros(3) if start is None else start
    start = start + steps * (0.0 if shift is None else shift)
    if attribute(mesh, "dataOrder") == "F":
        labels, steps, start = labels[::-1], steps[::-1], start[::-1]
    if sorted(labels) != ["x", "y", "z"]:
        labels = ["z", "y", "x"]
    scale = floats(mesh, "gridUnitSI", 1)
    factor = 1.0 if scale is None else float(scale[0])
    unit = PMD_UNITS.get(factor, "m")
    size = 1.0 if factor in PMD_UNITS else factor
    order = [labels.index(name) for name in "xyz"]
    place = placed(
        np.diag(steps[order] * size), start[order] * size, unit if scale is not None else ""
    )
    return Said(tuple(labels), place, "openPMD's grid")


def choose_nexus(source: Source, whole: Any) -> Any:
    """Choose the signal that a NeXus file plots by default, else the only signal in space."""
    node = whole
    for _ in range(4):
        name = attribute(node, "default")
        if not name or name not in node:
            break
        node = node[name]
    signal = _signal_of(node)
    if signal is not None:
        return signal
    found: list[Any] = []
    whole.visititems(lambda _, each: found.append(each) if _is_signal(each) else None)
    return found[0] if len(found) == 1 else None


def _signal_of(group: Any) -> Any:
    """Find the signal of a group of NeXus; None if it names none of three dimensions."""
    if not hasattr(group, "keys"):
        return group if getattr(group, "ndim", 0) >= 3 else None
    data = group.get(attribute(group, "signal") or " ")
    return data if data is not None and getattr(data, "ndim", 0) >= 3 else None


def _is_signal(each: Any) -> bool:
    """Return True if a data set is the signal of its group, in the way of newer or older files."""
    if getattr(each, "ndim", 0) < 3:
        return False
    older = attribute(each, "signal") == "1"
    return older or attribute(each.parent, "signal") == each.name.rpartition("/")[2]


def describe_nexus(source: Source, data: Any) -> Said | None:
    """Place a signal of NeXus by the axes of its group."""
    if not _is_signal(data):
        return None
    group = data.parent
    given = group.attrs.get("axes", data.attrs.get("axes", ()))
    words = text_of(given) if np.ndim(given) == 0 and not isinstance(given, tuple) else None
    names = re.split(r"[:,]", words) if words else [text_of(each) for each in np.ravel(given)]
    if len(names) != data.ndim:
        return None
    scales = [group.get(name) if name != "." else None for name in names]
    usable = [
        each if each is not None and each.shape == (n,) and each.dtype.kind in "iuf" else None
        for each, n in zip(scales, data.shape, strict=True)
    ]
    attributes = [{} if each is None else dict(each.attrs) for each in usable]
    roles = tuple(map(role_of, names, attributes))
    if sorted(roles[-3:]) != ["x", "y", "z"]:
        roles = (*roles[:-3], "z", "y", "x")
    axes = [_nexus_axis(usable[roles.index(name)]) for name in "xyz"]
    return Said(roles, place_by(axes), "the coordinates of its axes")


def _nexus_axis(scale: Any) -> Along | None:
    return None if scale is None else along(scale[()], dict(scale.attrs))


IMARIS_DATA = "{}/ResolutionLevel {}/TimePoint {}/Channel {}/Data"


def choose_imaris(source: Source, whole: Any) -> Any:
    """Choose a channel, a step and a level of an image of Imaris; the finest and first by default,
    and the only channel. Raises VolumeError.
    """
    if "ImarisDataSet" not in whole.attrs:
        return None
    top = attribute(whole, "DataSetDirectoryName") or "DataSet"
    levels = len(whole[top])
    level = source.count("level") or 0
    if level >= levels:
        raise VolumeError(f"'{source.name}' has levels 0 to {levels - 1}, not {level}.")
    steps = whole[f"{top}/ResolutionLevel {level}"]
    step, _ = pick_step(source, len(steps))
    channel = pick(source, "channel", len(steps[f"TimePoint {step}"]), "channels")
    return whole.get(IMARIS_DATA.format(top, level, step, channel))


def describe_imaris(source: Source, data: Any) -> Said | None:
    """Place an array of Imaris by the extent of its image, and cut its padding off."""
    whole = data.file
    if "ImarisDataSet" not in whole.attrs:
        return None
    sizes = [attribute(data.parent, f"ImageSize{axis}") for axis in "ZYX"]
    known = all(size.isdecimal() for size in sizes)
    shape = tuple(int(size) for size in sizes) if known else tuple(data.shape)
    shape = tuple(min(n, most) for n, most in zip(shape, data.shape, strict=True))
    about = whole.get(f"{attribute(whole, 'DataSetInfoDirectoryName') or 'DataSetInfo'}/Image")
    steps = whole[data.name.split("/TimePoint")[0]]
    moment = (int(re.findall(r"TimePoint (\d+)", data.name)[0]), len(steps))
    chosen = moment[1] == 1 or source.count("time") is not None or "part" in source.chosen
    said = Said(("z", "y", "x"), shape=shape, unchosen=not chosen)
    if moment[1] > 1:
        said = replace(said, moment=moment)
    with suppress(TypeError, ValueError, KeyError, AttributeError):
        low = np.array([float(attribute(about, f"ExtMin{n}")) for n in range(3)])
        high = np.array([float(attribute(about, f"ExtMax{n}")) for n in range(3)])
        step = (high - low) / shape[::-1]
        if np.isfinite(step).all() and (step > 0.0).all():
            unit = attribute(about, "Unit").lower() or "um"
            place = placed(np.diag(step), low + 0.5 * step, "µm" if unit == "um" else unit)
            return replace(said, place=place, placed="its image's extent")
    return said


BDV_CELLS = re.compile(r"(t\d{5})/s(\d+)/(\d+)/cells")


def choose_bdv(source: Source, whole: Any) -> Any:
    """Choose a step, a setup, as channel, and a level of BigDataViewer; the finest and first by
    default, and the only setup. Raises VolumeError.
    """
    times = _bdv_times(whole)
    if not times or "cells" not in str(list(_deep(whole[times[0]]))):
        return None
    step, _ = pick_step(source, len(times))
    setups = sorted(whole[times[step]])
    setup = pick(source, "channel", len(setups), "setups")
    levels = whole[f"{times[step]}/{setups[setup]}"]
    level = source.count("level") or 0
    if level >= len(levels):
        raise VolumeError(f"'{source.name}' has levels 0 to {len(levels) - 1}, not {level}.")
    return levels[f"{level}/cells"]


def _bdv_times(whole: Any) -> list[str]:
    """Name the steps of BigDataViewer, in their order. Their numbers may leave some out."""
    return sorted(name for name in whole if re.fullmatch(r"t\d{5}", name))


def _deep(group: Any) -> list[str]:
    """Name the members of a group down to its third level."""
    names: list[str] = []
    group.visit(names.append)
    return names[:8]


def describe_bdv(source: Source, data: Any) -> Said | None:
    """Describe an array of BigDataViewer; None for an array of another dialect.

    int16 is read without a sign, as older files keep uint16 so. Voxels are placed only if an XML
    file next to the HDF5 file names it and gives the size of its voxels.
    """
    found = BDV_CELLS.fullmatch(data.name.strip("/"))
    if found is None:
        return None
    setup = found[2]
    whole = data.file
    times = _bdv_times(whole)
    chosen = len(times) == 1 or source.count("time") is not None or "part" in source.chosen
    # Each voxel of a coarser level is the mean of several fine ones along x, y, z.
    factors = np.ones(3)
    with suppress(KeyError, IndexError, ValueError):
        factors = np.asarray(whole[f"s{setup}/resolutions"][int(found[3])], float)
    said = Said(("z", "y", "x"), unsigned=data.dtype == np.int16, unchosen=not chosen)
    if len(times) > 1:
        said = replace(said, moment=(times.index(found[1]), len(times)))
    size, unit = _bdv_voxel(source.path, int(setup))
    if size is None:
        # The factors are of no use without the size of a fine voxel.
        return said
    # The origin is the centre of the first fine voxel; that of the first voxel here is the mean
    # centre of its fine ones.
    place = placed(np.diag(size * factors), 0.5 * size * (factors - 1.0), unit)
    return replace(said, place=place, placed="BigDataViewer's XML")


MOST_XML_BYTES = 1 << 24
"""Bytes of an XML file that are read, at most."""


def _bdv_voxel(path: Path | None, setup: int) -> tuple[np.ndarray | None, str]:
    """Read the size of a voxel and its unit in the XML file next to BigDataViewer's HDF5 that names
    it; None if there is none.
    """
    if path is None:
        return None, ""
    others = sorted(each for each in path.parent.glob("*.xml") if each.stem != path.stem)
    for beside in (path.with_suffix(".xml"), *others[:64]):
        if not beside.is_file():
            continue
        text = beside.read_bytes()[:MOST_XML_BYTES].decode("utf-8", "replace")
        if path.name in text:
            return voxel_of_xml(text, setup)
    return None, ""


SETUP = re.compile(r"<ViewSetup>(.*?)</ViewSetup>", re.DOTALL)
VOXEL = re.compile(r"<voxelSize>(.*?)</voxelSize>", re.DOTALL)
UNIT_NAMES = {"micrometer": "µm", "micron": "µm", "microns": "µm", "um": "µm", "pixel": ""}


def voxel_of_xml(text: str, setup: int) -> tuple[np.ndarray | None, str]:
    """Read the size of a voxel of a setup and its unit; None if the XML does not say it."""
    for each in SETUP.findall(text):
        if not re.search(rf"<id>\s*{setup}\s*</id>", each):
            continue
        voxel = VOXEL.search(each)
        size = re.search(r"<size>([^<]*)</size>", voxel[1]) if voxel else None
        unit = re.search(r"<unit>([^<]*)</unit>", voxel[1]) if voxel else None
        with suppress(ValueError):
            steps = np.array([float(word) for word in size[1].split()]) if size else np.zeros(0)
            if steps.shape == (3,) and (steps > 0.0).all():
                name = unit[1].strip() if unit else ""
                return steps, UNIT_NAMES.get(name.lower(), name)
    return None, ""


def describe_ilastik(source: Source, data: Any) -> Said | None:
    """Name the axes of an array of vigra and ilastik, by its tags, which may give spacing."""
    if "axistags" not in data.attrs:
        return None
    try:
        tags = json.loads(attribute(data, "axistags"))["axes"]
        roles = tuple(str(tag["key"]).lower() for tag in tags)
        steps = {str(tag["key"]): float(tag.get("resolution") or 0.0) for tag in tags}
    except (ValueError, KeyError, TypeError):
        return None
    if len(roles) != data.ndim:
        return None
    sizes = [steps.get(name, 0.0) for name in "xyz"]
    said = Said(roles, placed="")
    if all(size > 0.0 and math.isfinite(size) for size in sizes):
        return replace(said, place=placed(np.diag(sizes), np.zeros(3)), placed="its axistags")
    return said


LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0])


def describe_itk(source: Source, data: Any) -> Said | None:
    """Place an image of ITK, which lies in a patient's left, posterior, superior."""
    group = data.parent
    if not group.name.startswith("/ITKImage") or not {"Spacing", "Origin"} <= set(group):
        return None
    spacing = np.ravel(group["Spacing"][()])[:3]
    origin = np.ravel(group["Origin"][()])[:3]
    turn = np.asarray(group["Directions"][()])[:3, :3] if "Directions" in group else np.eye(3)
    place = placed(LPS_TO_RAS @ (turn * spacing), LPS_TO_RAS @ origin, "mm", PATIENT_AXES)
    return Said(("z", "y", "x"), place, "its origin and directions")


MATLAB_NOTE = "The file is MATLAB's: the first index there is x, the second y, the third z."


def describe_matlab(source: Source, data: Any) -> Said | None:
    """Say which index of MATLAB is x: its arrays are written with the first index the fastest."""
    if "MATLAB_class" not in data.attrs:
        return None
    return Said(notes=(MATLAB_NOTE,))


MICROMETRES_ATTRIBUTE = "element_size_um"
"""The attribute by which microscopists' tools give spacing, z first."""


def describe_micrometres(source: Source, data: Any) -> Said | None:
    """Place an array whose attribute says how large voxels are in micrometres."""
    found = floats(data, MICROMETRES_ATTRIBUTE, 3)
    if found is None:
        return None
    z, y, x = (float(step) for step in found)
    return Said(place=Place((x, y, z), None, "µm", said=True), placed=f"'{MICROMETRES_ATTRIBUTE}'")


CHOICES: tuple[Choice, ...] = (choose_vtk, choose_imaris, choose_bdv, choose_nexus)

DESCRIPTIONS: tuple[Description, ...] = (
    describe_vtk,
    describe_openpmd,
    describe_imaris,
    describe_bdv,
    describe_itk,
    describe_ilastik,
    describe_micrometres,
    describe_nexus,
    describe_matlab,
)

LEVELLED: Sequence[Choice] = (choose_imaris, choose_bdv)
"""Dialects of which a level may be chosen."""
