"""Isovalue presets and the first view of a scene: isovalues that it names, or boundaries between
materials in its volume; and the direction and brightness in which it is first seen.

The exposure belongs to the scene: pictures keep it while camera, light and isovalue change. It is
found before any ray is cast, from unshadowed light on the surface, whose brightest parts few
shadows reach. In 66 path-traced pictures of 20 volumes under 14 lights, the 98th percentile of
brightness was 0.58 to 1.09 of that of the unshadowed surface, and 0.93 to 1.06 in four of five.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import Settings, is_number
from isogi_core.files.spelling import shortest
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors
from isogi_core.model.environment import pixel_directions
from isogi_core.model.lights import Colour
from isogi_core.model.view import orbit
from isogi_core.model.volume import CORE_LIMIT, Isovalue, Volume
from isogi_core.plan.bands import evaluate_harmonics
from isogi_core.plan.projection import (
    CELLS_WAITED_FOR,
    edges_between,
    extremes_between,
    slopes_between,
)

TRIED_ISOVALUES = 256
"""Number of isovalues that are tried, evenly spaced over the core."""

SMOOTHING_BINS = 3.0
"""Standard deviation, in bins, of the Gaussian that smooths the curve over isovalues."""

SAMPLED_VOXELS = 1 << 21
"""Number of voxels, about, that are read, in whole layers."""

MAX_SUGGESTED_PRESETS = 4
"""Most boundaries that are suggested."""

LEAST_AREA = 0.005
"""Least area of a surface over the largest one: smaller ones are noise or hot spots."""

LEAST_FALL = 0.1
"""Least prominence of a peak, over its height."""

PEAK_SHARE = 0.95
"""Share of a peak's height down to which it extends; the middle of that range is suggested."""

RANGE_MARGIN = 0.02
"""Share of the range at either end in which peaks are ignored: they come from values that were
clipped.
"""


def find_boundaries(volume: Volume, isovalues: tuple[float, float]) -> tuple[float, ...]:
    """Find at most MAX_SUGGESTED_PRESETS isovalues within ``isovalues``, ascending, in the units of
    the volume's file.

    A boundary between materials is an isovalue at which the mean gradient over the isosurface has a
    peak. Values are rounded by ``_own_value``.
    """
    total, area = surface_integrals(volume)
    # The mean gradient over each surface; surfaces that are too small do not count.
    sharpness = smooth(total / np.maximum(area, np.finfo(float).tiny))
    sharpness[smooth(area) < LEAST_AREA * area.max()] = 0.0
    # Voxels ascend with the file's values only if the scale is positive.
    shares = [(peak + 0.5) / TRIED_ISOVALUES for peak in peaks(sharpness)]
    values = {_own_value(volume, share if volume.scale > 0 else 1.0 - share) for share in shares}
    return tuple(sorted(value for value in values if isovalues[0] <= value <= isovalues[1]))


def _own_value(volume: Volume, share: float) -> float:
    """Return the value of the file at a share of the core, rounded to a power of ten that is at
    most a hundredth of the core's span.
    """
    low, high = volume.core
    # Interpolate without the difference of the ends, which could overflow.
    value = low * (1.0 - share) + high * share
    hundredth = high / 100.0 - low / 100.0
    if hundredth > 0.0:
        step = 10.0 ** math.floor(math.log10(hundredth))
    else:
        step = 0.0
    if step > 0.0:
        return float(f"{round(value / step) * step:.15g}")
    return value


