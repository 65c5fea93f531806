"""Stacks of DICOM slices, their order along the normal, gaps, doubles and positions; and DICOM
segmentations.

DICOM's segmentations: which frames are of which segment, and the names and colours of these.
Source: DICOM PS3.3, A.51 and C.8.20. A frame has the voxels of one segment, as bits or as
fractions, or, in a label map, the numbers of all segments. Frames in which nothing is are left out
of files.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import SPACING_KEY
from isogi_core.files.grid import LabelName, srgb_bytes
from isogi_core.files.packing import Packing

EVEN_STEP_SHARE = 0.05
"""Largest part of the usual step by which a step between slices may stray and still be even."""

MAX_LAYERS_PER_SLICE = 8
"""Largest number of layers for each slice, if these are uneven."""

PIXELS_UNMEASURED = (
    f"The slices do not say how far apart their pixels are, and 1 mm is taken: {SPACING_KEY}."
)
"""The note on slices of known positions without a spacing of pixels."""

Layers = tuple[tuple[tuple[Any, float, Packing], ...], ...]
"""Place, weight and packing of each slice of each layer; a layer without slices is missing."""


@dataclass(frozen=True)
class Slice:
    """One slice: the ``place`` of its pixels, its ``uid`` and its ``number``, and how it lies, as
    far as is known.

    ``position`` is that of its first pixel, ``pose`` the directions of rows and columns, ``pixel``
    the step along each and ``between`` that to the next slice, millimetres of a patient's left,
    posterior, superior.
    """

    place: Any
    uid: str
    number: tuple[int, int]
    position: tuple[float, ...] | None
    pose: tuple[float, ...] | None
    pixel: tuple[float, float] | None
    between: float | None
    packing: Packing


@dataclass(frozen=True)
class Stack:
    """Layers from first to last: each is a weighted mean of slices, or empty if a slice is missing.

    ``affine`` (3, 4) brings voxel indices to the patient's left, posterior, superior, in mm; None
    if that is unknown. ``measured`` is True if the file gives the steps between pixels. ``between``
    is True if some layer is interpolated between slices, or missing.
    """

    layers: Layers
    affine: np.ndarray | None
    spacing: tuple[float, float, float]
    measured: bool
    between: bool


Pick = Callable[[int, str], int]
"""Function that returns the index of the chosen one of a number of fields, 0 if there is only one;
its text names the fields in messages. Raises VolumeError if none of several is chosen.
"""


def stack_of(
    name: str, slices: list[Slice], pick: Pick, sparse: bool = False
) -> tuple[Stack, tuple[str, ...]]:
    """Return the stack of ``slices`` in any order, with notes on all that was mended. Raises
    VolumeError if they make none.

    Of ``sparse`` slices some are left out as nothing is in them: no layer is interpolated.
    """
    distinct = list({each.uid: each for each in slices}.values())
    doubled = len(slices) - len(distinct)
    if doubled:
        notes = [f"{doubled} doubled slices were left out."]
    else:
        notes = []
    if any(each.position is None or each.pose is None for each in distinct):
        ordered = sorted(distinct, key=lambda each: each.number)
        notes.append(
            "The slices do not say where they lie: they are in the order of their numbers."
        )
        return _unplaced(ordered), tuple(notes)
    normal = _normal(name, distinct[0])
    heights = np.array([np.dot(normal, each.position or ()) for each in distinct])
    ordered, heights = _one_time(name, distinct, heights, pick)
    return _placed(name, ordered, heights, notes, sparse)


def _unplaced(slices: list[Slice]) -> Stack:
    first = slices[0]
    x, y = first.pixel or (1.0, 1.0)
    layers = tuple(((each.place, 1.0, each.packing),) for each in slices)
    return Stack(layers, None, (x, y, first.between or x), first.pixel is not None, False)


def _normal(name: str, first: Slice) -> np.ndarray:
    pose = np.array(first.pose)
    if pose.shape == (6,):
        normal = np.cross(pose[:3], pose[3:])
    else:
        normal = np.zeros(3)
    if not np.linalg.norm(normal) > 0.5:
        raise VolumeError(
            f"The slices of '{name}' have no orientation that can be: write them again."
        )
    return np.asarray(normal / np.linalg.norm(normal))


def _one_time(
    name: str, slices: list[Slice], heights: np.ndarray, pick: Pick
) -> tuple[list[Slice], np.ndarray]:
    """Return the slices of one time step, and their heights in mm, both in ascending order.

    If several slices lie at each place, such as time steps or echoes, ``pick`` chooses one by its
    rank in the order of their numbers. Raises VolumeError if some places have more slices than
    others.
    """
    # Heights that agree to a micrometre are one place. Sort by place, then by number, so that the
    # slices of a place follow each other.
    rounded = np.round(heights, 3)
    order = sorted(range(len(slices)), key=lambda n: (rounded[n], slices[n].number))
    places, counts = np.unique(rounded, return_counts=True)
    if len(set(counts.tolist())) > 1:
        raise VolumeError(
            f"'{name}' has {len(slices)} slices at {len(places)} places, some doubled: leave "
            "the odd ones out."
        )
    times = int(counts[0])
    # Each place has ``times`` slices: take that of the same rank from each.
    chosen = order[pick(times, "slices at each place") :: times]
    return [slices[n] for n in chosen], heights[chosen]


def _placed(
    name: str, slices: list[Slice], heights: np.ndarray, notes: list[str], sparse: bool
) -> tuple[Stack, tuple[str, ...]]:
    """Return the stack of slices in order, with the slices as layers if steps are even, and
    interpolated layers if they are not.
    """
    first = slices[0]
    last = slices[-1]
    steps = np.diff(heights)
    if first.pixel is None:
        notes.append(PIXELS_UNMEASURED)
    if sparse or not len(steps):
        given = first.between
    else:
        given = None
    usual = given or (float(np.median(steps)) if len(steps) else 1.0)
    whole = np.round(steps / usual)
    if np.all(np.abs(steps - usual * whole) <= EVEN_STEP_SHARE * usual) and np.all(whole >= 1):
        layers = _with_gaps(slices, whole.astype(int))
        missing = len(layers) - len(slices)
        if missing and not sparse:
            notes.append(
                f"{missing} of {len(layers)} slices are missing: there are holes in their place."
            )
    elif sparse:
        raise VolumeError(
            f"The slices of the segmentation '{name}' are unevenly spaced: save it in even ones."
        )
    else:
        usual, said = _even_step(name, steps, usual, len(slices))
        count = round(float(heights[-1] - heights[0]) / usual) + 1
        usual = float(heights[-1] - heights[0]) / (count - 1)
        layers = _mixed(slices, heights, heights[0] + usual * np.arange(count))
        notes.append(said.format(usual=usual))
    return _stack(layers, first, last, usual), tuple(notes)


MAX_ODD_SHARE = 0.1
"""Largest share of the steps that stray while the others are even."""


def _even_step(name: str, steps: np.ndarray, usual: float, count: int) -> tuple[float, str]:
    """Choose the step of even layers through uneven slices, with a note for that: the ``usual`` one
    if few stray from it, else the least one, which loses none. Raises VolumeError if layers would
    be too many.
    """
    odd = np.abs(steps - usual) > EVEN_STEP_SHARE * usual
    span = float(steps.sum()) / usual
    few = odd.sum() <= max(MAX_ODD_SHARE * len(steps), 2.0)
    if few and 2 * odd.sum() < len(steps) and abs(span - round(span)) <= EVEN_STEP_SHARE:
        worst = float(np.abs(steps - usual).max())
        return usual, (
            f"Slices lie up to {worst:.3g} mm off their even places, {{usual:.4g}} mm apart: "
            "the layers there were interpolated, linearly."
        )
    least = float(steps.min())
    if float(steps.sum()) / least > MAX_LAYERS_PER_SLICE * count:
        raise VolumeError(
            f"The slices of '{name}' lie from {least:.3g} to {steps.max():.3g} apart: resample "
            "them."
        )
    return least, (
        "The slices are unevenly spaced: layers {usual:.4g} apart were interpolated, linearly."
    )


def _with_gaps(slices: list[Slice], steps: np.ndarray) -> Layers:
    """Return a layer for each slice, and empty ones in each step that is as long as several."""
    layers: list[tuple[tuple[Any, float, Packing], ...]] = [
        ((slices[0].place, 1.0, slices[0].packing),)
    ]
    for each, step in zip(slices[1:], steps.tolist(), strict=True):
        layers += [()] * (step - 1)
        layers.append(((each.place, 1.0, each.packing),))
    return tuple(layers)


def _mixed(slices: list[Slice], heights: np.ndarray, at: np.ndarray) -> Layers:
    """Return layers ``at`` even heights, each interpolated between the two slices around it."""
    layers = []
    for height in at:
        n = int(np.clip(np.searchsorted(heights, height, "right") - 1, 0, len(slices) - 2))
        share = float(np.clip((height - heights[n]) / (heights[n + 1] - heights[n]), 0.0, 1.0))
        pair = ((slices[n], 1.0 - share), (slices[n + 1], share))
        layers.append(
            tuple((each.place, weight, each.packing) for each, weight in pair if weight > 1e-6)
        )
    return tuple(layers)


def _stack(layers: Layers, first: Slice, last: Slice, usual: float) -> Stack:
    """Return the stack of even ``layers`` from the ``first`` to the ``last`` slice, with its affine
    map.

    The step between layers leads from the first position to the last, tilted or not; that of a
    single layer is ``usual``, in mm, along the normal. Pixels without steps are 1 mm wide.
    """
    x, y = first.pixel or (1.0, 1.0)
    pose = np.array(first.pose)
    origin = np.array(first.position)
    if len(layers) > 1:
        along = (np.array(last.position) - origin) / (len(layers) - 1)
    else:
        along = np.cross(pose[:3], pose[3:]) * usual
    affine = np.column_stack([pose[:3] * x, pose[3:] * y, along, origin])
    # Values must then be floats: for means of two slices, and for the NaN of a missing layer.
    mixed_or_missing = any(len(layer) != 1 for layer in layers)
    spacing = (x, y, float(np.linalg.norm(along)))
    return Stack(layers, affine, spacing, first.pixel is not None, mixed_or_missing)


SEGMENT_TAGS = ("SegmentSequence", "SegmentationType", "MaximumFractionalValue")
"""Tags of a segmentation's header that are read besides those of other images."""

