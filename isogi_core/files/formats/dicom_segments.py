"""DICOM's segmentations: which frames are of which segment, and the names and colours of these.

Source: DICOM PS3.3, A.51 and C.8.20. A frame has the voxels of one segment, as bits or as fractions, or, in a label
map, the numbers of all segments. Frames in which nothing is are left out of files.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from isogi_core.files.formats.dicom_stack import Slice
from isogi_core.files.grid import LabelName

SEGMENT_TAGS = ("SegmentSequence", "SegmentationType", "MaximumFractionalValue")
"""What is read of a header besides that of other images."""

TO_RED_GREEN_BLUE = np.array(
    [
        [3.1338561, -1.6168667, -0.4906146],
        [-0.9787684, 1.9161415, 0.0334540],
        [0.0719453, -0.2289914, 1.4052427],
    ]
)
"""From XYZ under D50 to linear sRGB, adapted by Bradford's method. Source: Lindbloom, brucelindbloom.com."""

D50_WHITE = np.array([0.96422, 1.0, 0.82521])
"""XYZ of D50."""


def is_segmentation(header: Any) -> bool:
    """Whether a file is a segmentation."""
    return "SegmentSequence" in header


def segments_of(header: Any) -> tuple[LabelName, ...]:
    """The segments of a segmentation, whose numbers are the labels; a label map may list its background as 0."""
    listed = ((int(each.SegmentNumber), each) for each in header.SegmentSequence)
    return tuple(
        LabelName(
            number, str(each.get("SegmentLabel", "")), _colour_of_segment(each.get("RecommendedDisplayCIELabValue"))
        )
        for number, each in listed
        if number
    )


def _colour_of_segment(lab: Any) -> str:
    """The sRGB ``#rrggbb`` of CIELab in 16 bits each; empty where there is none. Source: DICOM PS3.3, C.10.7.1.1."""
    if lab is None or len(lab) != 3:
        return ""
    lightness, a, b = np.array(lab, float) / 65535.0 * (100.0, 255.0, 255.0) - (0.0, 128.0, 128.0)
    y = (lightness + 16.0) / 116.0
    curve = np.array([y + a / 500.0, y, y - b / 200.0])
    xyz = D50_WHITE * np.where(curve > 6.0 / 29.0, curve**3, 3.0 * (6.0 / 29.0) ** 2 * (curve - 4.0 / 29.0))
    linear = np.clip(TO_RED_GREEN_BLUE @ xyz, 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return "#" + np.rint(255.0 * coded).astype(np.uint8).tobytes().hex()


def segment_in(header: Any, groups: list[Any]) -> int:
    """The number of the segment that a frame is of, by the ``groups`` of what is said of it; 0 where it has numbers."""
    if header.get("SegmentationType") == "LABELMAP":
        return 0
    for group in groups:
        if found := group.get("SegmentIdentificationSequence"):
            return int(found[0].ReferencedSegmentNumber)
    return 0


def numbered(pixels: np.ndarray, segment: int, header: Any) -> np.ndarray:
    """The number of the ``segment`` where a frame has at least half of it, else 0; the numbers of a label map, uint16.

    Pixels of other images stay as they are.
    """
    if not is_segmentation(header):
        return pixels
    if not segment:
        return pixels.astype(np.uint16)
    full = int(header.get("MaximumFractionalValue", 1)) if header.get("SegmentationType") == "FRACTIONAL" else 1
    return np.where(2.0 * pixels >= full, np.uint16(segment), np.uint16(0))


def overlaid(slices: list[Slice]) -> list[Slice]:
    """One slice for all frames at a position, whose places come together."""
    at: dict[tuple[float, ...] | int, Slice] = {}
    for number, each in enumerate(slices):
        position = number if each.position is None else tuple(round(x, 3) for x in each.position)
        known = at.get(position)
        at[position] = each if known is None else replace(known, place=(*known.place, *each.place))
    return list(at.values())