def surface_integrals(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return, for TRIED_ISOVALUES isovalues in the core, the integral of the gradient over the
    isosurface, and the surface's area; (TRIED_ISOVALUES,) each.

    Both are in an unknown unit that all isovalues share, and the area is measured along the axes, 1
    to √3 times the true one. Each edge along an axis that the surface crosses stands for the area
    between it and its neighbours.
    """
    voxels = volume.voxels
    (dx, dy, dz) = volume.spacing
    sums = np.zeros((2, TRIED_ISOVALUES + 1))
    span = volume.core_span()
    for z in range(0, len(voxels) - 1, max(voxels.size // SAMPLED_VOXELS, 1)):
        layer = voxels[z]
        above = voxels[z + 1]
        _count_edges(layer, above, 1.0 / dz, span, sums)
        _count_edges(layer[1:], layer[:-1], 1.0 / dy, span, sums)
        _count_edges(layer[:, 1:], layer[:, :-1], 1.0 / dx, span, sums)
    # Integrate the differences that edges left at both ends of their values.
    total, area = sums.cumsum(axis=1)[:, :TRIED_ISOVALUES]
    return total, area


def _count_edges(
    a: np.ndarray, b: np.ndarray, density: float, span: tuple[float, float], sums: np.ndarray
) -> None:
    """Add the edges from ``a`` to ``b`` to ``sums`` (2, TRIED_ISOVALUES + 1), as differences at the
    first isovalue that each crosses and after the last.

    ``density`` is the inverse length of an edge: in proportion to the area that it stands for.
    """
    # Edges between equal values cross no surface; outliers and holes do not count.
    there = (a != b) & (np.abs(a) <= CORE_LIMIT) & (np.abs(b) <= CORE_LIMIT)
    low, high = np.minimum(a[there], b[there]), np.maximum(a[there], b[there])
    scale = TRIED_ISOVALUES / ((span[1] - span[0]) or 1.0)
    gradient = (high - low) * density
    for ends, sign in ((low, density), (high, -density)):
        # The first isovalue that an edge crosses is the first middle of a bin at or above its end.
        places = np.clip(np.ceil((ends - span[0]) * scale - 0.5), 0, TRIED_ISOVALUES).astype(
            np.int64
        )
        sums[0] += sign * np.bincount(places, gradient, TRIED_ISOVALUES + 1)
        sums[1] += sign * np.bincount(places, minlength=TRIED_ISOVALUES + 1)


def smooth(curve: np.ndarray) -> np.ndarray:
    """Convolve a ``curve`` with a Gaussian of SMOOTHING_BINS; beyond its ends it keeps their
    values.
    """
    reach = math.ceil(3 * SMOOTHING_BINS)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SMOOTHING_BINS) ** 2)
    return np.convolve(np.pad(curve, reach, "edge"), weights / weights.sum(), "valid")


def peaks(curve: np.ndarray) -> list[float]:
    """Return the middles, as places on the ``curve``, of its most prominent peaks, at most
    MAX_SUGGESTED_PRESETS.

    A peak counts if it falls by LEAST_FALL of its height on both sides and does not lie within
    RANGE_MARGIN of either end; it extends down to PEAK_SHARE of its height.
    """
    falls = np.array([prominence(curve, at) for at in range(len(curve))])
    found: list[tuple[int, int]] = []
    # Take places in the order of prominence, unless they belong to a peak that is taken already.
    for at in np.argsort(-falls, kind="stable").tolist():
        taken = any(first <= at <= last for first, last in found)
        if not taken and falls[at] >= LEAST_FALL * curve[at] > 0.0:
            found.append(_top(curve, at))
    middles = [(first + last) / 2 for first, last in found]
    return [
        middle
        for middle in middles
        if RANGE_MARGIN <= (middle + 0.5) / len(curve) <= 1.0 - RANGE_MARGIN
    ][:MAX_SUGGESTED_PRESETS]


def prominence(curve: np.ndarray, at: int) -> float:
    """Return how far the ``curve`` falls on both sides of a place before it rises above it;
    beyond its ends it is 0.
    """
    return float(curve[at]) - max(
        _saddle(side, curve[at]) for side in (curve[:at][::-1], curve[at + 1 :])
    )


def _saddle(side: np.ndarray, height: float) -> float:
    """Return the least value on a ``side``, from its start, before it exceeds ``height``; 0 if
    it never does.
    """
    higher = np.flatnonzero(side > height)
    if len(higher):
        return float(side[: higher[0]].min(initial=height))
    return 0.0


def _top(curve: np.ndarray, at: int) -> tuple[int, int]:
    """Return the first and last place around a peak at which the curve is at least PEAK_SHARE
    of it.
    """
    low = np.flatnonzero(curve < PEAK_SHARE * curve[at])
    return int(low[low < at].max(initial=-1)) + 1, int(low[low > at].min(initial=len(curve))) - 1


MOST_NAMED = 24
"""Most presets that a scene may name: a person finds one among these at a glance."""

MAX_NAME_LENGTH = 40
"""Most characters of a preset's name."""


@dataclass(frozen=True)
class Preset:
    """An isovalue with a name, in the units of the volume's file. It is ``suggested`` if the
    scene does not name it.
    """

    name: str
    isovalue: float
    suggested: bool = False


def read_presets(settings: Settings, isovalues: tuple[float, float]) -> tuple[Preset, ...]:
    """Read the presets that a scene names, in its order. Raises SceneError if one has no name
    or lies outside of ``isovalues``.
    """
    entries = settings.tables("presets", MOST_NAMED)
    presets = tuple(_preset(entry, isovalues) for entry in entries)
    if len({preset.name for preset in presets}) < len(presets):
        raise SceneError("Two presets of the scene have the same name: give them different ones.")
    return presets


def suggested_presets(values: tuple[float, ...]) -> tuple[Preset, ...]:
    """Make presets that are named by their isovalues."""
    return tuple(Preset(shortest(value), value, suggested=True) for value in values)


def _preset(entry: Mapping[str, Any], isovalues: tuple[float, float]) -> Preset:
    """Read one table of presets; raises SceneError as ``read_presets`` does."""
    if set(entry) != {"name", "isovalue"}:
        given = ", ".join(sorted(map(str, entry))) or "nothing"
        raise SceneError(f"A preset of the scene has {given}: give it name and isovalue alone.")
    name = entry["name"]
    isovalue = entry["isovalue"]
    if (
        not isinstance(name, str)
        or not name.strip()
        or len(name) > MAX_NAME_LENGTH
        or not name.isprintable()
    ):
        raise SceneError(
            f"A preset's name is {name!r}: give it a word or a few, {MAX_NAME_LENGTH} "
            "characters at most."
        )
    low, high = isovalues
    if not is_number(isovalue) or not low <= isovalue <= high:
        raise SceneError(
            f"The preset '{name}' has isovalue {isovalue!r}, not a number from "
            f"{shortest(low)} to {shortest(high)}."
        )
    return Preset(name.strip(), float(isovalue))


FRONT = (50.0, 25.0)
"""Azimuth and elevation, degrees, from which a volume is seen that is as wide as it is deep."""

SKEW_AZIMUTHS = (20.0, 70.0)
"""Range of azimuths from which other volumes are seen: the longer they are along one axis, the
more from across it.
"""

FACE_VIEW = (65.0, 15.0)
"""Azimuth and elevation for a patient, whose face is at azimuth 90."""

ROOM_VIEW = (90.0, 5.0)
"""Azimuth and elevation in a room, from its open side."""

MAX_NORMALS = 4096
"""Most normals that stand for a surface."""

BRIGHT_SHARE = 0.98
"""Share of the visible surface that is shown at its albedo or darker."""

MAX_SHOWN_ALBEDO = 0.75
"""Highest albedo that is shown as it is: lighter surfaces are darkened to it, so that their
highlights keep shape.
"""

LEAST_FRONT_SHARE = 0.5
"""Least brightness of the front, over that of the brightest side of a ball, that the exposure
assumes: no turn of the camera ends in white.
"""

BALL_DIRECTIONS = pixel_directions(16, 32).reshape(-1, 3)
"""Directions all around, (n, 3)."""


class SeenNormals(NamedTuple):
    """Outward unit ``normals`` (n, 3) of a surface in the volume's box, with the visible area
    of each, ``weights`` (n,).
    """

    normals: np.ndarray
    weights: np.ndarray


def front_of(volume: Volume, inside: bool) -> tuple[float, float]:
    """Return the azimuth and elevation, degrees, from which a ``volume`` is first seen.

    With ``inside``, it stands in a room, which is seen from its open side. A patient, whose sides
    the volume names by letters, is seen from the front, a little from one side. Anything else is
    seen with its longer side across the picture.
    """
    if inside:
        return ROOM_VIEW
    if volume.orientation.letters:
        return FACE_VIEW
    # The longer the box along x, the more the view is from +y, which has azimuth 90.
    _, deep, wide = volume.shape
    x, y, _ = volume.spacing
    azimuth = FRONT[0] - 45.0 + math.degrees(math.atan2(wide * x, deep * y))
    return float(round(min(max(azimuth, SKEW_AZIMUTHS[0]), SKEW_AZIMUTHS[1]))), FRONT[1]


def find_seen(volume: Volume, level: Isovalue, front: tuple[float, float]) -> SeenNormals:
    """Return the normals of an isosurface that face the ``front``, weighted by their area as seen
    from there.

    Parts that others hide count too. A ball stands in for a surface that does not exist.
    """
    towards = np.array(
        volume.orientation.direction_to_box(orbit((0.0, 0.0, 0.0), 1.0, *front, 1.0, 1.0).eye)
    )
    found = surface_normals(volume, level)
    facing = found[found @ towards > 0.0]
    if len(facing):
        normals = facing[:: max(math.ceil(len(facing) / MAX_NORMALS), 1)]
    else:
        normals = BALL_DIRECTIONS
    # Each cell stands for an area of the surface in proportion to 1 / Σ |n_i| · spacing_i.
    weights = np.maximum(normals @ towards, 0.0) / (np.abs(normals) @ np.array(volume.spacing))
    return SeenNormals(normals, weights)


def surface_normals(volume: Volume, level: Isovalue) -> np.ndarray:
    """Return outward unit normals (n, 3) of the cells that an isosurface passes, among about
    CELLS_WAITED_FOR evenly spread cells.
    """
    # Skip layers and rows alike, so that about CELLS_WAITED_FOR cells are read.
    step = max(math.ceil(math.sqrt(volume.voxels.size / CELLS_WAITED_FOR)), 1)
    found = [np.empty((0, 3))]
    for z in range(0, len(volume.voxels) - 1, step):
        edges = edges_between(volume.voxels[z], volume.voxels[z + 1], step)
        low, high = extremes_between(edges)
        passed = (low <= level) & (level < high)
        found.append(
            -np.stack([slope[passed] for slope in slopes_between(edges, volume.spacing)], axis=1)
        )
    slopes = np.concatenate(found)
    lengths = np.linalg.norm(slopes, axis=1)
    # A gradient of 0, or next to a hole, has no direction.
    sound = np.isfinite(lengths) & (lengths > 0.0)
    return np.asarray(slopes[sound] / lengths[sound, None])


def exposure_for(light: np.ndarray, albedo: Colour, seen: SeenNormals) -> float:
    """Return the exposure at which BRIGHT_SHARE of the surface that is ``seen`` shows its
    ``albedo`` or less, and at most MAX_SHOWN_ALBEDO; rounded to three digits.

    ``light`` is all light that falls on it, as harmonics, linear RGB (3, n²). The exposure is 1 if
    there is no light.
    """
    if any(albedo):
        tint = np.array(albedo) / max(albedo)
    else:
        tint = np.ones(3)
    # White is the brightness of the front at BRIGHT_SHARE, but at least LEAST_FRONT_SHARE of that
    # in the brightest direction.
    front = percentile(brightness(light, tint, seen.normals), seen.weights, BRIGHT_SHARE)
    white = max(front, LEAST_FRONT_SHARE * float(brightness(light, tint, BALL_DIRECTIONS).max()))
    if white > 0.0:
        return float(f"{MAX_SHOWN_ALBEDO / max(*albedo, MAX_SHOWN_ALBEDO) / white:.3g}")
    return 1.0


def brightness(light: np.ndarray, tint: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the brightest channel of a surface of colour ``tint`` (3,) under a ``light``
    without shadows, tint · E/π at each of the ``normals`` (n, 3); (n,).
    """
    order = math.isqrt(light.shape[1])
    x, y, z = normals.T
    bands = np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1)
    arriving = (light * bands) @ evaluate_harmonics(
        order, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    )
    return np.asarray((tint[:, None] * arriving).max(axis=0))


def percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return the least of ``values`` (n,) up to which they hold a ``share`` of all ``weights``
    (n,).
    """
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
