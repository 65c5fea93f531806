"""Cases of extreme values: what is left of them once they are normalised, and how far one outlier reaches."""

from fractions import Fraction

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import hits_of
from benchmarks.stability.range_volumes import GROUP, SIDE, soft, spoiled
from benchmarks.stability.specimen import SPECIMENS, volumes
from benchmarks.stability.stage import scene_of, view_of
from isogi_core.bake.maps import Maps
from isogi_core.errors import VolumeError
from isogi_core.model.volume import CORE, Volume, make_volume

HOT = (SIDE // 2 - 2, SIDE // 2, SIDE - 8)
"""A voxel (z, y, x) at the body's skin, in sight."""

REACH = 2.0
"""Voxels from a spoiled one within which the cells lie that have it as a corner."""


@case(GROUP, "digits", "values keep 24 bits of their range, whatever offset and outliers", 2.0**-24, "of the range")
def digits(size: Size) -> Outcome:
    """Compare voxels with the values that they are of, in exact fractions."""
    worst, of = 0.0, ""
    for each in volumes(GROUP):
        array = each.make()
        volume = make_volume(array, each.spacing)
        few = np.random.default_rng(1).choice(volume.voxels.size, size.pick(100, 3000))
        error = worst_digit(array.ravel()[few], volume.voxels.ravel()[few], volume)
        if error > worst:
            worst, of = error, f"of {volume.value_range[0]:g} to {volume.value_range[1]:g}"
    return Outcome(worst, of)


def worst_digit(values: np.ndarray, voxels: np.ndarray, volume: Volume) -> float:
    """The largest difference of voxels in the core and their values, relative to the core."""
    offset, scale = Fraction(volume.offset), Fraction(volume.scale)
    span = Fraction(volume.core[1]) - Fraction(volume.core[0]) or Fraction(1)
    inner = np.isfinite(voxels) & (np.abs(voxels) <= CORE)
    pairs = zip(values[inner].tolist(), voxels[inner].tolist(), strict=True)
    errors = [abs(offset + scale * Fraction(voxel) - Fraction(value)) / span for value, voxel in pairs]
    return float(max(errors, default=Fraction(0)))


@case(
    GROUP,
    "steps",
    "a volume tells how many steps its type has over its range: where these are few, a user is told",
    0.5,
    "steps",
)
def steps(size: Size) -> Outcome:
    """Compare with the bits of values around 1e9, of which a range of 256 has from 4 on."""
    worst, told = 0.0, []
    for dtype, bits in ((np.float32, np.int32), (np.float64, np.int64), (np.int64, np.int64)):
        array = (1e9 + 256 * soft()).astype(dtype)
        volume = make_volume(array)
        told.append(volume.steps)
        worst = max(worst, abs(volume.steps - float(np.ptp(array.view(bits)))))
    return Outcome(worst, f"float32 {told[0]:.3g}, float64 {told[1]:.3g}, int64 {told[2]:.3g}")


@case(GROUP, "refusals", "what is no volume is refused in a sentence that says why", 0, "volumes")
def refusals(size: Size) -> Outcome:
    """Count specimens that should be refused and are not, or in other words."""
    poor = [each for each in SPECIMENS.values() if each.refused]
    wrong = 0
    for each in poor:
        try:
            make_volume(each.make(), each.spacing)
            wrong += 1
        except VolumeError as error:
            wrong += each.refused not in str(error) or not str(error).endswith(".")
    return Outcome(wrong, f"of {len(poor)}")


@case(GROUP, "one voxel", "a voxel of any value changes no hit outside the eight cells around it", 0, "pixels")
def one_voxel(size: Size) -> Outcome:
    """Spoil a voxel in sight, and count pixels that see something else and not near it."""
    plain, wrong, seen = scene_of(make_volume(soft()), 0.5), 0, 0
    view = view_of(plain, size.pick(128, 512), azimuth=0.0, elevation=0.0)
    before = hits_of(plain, view)
    for value in (1e30, -1e30, 1e300, -9999.0, np.nan, np.inf, -np.inf):
        field = soft()
        field[HOT] = value
        after = hits_of(scene_of(make_volume(field), 0.5), view)
        other = (before != after).any(axis=2)
        near = [np.abs(hits - HOT[::-1]).max(axis=2) <= REACH for hits in (before, after)]
        wrong, seen = wrong + int((other & ~near[0] & ~near[1]).sum()), seen + int(other.sum())
    return Outcome(wrong, f"of {seen} that see the voxel")


@case(GROUP, "missing values", "what a scene says is missing is a hole, to the bit", 0, "voxels")
def missing(size: Size) -> Outcome:
    """Compare marks that were told with NaN in the same places."""
    wrong = 0
    for mark in (-9999.0, -1e34, 1e30, 0.25):
        told = make_volume(spoiled(0.3, mark), missing=[mark]).voxels
        wrong += int((told.view(np.uint32) != make_volume(spoiled(0.3, np.nan)).voxels.view(np.uint32)).sum())
    return Outcome(wrong, f"of {4 * told.size}")


@case(
    GROUP,
    "maps of squeezed values",
    "a map marks no more than twice the cells of an isovalue where one voxel is as hot as 1e30",
    2,
    "×",
)
def squeezed(size: Size) -> Outcome:
    """Cells that the map of one isovalue marks, over those that it marks where no voxel is hot."""
    field = soft(size.pick(SIDE, 96))
    cells = marked_cells(field)
    worst = 0.0
    for value in (100.0, 1000.0, 1e6, 1e30):
        field[0, 0, 0] = value
        worst = max(worst, marked_cells(field) / cells)
    return Outcome(worst, f"of {cells} cells")


def marked_cells(field: np.ndarray) -> int:
    """Cells that the map of isovalue 0.5 marks."""
    volume = make_volume(field)
    level = volume.normalise_isovalue(0.5)
    words = Maps(volume.voxels).get(level, level).cells & 0xFFFF
    return int(np.bitwise_count(words).sum())
