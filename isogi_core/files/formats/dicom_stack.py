"""Stacks of slices: their order along the normal, what is missing, doubled or uneven, and where they lie."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.packing import Packing

EVEN_STEP_SHARE = 0.05
"""Largest part of the usual step by which a step between slices may stray and still be even."""

MAX_LAYERS_PER_SLICE = 8
"""Most times as many layers as slices, where these are uneven."""

Layers = tuple[tuple[tuple[Any, float, Packing], ...], ...]


@dataclass(frozen=True)
class Slice:
    """One slice: the ``place`` of its pixels, its ``uid`` and its ``number``, and how it lies, as far as is known.

    ``position`` is that of its first pixel, ``pose`` the directions of rows and columns, ``pixel`` the step along each
    and ``between`` that to the next slice, millimetres of a patient's left, posterior, superior.
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
    """Layers from first to last: each is mixed of slices by weights, or of none where a slice is missing.

    ``affine`` (3, 4) brings voxel indices to the patient's left, posterior, superior, None where that is unknown;
    ``measured`` says whether the file gives lengths. ``between`` tells that some layer is no slice itself.
    """

    layers: Layers
    affine: np.ndarray | None
    spacing: tuple[float, float, float]
    measured: bool
    between: bool


Pick = Callable[[int, str], int]
"""Chooses one of so many fields, which are named for a person."""


def stack_of(name: str, slices: list[Slice], pick: Pick, sparse: bool = False) -> tuple[Stack, tuple[str, ...]]:
    """The stack of ``slices`` in any order, with notes on what was mended. Raises VolumeError for what cannot be.

    Of ``sparse`` ones some are left out as nothing is in them, and none is mixed of two.
    """
    distinct = list({each.uid: each for each in slices}.values())
    doubled = len(slices) - len(distinct)
    notes = [f"{doubled} doubled slices were left out."] if doubled else []
    if any(each.position is None or each.pose is None for each in distinct):
        ordered = sorted(distinct, key=lambda each: each.number)
        notes.append("The slices do not say where they lie: they are in the order of their numbers.")
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
    normal = np.cross(pose[:3], pose[3:]) if pose.shape == (6,) else np.zeros(3)
    if not np.linalg.norm(normal) > 0.5:
        raise VolumeError(f"The slices of '{name}' have no orientation that can be: write them again.")
    return np.asarray(normal / np.linalg.norm(normal))


def _one_time(name: str, slices: list[Slice], heights: np.ndarray, pick: Pick) -> tuple[list[Slice], np.ndarray]:
    """The slices of one time step in the order of their heights: where each place has several, one is chosen."""
    order = sorted(range(len(slices)), key=lambda n: (round(float(heights[n]), 3), slices[n].number))
    places, counts = np.unique(np.round(heights, 3), return_counts=True)
    if len(set(counts.tolist())) > 1 and counts.max() > 1:
        raise VolumeError(
            f"'{name}' has {len(slices)} slices at {len(places)} places, some doubled: leave the odd ones out."
        )
    times = int(counts[0])
    chosen = order[pick(times, "slices at each place") :: times]
    return [slices[n] for n in chosen], heights[chosen]


def _placed(
    name: str, slices: list[Slice], heights: np.ndarray, notes: list[str], sparse: bool
) -> tuple[Stack, tuple[str, ...]]:
    """The stack of slices in order, with layers where steps are even, and mixed ones where they are not."""
    first, last = slices[0], slices[-1]
    steps = np.diff(heights)
    given = first.between if sparse or not len(steps) else None
    usual = given or (float(np.median(steps)) if len(steps) else 1.0)
    whole = np.round(steps / usual)
    if np.all(np.abs(steps - usual * whole) <= EVEN_STEP_SHARE * usual) and np.all(whole >= 1):
        layers = _with_gaps(slices, whole.astype(int))
        missing = len(layers) - len(slices)
        if missing and not sparse:
            notes.append(f"{missing} of {len(layers)} slices are missing: there are holes in their place.")
    elif sparse:
        raise VolumeError(f"The slices of the segmentation '{name}' are unevenly spaced: save it in even ones.")
    else:
        usual = float(steps.min())
        count = round(float(heights[-1] - heights[0]) / usual) + 1
        if count > MAX_LAYERS_PER_SLICE * len(slices):
            raise VolumeError(f"The slices of '{name}' lie from {usual:.3g} to {steps.max():.3g} apart: resample them.")
        usual = float(heights[-1] - heights[0]) / (count - 1)
        layers = _mixed(slices, heights, heights[0] + usual * np.arange(count))
        notes.append(f"The slices are unevenly spaced: layers {usual:.4g} apart were interpolated, linearly.")
    return _stack(layers, first, last, usual, len(layers)), tuple(notes)


def _with_gaps(slices: list[Slice], steps: np.ndarray) -> Layers:
    """A layer for each slice, and empty ones where a step is of several."""
    layers: list[tuple[tuple[Any, float, Packing], ...]] = [((slices[0].place, 1.0, slices[0].packing),)]
    for each, step in zip(slices[1:], steps.tolist(), strict=True):
        layers += [()] * (step - 1)
        layers.append(((each.place, 1.0, each.packing),))
    return tuple(layers)


def _mixed(slices: list[Slice], heights: np.ndarray, at: np.ndarray) -> Layers:
    """Layers ``at`` even heights, each of the two slices around it."""
    layers = []
    for height in at:
        n = int(np.clip(np.searchsorted(heights, height, "right") - 1, 0, len(slices) - 2))
        share = float(np.clip((height - heights[n]) / (heights[n + 1] - heights[n]), 0.0, 1.0))
        pair = ((slices[n], 1.0 - share), (slices[n + 1], share))
        layers.append(tuple((each.place, weight, each.packing) for each, weight in pair if weight > 1e-6))
    return tuple(layers)


def _stack(layers: Layers, first: Slice, last: Slice, usual: float, count: int) -> Stack:
    """The stack with its affine: the step between layers follows the slices' positions, tilted or not."""
    x, y = first.pixel or (1.0, 1.0)
    pose, origin = np.array(first.pose), np.array(first.position)
    along = (np.array(last.position) - origin) / (count - 1) if count > 1 else np.cross(pose[:3], pose[3:]) * usual
    affine = np.column_stack([pose[:3] * x, pose[3:] * y, along, origin])
    mixed = any(len(layer) != 1 for layer in layers)
    return Stack(layers, affine, (x, y, float(np.linalg.norm(along))), True, mixed)