TO_RED_GREEN_BLUE = np.array(
    [
        [3.1338561, -1.6168667, -0.4906146],
        [-0.9787684, 1.9161415, 0.0334540],
        [0.0719453, -0.2289914, 1.4052427],
    ]
)
"""From XYZ under D50 to linear sRGB, adapted by Bradford's method. Source: Lindbloom,
brucelindbloom.com.
"""

D50_WHITE = np.array([0.96422, 1.0, 0.82521])
"""XYZ of D50."""


def is_segmentation(header: Any) -> bool:
    """Return True if a file is a segmentation."""
    return "SegmentSequence" in header


def segments_of(header: Any) -> tuple[LabelName, ...]:
    """Return the segments of a segmentation, whose numbers are the labels; a label map may list its
    background as 0.
    """
    listed = ((int(each.SegmentNumber), each) for each in header.SegmentSequence)
    return tuple(
        LabelName(
            number,
            str(each.get("SegmentLabel", "")),
            _colour_of_segment(each.get("RecommendedDisplayCIELabValue")),
        )
        for number, each in listed
        if number
    )


def _colour_of_segment(lab: Any) -> str:
    """Return the sRGB ``#rrggbb`` of CIELab in 16 bits each; empty if there is none. Source: DICOM
    PS3.3, C.10.7.1.1.
    """
    if lab is None or len(lab) != 3:
        return ""
    lightness, a, b = np.array(lab, float) / 65535.0 * (100.0, 255.0, 255.0) - (0.0, 128.0, 128.0)
    y = (lightness + 16.0) / 116.0
    curve = np.array([y + a / 500.0, y, y - b / 200.0])
    xyz = D50_WHITE * np.where(
        curve > 6.0 / 29.0, curve**3, 3.0 * (6.0 / 29.0) ** 2 * (curve - 4.0 / 29.0)
    )
    return "#" + srgb_bytes(TO_RED_GREEN_BLUE @ xyz).tobytes().hex()


