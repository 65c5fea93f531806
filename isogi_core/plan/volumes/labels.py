"""Labels of a segmentation: those that are shown, and the smooth field whose surface at
LABEL_ISOVALUE is theirs.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.grid import Grid, LabelName, gathered, slab_layers
from isogi_core.files.mappings import require_memory
from isogi_core.files.scene_file import Settings, tables_in
from isogi_core.files.vector import triple
from isogi_core.model.colours import Label, linear_of
from isogi_core.model.lights import Colour
from isogi_core.model.value_survey import check
from isogi_core.model.volume import Volume

ALL_LABELS = "all"
"""Value of ``labels`` in a scene that lists none: its volume is a segmentation, and every label
but 0 is shown.
"""

MAX_LABELS = 255
"""Most labels that are shown: codes of a byte, except the one for places without a label."""

LABEL_ISOVALUE = 0.5
"""Isovalue of the labels' surfaces: half-way between voxels inside and outside."""

SIGMA = 1.0
SMOOTHING_REACH = 3
"""Standard deviation of the Gaussian that smooths labels, and the distance to which it is
summed, in voxels along each axis.
"""

THIN_FIELD = 0.8
"""Value of the field in parts that the Gaussian would remove: of a lone voxel 0.8 of its width
stays.
"""

MAX_LABEL_VALUE = 2**53
"""Values of labels are below this: pages and scripts that read JSON cannot distinguish larger
numbers.
"""

VALUE_SETTINGS = (
    *(
        "isovalue",
        "isovalues",
        "presets",
        "solid",
        "inside_out",
        "missing",
        "albedo",
        "albedos",
        "material",
    ),
    *("surfaces", "clear", "transmission"),
)
"""Settings that labels do not have: a scene with one of them shows the values of a file, even
if the file says that they are labels.
"""

PALETTE = re.findall(
    "......",
    "e6194b3cb44b4363d8f58231911eb442d4f4ffe119f032e64699909a6324"
    "bfef45fabed4800000dcbeff808000aaffc3000075ffd8b1a9a9a9fffac8",
)
"""Colours of labels that have none, sRGB: twenty that are easy to distinguish (S. Trubetskoy
2017), repeated.
"""


@dataclass(frozen=True)
class LabelTable:
    """A table [[labels]] of a scene; ``colour`` is linear. A name and colour that it lacks may
    be in the file.
    """

    value: int
    name: str = ""
    colour: Colour | None = None
    hidden: bool = False


def find_labels(settings: Settings) -> tuple[LabelTable, ...] | None:
    """Return the labels that a scene lists; an empty tuple if it shows all, None if its volume
    is not a segmentation. Raises SceneError.
    """
    settings.known.add("labels")
    if settings.source.document.get("labels") == ALL_LABELS:
        return ()
    found = tuple(map(_read_label, settings.nested("labels")))
    values = [label.value for label in found]
    twice = next((value for value in values if values.count(value) > 1), None)
    if twice is not None:
        raise SceneError(
            f"The scene '{settings.source.name}' lists label {twice} twice: leave one out."
        )
    return found or None


def _read_label(table: Settings) -> LabelTable:
    """Read one table [[labels]]. Raises SceneError."""
    source = table.source
    value = source.document.get("value")
    if not isinstance(value, int) or isinstance(value, bool) or value == 0:
        raise SceneError(
            f"value = {value!r} in the scene '{source.name}' is not a whole number other than 0."
        )
    table.known.update(("value", "colour"))
    given = source.document.get("colour")
    if given is None:
        colour = None
    elif isinstance(given, str):
        colour = _hex(given, source.name)
    else:
        colour = table.colour("colour", 0)
    name = table.text("name", "")
    hidden = table.flag("hidden", False)
    table.refuse_unknown()
    return LabelTable(value, name, colour, bool(hidden))


def _hex(code: str, scene: str) -> Colour:
    """Return the linear colour of ``#rrggbb``. Raises SceneError if ``code`` is not such a text."""
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", code):
        raise SceneError(
            f"colour = '{code}' in the scene '{scene}' is neither '#rrggbb' nor linear [r, g, b]."
        )
    return linear_hex(code[1:])


def linear_hex(code: str) -> Colour:
    """Return the linear colour of sRGB ``rrggbb``."""
    return triple(linear_of(byte / 255.0) for byte in bytes.fromhex(code))


