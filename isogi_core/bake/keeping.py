"""Light that a cut leaves as it is: of texels no path of which met what is taken away.

All their paths meet the same points as before, so that their sums, and all that is kept of these, have the same bits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.precision import next_level
from isogi_core.bake.refine import Place, by_isovalue, locate
from isogi_core.bake.texel_light import Light, Part
from isogi_core.kernels.transport.paths import SampleRange
from isogi_core.kernels.transport.strays import Confines, find_strays
from isogi_core.model.volume import Volume
from isogi_core.plan.volumes.cuts import CUT_AWAY_VALUE, Ranges, box_left, is_within, values_beyond

KEEPABLE_KINDS = frozenset(("direct", "indirect", "whole"))
"""The kinds of layers whose light a cut may leave as it is: their paths meet one surface, and nothing else."""


def keeps(spec: BakeSpec) -> bool:
    """Whether light of a ``spec`` of a whole volume may stay where that is cut."""
    return spec.shown is None and spec.kinds <= KEEPABLE_KINDS and bool(spec.prepared.field.low.min() >= CUT_AWAY_VALUE)


@dataclass(frozen=True, eq=False)
class Remains:
    """What a cut leaves: the ``box`` of ``box_left``, and the least and the greatest value ``beyond`` it."""

    box: np.ndarray
    beyond: tuple[float, float]

    @classmethod
    def of(cls, volume: Volume, left: Ranges) -> Self:
        """What is left where of a ``volume`` some voxels are."""
        box = box_left(left, volume.size)
        return cls(box, values_beyond(volume, box))


def find_kept(light: Light, texels: np.ndarray, whole: BakeSpec, remains: Remains, walks: bool) -> np.ndarray:
    """Which of the ``texels`` (m, 3; z, y, x) keep their ``light`` where a cut of a ``whole`` volume ``remains``.

    (m,) bool: those whose place, and all points that paths met so far, are far from what is taken away. Where nothing
    of their isosurface is there, no path can have met it. Paths of others are walked once more, but those of a texel
    end with the first that met something there. Without ``walks`` these are left out.
    """
    prepared, box = whole.prepared, remains.box
    place, _ = locate(texels, prepared)
    kept = is_within(texels[:, ::-1] * prepared.step, box) & is_within(place[1].T, box)
    may_stray = (place[3] >= remains.beyond[0]) & (place[3] <= remains.beyond[1])
    if not walks:
        return kept & ~may_stray
    for some, samples, bounces in walks_of(light.parts, whole.plan.bounces):
        rows = kept & some & may_stray & ~light.void
        confines = Confines(bounces, whole.plan.survival, whole.plan.branches, box)
        kept &= ~strays_of(place, rows, whole, samples, confines)
    return kept


def walks_of(parts: Sequence[Part], bounces: int) -> Iterator[tuple[np.ndarray, SampleRange, int]]:
    """The paths that some ``parts`` took: which texels (m,) bool, their samples in each half, and their bounces.

    Those of parts without reflected light end with their first ray.
    """
    first, most = 0, max((int(part.samples.max(initial=0)) for part in parts), default=0)
    while first < most:
        last = next_level(first)
        some = SampleRange(first // 2, (last - first) // 2)
        long, short = (took(parts, last, reflected) for reflected in (True, False))
        yield long, some, bounces
        yield short & ~long, some, 0
        first = last


def took(parts: Sequence[Part], samples: int, reflected: bool) -> np.ndarray:
    """Which texels took so many ``samples`` in any of the parts with ``reflected`` light, or without; (m,) bool."""
    own = [part.samples >= samples for part in parts if part.layer.reflected == reflected]
    return np.logical_or.reduce([np.zeros(len(parts[0].samples), np.bool_), *own])


def strays_of(place: Place, rows: np.ndarray, spec: BakeSpec, samples: SampleRange, confines: Confines) -> np.ndarray:
    """Which of some ``rows`` (m,) bool have a path among these ``samples`` that met something beyond ``confines``."""
    strays = np.zeros(len(rows), np.bool_)
    for cells, own in by_isovalue(place[3], ~rows, spec.prepared):
        find_strays(spec.prepared.field, cells, place, own, samples, confines, strays)
    return strays