def segment_in(header: Any, groups: list[Any]) -> int:
    """Return the number of the segment that a frame shows, by its functional ``groups``; 0 if its
    pixels are numbers of segments, or if no group gives a segment.
    """
    if header.get("SegmentationType") == "LABELMAP":
        return 0
    for group in groups:
        if found := group.get("SegmentIdentificationSequence"):
            return int(found[0].ReferencedSegmentNumber)
    return 0


def numbered(pixels: np.ndarray, segment: int, header: Any) -> np.ndarray:
    """Return the ``pixels`` of a segmentation's frame as numbers of segments, uint16. Pixels of
    other images stay as they are.

    If the frame shows one ``segment``, pixels of which it has at least half get its number, all
    others 0. If ``segment`` is 0, the pixels are numbers of segments already, as in a label map.
    """
    if not is_segmentation(header):
        return pixels
    if not segment:
        return pixels.astype(np.uint16)
    if header.get("SegmentationType") == "FRACTIONAL":
        full = int(header.get("MaximumFractionalValue", 1))
    else:
        full = 1
    return np.where(2.0 * pixels >= full, np.uint16(segment), np.uint16(0))


def overlaid(slices: list[Slice]) -> list[Slice]:
    """Return one slice for all frames at a position: their places are listed together."""
    at: dict[tuple[float, ...] | int, Slice] = {}
    for number, each in enumerate(slices):
        position = number if each.position is None else tuple(round(x, 3) for x in each.position)
        known = at.get(position)
        if known is None:
            at[position] = each
        else:
            at[position] = replace(known, place=(*known.place, *each.place))
    return list(at.values())