@dataclass(frozen=True, eq=False)
class Segmentation:
    """A ``grid`` of labels, whole numbers of which 0 is no label, and the labels that a scene
    has ``listed``. Labels that are not listed are shown, too.
    """

    grid: Grid
    listed: tuple[LabelTable, ...]

    @cached_property
    def values(self) -> np.ndarray:
        """The values that occur, ascending, and 0. Raises VolumeError if one is not a whole
        number, or too large.
        """
        # Collect the distinct values slab by slab, and check them before they become integers.
        found = [np.zeros(1, np.int64)]
        for slab in self.grid.slabs():
            distinct = _distinct(slab)
            whole = np.isfinite(distinct) & (distinct == np.trunc(distinct))
            wrong = distinct[~whole]
            if len(wrong):
                raise VolumeError(
                    f"The segmentation holds {wrong[0]:g}: labels are whole numbers: correct it, "
                    "or leave labels out."
                )
            # Values ascend, so that the largest in size is at an end.
            large = next(
                (
                    int(value)
                    for value in (distinct[0], distinct[-1])
                    if abs(int(value)) >= MAX_LABEL_VALUE
                ),
                None,
            )
            if large is not None:
                raise VolumeError(
                    f"The segmentation has the label {large}: give its labels numbers below 2^53."
                )
            found.append(distinct.astype(np.int64))
        return np.unique(np.concatenate(found))

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """All labels that occur, hidden ones included, ascending by value.

        Raises VolumeError if there is none, if a value is no whole number or too large, or if more
        than MAX_LABELS are shown. Raises SceneError if the scene lists a label that does not occur,
        or if all are hidden.
        """
        values = [value for value in self.values.tolist() if value]
        if not values:
            raise VolumeError("The segmentation has no label: every voxel is 0.")
        in_scene = {label.value: label for label in self.listed}
        in_file = {label.value: label for label in self.grid.labels or ()}
        lacking = next((label for label in self.listed if label.value not in values), None)
        if lacking is not None:
            there = ", ".join(map(str, values[:8])) + (" …" if len(values) > 8 else "")
            raise SceneError(
                f"The segmentation has no voxel of label {lacking.value}: it has {there}."
            )
        # Colours of the palette follow the places of all labels, so that hiding one does not change
        # the others.
        found = tuple(
            _label(
                place, in_scene.get(value, LabelTable(value)), in_file.get(value, LabelName(value))
            )
            for place, value in enumerate(values)
        )
        shown = sum(label.shown for label in found)
        if not shown:
            raise SceneError("All labels of the segmentation are hidden: show one.")
        if shown > MAX_LABELS:
            raise VolumeError(
                f"The segmentation has {shown} labels, and {MAX_LABELS} can be shown: hide or "
                "join some."
            )
        return found

    @cached_property
    def codes(self) -> np.ndarray:
        """The number of each voxel's label among the shown ones, from 1 on; 0 for none; (nz,
        ny, nx) uint8.
        """
        require_memory(self.grid.size, "The segmentation takes", "give a coarser one")
        table = np.zeros(len(self.values), np.uint8)
        shown = [label.value for label in self.labels if label.shown]
        table[np.searchsorted(self.values, shown)] = np.arange(1, len(shown) + 1)
        coded = (table[np.searchsorted(self.values, slab)] for slab in self.grid.slabs())
        return gathered(self.grid.shape, np.uint8, coded)

    def field(self) -> Iterator[np.ndarray]:
        """Yield the slabs of the field whose surface at LABEL_ISOVALUE is that of the shown
        labels.
        """
        return smooth(self.codes > 0)

    def stamp(self) -> str:
        """Return a text that changes if the field does."""
        return repr(
            ["labels", self.grid.stamp(), [label.value for label in self.listed if label.hidden]]
        )


def _distinct(slab: np.ndarray) -> np.ndarray:
    """Return the distinct values of a ``slab``, ascending."""
    # NumPy counts no truth values: take them as 0 and 1.
    if slab.dtype.kind == "b":
        values = slab.view(np.uint8)
    else:
        values = slab
    # Integers of one or two bytes have few possible values: to count each is faster than to sort.
    if values.dtype.kind in "iu" and values.dtype.itemsize <= 2:
        low = int(values.min())
        return np.flatnonzero(np.bincount((values.astype(np.int32) - low).ravel())) + low
    return np.unique(values)


def _label(place: int, listed: LabelTable, named: LabelName) -> Label:
    """Make the label at a ``place`` among all that occur: as the scene lists it, else as the
    file names it.
    """
    code = named.colour[1:] or PALETTE[place % len(PALETTE)]
    name = listed.name or named.name or f"label {listed.value}"
    return Label(listed.value, name, listed.colour or linear_hex(code), not listed.hidden)


