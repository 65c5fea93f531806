"""OME-Zarr's metadata (NGFF 0.1 to 0.6), read and written: axes, resolutions and places, plates and
wells, labels.

Format: https://ngff.openmicroscopy.org.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import PATIENT_AXES, Grid, LabelName, on_right_angles
from isogi_core.files.units import METRES_OF_NAMES
from isogi_core.storage.atomic_file import whole_folder

SPACE_AXES = ("x", "y", "z")

UNIT_SIGNS = {
    "meter": "m",
    "millimeter": "mm",
    "centimeter": "cm",
    "micrometer": "µm",
    "nanometer": "nm",
    "angstrom": "Å",
}
"""Signs of units; others are written out."""

UNIT_WORDS = {sign: word for word, sign in UNIT_SIGNS.items()}
"""NGFF's names of units, by their signs."""

AXIS_ORIENTATIONS = {
    **{
        "left-to-right": (0, 1.0),
        "posterior-to-anterior": (1, 1.0),
        "inferior-to-superior": (2, 1.0),
    },
    **{
        "right-to-left": (0, -1.0),
        "anterior-to-posterior": (1, -1.0),
        "superior-to-inferior": (2, -1.0),
    },
}
"""Which axis of a patient's right, anterior, superior an axis lies along, and its sign. Source:
NGFF's RFC 4.
"""


@dataclass(frozen=True)
class Axis:
    """An axis of an array: its ``name``, such as z or c, its ``unit``, and the direction
    ``towards`` which it goes in a patient, one of AXIS_ORIENTATIONS; both are empty if the image
    does not give them.
    """

    name: str
    unit: str = ""
    towards: str = ""


@dataclass(frozen=True, eq=False)
class Resolution:
    """One array of a multiscale image: its ``path`` below the image, the axes of its world, and the
    ``matrix`` from the array's indices to these, (n, n + 1), whose last column is the origin. There
    are neither if the image has no axes.
    """

    path: str
    axes: tuple[Axis, ...] = ()
    matrix: np.ndarray | None = None

    @property
    def shifted(self) -> bool:
        """True if the array's first voxel is not at the origin."""
        return self.matrix is not None and bool(self.matrix[:, -1].any())