def smooth(shown: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the field of the voxels that are ``shown`` (nz, ny, nx), from 0 to 1 by a Gaussian,
    slab by slab; float32.

    Parts so thin that nothing of them or next to them would be above LABEL_ISOVALUE get THIN_FIELD
    instead. Beyond its ends the volume keeps its outermost voxels.
    """
    nz = len(shown)
    # A slab needs the reach of the Gaussian, and two voxels more for the test of thin parts.
    halo = SMOOTHING_REACH + 2
    layers = slab_layers(4 * shown[0].size)
    for z in range(0, nz, layers):
        end = min(z + layers, nz)
        part = shown[np.clip(np.arange(z - halo, end + halo), 0, nz - 1)]
        field = part.astype(np.float32)
        for axis in range(3):
            field = _blurred(field, axis)
        # A shown voxel is lost if no shown voxel near it stays above the isovalue.
        kept = part & (field >= LABEL_ISOVALUE)
        lost = part & ~kept & _widened(part & ~_widened(kept))
        field[lost] = THIN_FIELD
        yield field[halo : halo + end - z]


def _moved(array: np.ndarray, axis: int, step: int) -> np.ndarray:
    """Return the ``array`` moved by a ``step`` along an ``axis``; its ends are repeated."""
    n = array.shape[axis]
    return array.take(np.clip(np.arange(n) + step, 0, n - 1), axis)


def _blurred(field: np.ndarray, axis: int) -> np.ndarray:
    """Return the Gaussian sums of a ``field`` along an ``axis``. Terms are added in pairs from
    both sides, so that a mirrored field has the same bits.
    """
    weights = np.exp(-0.5 * (np.arange(SMOOTHING_REACH + 1) / SIGMA) ** 2)
    weights = (weights / (2.0 * weights.sum() - weights[0])).astype(np.float32)
    total = weights[0] * field
    for step in range(1, SMOOTHING_REACH + 1):
        total += weights[step] * (_moved(field, axis, -step) + _moved(field, axis, step))
    return np.asarray(total)


def _widened(part: np.ndarray) -> np.ndarray:
    """Return which voxels are in a ``part``, or have one of their 26 neighbours in it."""
    for axis in range(3):
        part = part | _moved(part, axis, -1) | _moved(part, axis, 1)
    return part


def are_labels(grid: Grid, settings: Settings) -> bool:
    """Return True if a volume's file says that it is a segmentation, and the scene has no
    setting that labels do not have.
    """
    document = settings.source.document
    coloured = any(each.get("use") == "colour" for each in tables_in(document, "volumes"))
    return (
        grid.labels is not None
        and not coloured
        and not any(key in document for key in VALUE_SETTINGS)
    )


SAMPLED_VOXELS = 1 << 18
SAMPLED_LAYERS = 16
MIN_ALIKE_SHARE = 0.8
MAX_LABEL_VALUES = 4096
"""Thresholds of ``look_like_labels``: voxels that are read, and the layers that they lie in;
least share of equal neighbours within objects; most distinct values. Seventeen real volumes had
shares of 0 to 0.72, two segmentations 0.83 and 0.93.
"""


def look_like_labels(volume: Volume) -> int:
    """Return the number of distinct values in a sample of rows, if the values of a volume look
    like labels; else 0.
    """
    if not volume.dtype.startswith(("int", "uint")):
        return 0
    layers = volume.voxels[:: max(len(volume.voxels) // SAMPLED_LAYERS, 1)]
    rows = layers[:, :: max(layers.size // SAMPLED_VOXELS, 1)]
    values, counts = np.unique(rows[~np.isnan(rows)], return_counts=True)
    # The most frequent value counts as the space around objects.
    around = values[np.argmax(counts)]
    one = rows[..., :-1]
    other = rows[..., 1:]
    # Labels are constant within objects: count the neighbours along x that are equal.
    within = (one != around) & (other != around)
    alike = np.count_nonzero((one == other) & within) >= MIN_ALIKE_SHARE * max(
        int(np.count_nonzero(within)), 1
    )
    if alike and 3 <= len(values) <= MAX_LABEL_VALUES:
        return len(values)
    return 0


PROPOSED = (
    'Its values look like labels, {count} of them: labels = "all" in the scene, or '
    "#labels=all, shows them so."
)


BY_ITSELF = "The file says that it is a segmentation: its labels are shown."


def solid_of_labels(grid: Grid, listed: tuple[LabelTable, ...], settings: Settings) -> Grid:
    """Return the field of the labels in a segmentation's ``grid``, as a grid. Raises SceneError
    and VolumeError.
    """
    check(grid, "above")
    for key in ("solid", "missing"):
        if key in settings.source.document:
            raise SceneError(
                f"The scene '{settings.source.name}' shows labels, which need no {key}: leave "
                "it out."
            )
    found = Segmentation(grid, listed)
    # Note on the volume which labels are hidden, and that the file alone made it a segmentation.
    hidden = [label.name for label in found.labels if not label.shown]
    notes: tuple[str, ...] = (BY_ITSELF,) if "labels" not in settings.source.document else ()
    if hidden:
        notes += (f"Hidden: {', '.join(hidden)}.",)
    facts: dict[str, Any] = {
        "dtype": np.dtype(np.float32),
        "slabs": found.field,
        "stamp": found.stamp,
    }
    return replace(grid, **facts, notes=(*grid.notes, *notes))