def ome_of(attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the metadata of OME among a group's attributes."""
    held = attributes.get("ome", attributes)
    return held if isinstance(held, Mapping) else {}


def resolutions_of(attributes: Mapping[str, Any], name: str) -> list[Resolution]:
    """Return the resolutions of the image whose group has these ``attributes``, finest first; empty
    if it is no image.

    Raises VolumeError, which names the image by ``name``, if its metadata are damaged, or if it is
    placed by a transformation that is not affine.
    """
    images = ome_of(attributes).get("multiscales")
    if images is None:
        return []
    with _undamaged(name):
        image = images[0]
        return [_resolution(image, each) for each in image["datasets"]]


@contextmanager
def _undamaged(name: str) -> Iterator[None]:
    """Raise VolumeError, which names the image, for whatever damaged metadata leads to."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise VolumeError(
            f"The OME metadata of '{name}' is damaged ({error!r}): write it again."
        ) from error


def _resolution(image: Mapping[str, Any], dataset: Mapping[str, Any]) -> Resolution:
    """Return one entry of the image's datasets, placed by its transformations and, before 0.6, by
    those of the whole image.
    """
    systems = image.get("coordinateSystems")
    steps = list(dataset.get("coordinateTransformations", []))
    if systems is not None:
        output = steps[0].get("output") if steps else None
        named = [
            each
            for each in systems
            if each["name"] == (output["name"] if isinstance(output, Mapping) else output)
        ]
        axes = _axes((named or systems)[0]["axes"])
    else:
        axes = _axes(image.get("axes", ()))
        steps += image.get("coordinateTransformations", [])
    path = str(dataset["path"])
    if not axes:
        return Resolution(path)
    return Resolution(path, axes, _sequence(steps, len(axes))[:-1])


def _axes(given: Any) -> tuple[Axis, ...]:
    """Return axes with their names and units; before NGFF 0.4 there were names alone."""
    return tuple(Axis(each.lower()) if isinstance(each, str) else _axis(each) for each in given)


def _axis(given: Mapping[str, Any]) -> Axis:
    towards = given.get("orientation") or ""
    if isinstance(towards, Mapping):
        towards = str(towards.get("value", ""))
    else:
        towards = str(towards)
    unit = str(given.get("unit") or "").lower().replace("metre", "meter")
    return Axis(str(given["name"]).lower(), unit, towards if towards in AXIS_ORIENTATIONS else "")


AFFINE_HINT = "write it with an affine one"


def _sequence(steps: Any, n: int) -> np.ndarray:
    """Return the matrix, (n + 1, n + 1), of transformations one after the other."""
    matrix = np.eye(n + 1)
    for step in steps:
        matrix = _matrix(step, n) @ matrix
    return matrix


def _matrix(step: Mapping[str, Any], n: int) -> np.ndarray:
    """Return the homogeneous matrix, (n + 1, n + 1), of one transformation of n axes.

    Raises VolumeError if it is of a kind that is not read here. Damaged metadata raise errors of
    several kinds, which the callers turn into VolumeError.
    """
    kind = step["type"]
    matrix = np.eye(n + 1)
    if kind == "sequence":
        return _sequence(step["transformations"], n)
    if kind == "bijection":
        return _matrix(step["forward"], n)
    if kind not in ("identity", "scale", "translation", "rotation", "affine", "mapAxis"):
        raise VolumeError(
            f"The image is placed by a transformation '{kind}', which is not read here: "
            f"{AFFINE_HINT}."
        )
    if kind != "identity" and kind not in step:
        raise VolumeError(
            f"The image is placed by a transformation '{kind}' that is not in its metadata: "
            f"{AFFINE_HINT}."
        )
    # An axis map lists the input axis of each output axis; scales are on the diagonal, translations
    # in the last column; rotations and affine matrices are given row by row.
    if kind == "mapAxis":
        matrix[:n] = matrix[np.array(step[kind], int)]
    elif kind in ("scale", "translation"):
        if len(step[kind]) != n:
            raise ValueError(f"a {kind} of {len(step[kind])} numbers for {n} axes")
        matrix[range(n), range(n) if kind == "scale" else n] = np.asarray(step[kind], float)
    elif kind != "identity":
        matrix[:n, : n + (kind == "affine")] = np.asarray(step[kind], float).reshape(n, -1)
    return matrix


def array_axes(resolution: Resolution) -> tuple[Axis, ...]:
    """Return the axes of a resolution's array: each is the one of the world along which it mostly
    goes.
    """
    assert resolution.matrix is not None, "there are axes"
    most = np.argmax(np.abs(resolution.matrix[:, :-1]), axis=0).tolist()
    if len(set(most)) == len(most):
        return tuple(resolution.axes[n] for n in most)
    return resolution.axes


def placed_in_space(resolution: Resolution) -> tuple[np.ndarray, str, str]:
    """Return the affine matrix from indices along x, y, z to the world's x, y, z, (3, 4), the sign
    of its unit, which is that of the x axis, and the letters of the patient's axes.

    The world is the patient's if all axes say in which anatomical direction they go; else the
    letters are empty, and the world is the image's. If the units of axes cannot be compared, they
    are taken as one: see ``odd_units``.
    """
    matrix, unit = _in_one_unit(resolution)
    towards = [axis.towards for name in SPACE_AXES for axis in resolution.axes if axis.name == name]
    places = [AXIS_ORIENTATIONS.get(word, (-1, 0.0)) for word in towards]
    if sorted(place for place, _ in places) != [0, 1, 2]:
        return matrix, unit, ""
    # Move each row of the matrix to the patient's axis along which it goes, with its direction.
    patient = np.empty_like(matrix)
    for row, (place, sign) in zip(matrix, places, strict=True):
        patient[place] = sign * row
    return patient, unit, PATIENT_AXES


def odd_units(resolution: Resolution) -> str:
    """List the units of axes in space if they differ and cannot be compared; else empty."""
    units = [axis.unit for name in SPACE_AXES for axis in resolution.axes if axis.name == name]
    if len(set(units)) < 2 or set(units) <= set(METRES_OF_NAMES):
        return ""
    return ", ".join(unit or "no unit" for unit in units)


def _in_one_unit(resolution: Resolution) -> tuple[np.ndarray, str]:
    """Return the matrix of ``placed_in_space`` and its unit, along the axes of the
    image's world.
    """
    assert resolution.matrix is not None, "there are axes"
    columns, rows = (
        [axis.name for axis in axes] for axes in (array_axes(resolution), resolution.axes)
    )
    units = [axis.unit for name in SPACE_AXES for axis in resolution.axes if axis.name == name]
    matrix = resolution.matrix[[rows.index(name) for name in SPACE_AXES]]
    matrix = matrix[:, [*(columns.index(name) for name in SPACE_AXES), -1]]
    if len(set(units)) == 1:
        return matrix, UNIT_SIGNS.get(units[0], units[0])
    if odd_units(resolution):
        return matrix, UNIT_SIGNS.get(units[0], units[0])
    lengths = np.array([METRES_OF_NAMES[each] / METRES_OF_NAMES[units[0]] for each in units])
    return matrix * lengths[:, None], UNIT_SIGNS.get(units[0], units[0])


def first_image(attributes: Mapping[str, Any], name: str, inside: str = "") -> tuple[str, str]:
    """Return the path of the first of several images below a group, and a note that lists the
    others; empty if it is no such group.

    Such a group is a plate of wells, a well of fields, or a file that bioformats2raw has converted.
    It is at the path ``inside`` the hierarchy of this ``name``. Raises VolumeError if its metadata
    are damaged.
    """
    held = ome_of(attributes)
    for kind, parts, part in (("plate", "wells", "well"), ("well", "images", "field")):
        if kind in held:
            with _undamaged(name):
                paths = [str(each["path"]) for each in held[kind][parts]]
                there = f"The {kind} has {_counted(len(paths), part)}"
                return paths[0], f"{there}: {paths[0]} is shown{_others(paths, inside)}."
    if "bioformats2raw.layout" in held and "multiscales" not in held:
        return (
            "0",
            "The file may hold several images: the first is shown, and #1 would choose the second.",
        )
    return "", ""


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count > 1 else ''}"


def _others(paths: list[str], inside: str) -> str:
    if len(paths) > 1:
        return f", and #{inside}/{paths[1]} chooses another".replace("#/", "#")
    return ""


def labels_of(attributes: Mapping[str, Any], name: str) -> tuple[LabelName, ...] | None:
    """Return the labels to which the image of labels ``name`` gives a name, a colour or other
    properties, ascending, without 0; None if the image is not one of labels.

    Raises VolumeError if its metadata are damaged.
    """
    held = ome_of(attributes).get("image-label")
    if not isinstance(held, Mapping):
        return None
    with _undamaged(name):
        colours = {each["label-value"]: each.get("rgba") for each in held.get("colors") or ()}
        names = {each["label-value"]: each for each in held.get("properties") or ()}
        return tuple(
            LabelName(int(value), _name(names.get(value, {})), _hex(colours.get(value)))
            for value in sorted({*colours, *names})
            if isinstance(value, int) and value
        )


def _name(properties: Mapping[str, Any]) -> str:
    """Return the name among a label's properties; their keys are not standardised."""
    keys = ("name", "label", "class", "class name")
    return next((value for key in keys if isinstance(value := properties.get(key), str)), "")


def _hex(rgba: Any) -> str:
    if rgba:
        return "#" + bytes(rgba[:3]).hex()
    return ""


CHUNK_VOXELS = 64
"""Voxels along each side of a chunk; levels are added until one fits into a chunk."""

MIN_HALVED_SIDE = 8
"""Voxels of a side, at least, that is halved in the next level."""

TURNED_AXES_NOTE = (
    "OME-Zarr keeps no turned axes: voxels are written as they lie, without "
    "their place in the world."
)

Progress = Callable[[int, int], object]
"""Is called with the layers that are written, of all."""


def write_image(grid: Grid, path: Path, progress: Progress) -> tuple[str, ...]:
    """Write a ``grid`` as an image in the folder ``path``, and return notes on properties that are
    lost. Raises VolumeError if there is something already; if writing fails, nothing is left.
    """
    if path.exists():
        raise VolumeError(
            f"There is something at '{path}' already: remove it, or choose another name."
        )
    grid = on_right_angles(grid)
    lies = Lying(grid)
    with whole_folder(path) as partial:
        _write(grid, lies, partial, progress)
    return (TURNED_AXES_NOTE,) if lies.turned else ()


class Lying:
    """The directions of the axes z, y, x of a ``grid`` on right angles in the world: their
    ``names`` there, and for each axis, True if it is read from its other end so that it ascends.
    ``turned`` axes go along none of the world's.
    """

    def __init__(self, grid: Grid) -> None:
        """Find the directions of the grid's axes."""
        if grid.affine is None:
            rows = np.eye(3)
        else:
            rows = np.array(grid.affine.matrix) / np.array(grid.spacing)
        whole = np.round(rows)
        self.turned = not np.allclose(rows, whole, atol=1e-6)
        whole = np.eye(3) if self.turned else whole
        along = [int(np.argmax(np.abs(whole[:, axis]))) for axis in (2, 1, 0)]
        self.names = ["xyz"[n] for n in along]
        self.flips = tuple(whole[n, axis] < 0.0 for n, axis in zip(along, (2, 1, 0), strict=True))
        self.steps = [float(step) for step in list(grid.spacing)[::-1]]
        if grid.affine is None or self.turned:
            origin = np.zeros(3)
        else:
            origin = np.array(grid.affine.origin)
        ends = [n - 1 if flip else 0 for n, flip in zip(grid.shape, self.flips, strict=True)]
        self.origin = [
            float(origin[n] - end * step)
            for n, end, step in zip(along, ends, self.steps, strict=True)
        ]
        if grid.affine is None or self.turned:
            self.letters = ""
        else:
            self.letters = grid.affine.letters

    def axes(self, unit: str) -> list[dict[str, Any]]:
        """Return the axes as NGFF describes them."""
        if unit:
            unit_of = {"unit": UNIT_WORDS.get(unit, unit)}
        else:
            unit_of = {}
        return [
            {"name": name, "type": "space", **unit_of, **self._towards(name)} for name in self.names
        ]

    def _towards(self, name: str) -> dict[str, Any]:
        """Return the direction in which an axis of a patient points, as NGFF describes it."""
        value = next(
            word for word, place in AXIS_ORIENTATIONS.items() if place == ("xyz".index(name), 1.0)
        )
        if self.letters:
            return {"orientation": {"type": "anatomical", "value": value}}
        return {}


def _write(grid: Grid, lies: Lying, path: Path, progress: Progress) -> None:
    """Write all levels and their description."""
    shapes = [np.array(grid.shape)]
    while shapes[-1].max() > CHUNK_VOXELS:
        shapes.append(np.where(shapes[-1] >= MIN_HALVED_SIDE, -(-shapes[-1] // 2), shapes[-1]))
    total = sum(int(shape[0]) for shape in shapes)
    done = 0
    datasets = []
    group = zarr.open_group(path, mode="w")
    before = None
    factor = np.ones(3)
    labelled = grid.labels is not None
    for level, shape in enumerate(shapes):
        sides = tuple(int(n) for n in shape)
        array = zarr.create_array(
            path / str(level),
            shape=sides,
            chunks=(CHUNK_VOXELS,) * 3,
            dtype=grid.dtype,
            fill_value=0,
        )
        if before is None:
            blocks = _flipped(_blocks(grid), sides[0], lies.flips)
        else:
            halves = np.array(before.shape) > shape
            factor = factor * np.where(halves, 2.0, 1.0)
            blocks = _coarser(before, halves.tolist(), labelled)
        for z, block in blocks:
            array[z : z + len(block)] = block
            done += len(block)
            progress(done, total)
        datasets.append(_dataset(level, lies, factor, labelled))
        before = array
    images: Any = [{"name": path.stem, "axes": lies.axes(grid.unit), "datasets": datasets}]
    group.attrs["ome"] = {"version": "0.5", "multiscales": images, **_labels(grid)}


def _dataset(level: int, lies: Lying, factor: np.ndarray, labelled: bool) -> dict[str, Any]:
    """Return the place of a level: its first voxel is in the middle of those whose mean it is."""
    steps = [step * each for step, each in zip(lies.steps, factor.tolist(), strict=True)]
    shift = [
        0.0 if labelled else 0.5 * (far - near) for far, near in zip(steps, lies.steps, strict=True)
    ]
    place = [origin + each for origin, each in zip(lies.origin, shift, strict=True)]
    placed = [{"type": "scale", "scale": steps}, {"type": "translation", "translation": place}]
    return {"path": str(level), "coordinateTransformations": placed if any(place) else placed[:1]}


def _blocks(grid: Grid) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the grid's layers, as many as a chunk has at once, each block with the number of its
    first layer.
    """
    held: list[np.ndarray] = []
    z = 0
    for slab in grid.slabs():
        for layer in slab:
            held.append(layer)
            if len(held) == CHUNK_VOXELS:
                yield z, np.stack(held)
                z = z + CHUNK_VOXELS
                held = []
    if held:
        yield z, np.stack(held)


def _flipped(
    blocks: Iterator[tuple[int, np.ndarray]], depth: int, flips: tuple[bool, ...]
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield blocks read from the other end along the axes of ``flips``."""
    turn = tuple(slice(None, None, -1 if flip else 1) for flip in flips)
    for z, block in blocks:
        yield (depth - z - len(block) if flips[0] else z), block[turn]


def _coarser(array: Any, halves: list[bool], labelled: bool) -> Iterator[tuple[int, np.ndarray]]:
    """Yield blocks of half as many voxels along the axes that are ``halves``: means, or, of labels,
    every second one.
    """
    deep = 2 if halves[0] else 1
    for z in range(0, array.shape[0], deep * CHUNK_VOXELS):
        block = np.asarray(array[z : z + deep * CHUNK_VOXELS])
        yield z // deep, halved(block, halves, labelled)


def halved(block: np.ndarray, halves: list[bool], labelled: bool = False) -> np.ndarray:
    """Return a block whose neighbours along the axes that are ``halves`` are joined: to their mean
    without holes, in the block's type, or to the first of them if they are ``labelled``. The last
    voxel of an odd side stays as it is.
    """
    if labelled:
        return block[tuple(slice(None, None, 2 if half else 1) for half in halves)]
    values = block.astype(np.float64)
    there = ~np.isnan(values)
    total = np.where(there, values, 0.0)
    count = there.astype(np.float64)
    for axis, half in enumerate(halves):
        if half:
            places = np.arange(0, total.shape[axis], 2)
            total, count = (np.add.reduceat(each, places, axis) for each in (total, count))
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return (np.rint(mean) if block.dtype.kind in "iub" else mean).astype(block.dtype)


def _labels(grid: Grid) -> dict[str, Any]:
    """Return the names and colours of a segmentation's labels, as NGFF has them."""
    if grid.labels is None:
        return {}
    colours = [
        {"label-value": each.value, "rgba": [*bytes.fromhex(each.colour[1:]), 255]}
        for each in grid.labels
        if each.colour
    ]
    names = [{"label-value": each.value, "name": each.name} for each in grid.labels if each.name]
    return {"image-label": {"version": "0.5", "colors": colours, "properties": names}}


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else path.rglob("*")
    return sum(each.stat().st_size for each in files if each.is_file())
