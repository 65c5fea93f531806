"""Isovalue presets and the first view: isovalues that a scene names, or boundaries between its
materials.

How a scene is seen at first: from where, and how bright. The exposure belongs to the scene:
pictures keep it while camera, light and isovalue move. It is found before any ray is cast, from the
light that the surface would have without shadows, whose brightest parts few shadows reach. Of 66
path-traced pictures, of 20 volumes and under 14 lights, the 98th percentile was 0.58 to 1.09 of the
bare surface's; it was 0.93 to 1.06 in four of five.
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
"""Number of isovalues that are tried, evenly over the core."""

SMOOTHING_BINS = 3.0
"""Standard deviation, in bins, of the Gaussian that evens the curve out."""

SAMPLED_VOXELS = 1 << 21
"""Number of voxels that are sampled, in whole layers."""

MAX_SUGGESTED_PRESETS = 4
"""Most boundaries that are suggested."""

LEAST_AREA = 0.005
"""Least area of a surface over the largest: smaller ones are noise, or hot spots."""

LEAST_FALL = 0.1
"""Least prominence of a peak, over its height."""

PEAK_SHARE = 0.95
"""Share of its height down to which a peak reaches; the middle of that range is suggested."""

RANGE_MARGIN = 0.02
"""Share of the range at either end in which peaks are left out: they are of values that were cut
off.
"""


def find_boundaries(volume: Volume, isovalues: tuple[float, float]) -> tuple[float, ...]:
    """Find at most MAX_SUGGESTED_PRESETS isovalues in a range, ascending, in the volume's units;
    see ``_own_value``.
    """
    total, area = surface_integrals(volume)
    sharpness = smooth(total / np.maximum(area, np.finfo(float).tiny))
    sharpness[smooth(area) < LEAST_AREA * area.max()] = 0.0
    shares = [(peak + 0.5) / TRIED_ISOVALUES for peak in peaks(sharpness)]
    values = {_own_value(volume, share if volume.scale > 0 else 1.0 - share) for share in shares}
    return tuple(sorted(value for value in values if isovalues[0] <= value <= isovalues[1]))


def _own_value(volume: Volume, share: float) -> float:
    """The value at a share of the core, rounded to a power of ten that is at most a hundredth of
    the core.
    """
    low, high = volume.core
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
    """For TRIED_ISOVALUES isovalues in the core: the gradient's integral over the isosurface, and
    the surface's area; (TRIED_ISOVALUES,).

    Both up to a factor that all share, and the area along the axes, 1 to √3 of the true one. An
    edge along an axis stands for the area between it and its neighbours.
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
    total, area = sums.cumsum(axis=1)[:, :TRIED_ISOVALUES]
    return total, area


def _count_edges(
    a: np.ndarray, b: np.ndarray, density: float, span: tuple[float, float], sums: np.ndarray
) -> None:
    """Add to ``sums`` (2, TRIED_ISOVALUES + 1) where the isovalues begin and end that edges from
    ``a`` to ``b`` pass.

    ``density`` is the inverse length of an edge: the area that it stands for, but for a factor that
    all axes share.
    """
    there = (a != b) & (np.abs(a) <= CORE_LIMIT) & (np.abs(b) <= CORE_LIMIT)
    low, high = np.minimum(a[there], b[there]), np.maximum(a[there], b[there])
    scale = TRIED_ISOVALUES / ((span[1] - span[0]) or 1.0)
    gradient = (high - low) * density
    for ends, sign in ((low, density), (high, -density)):
        places = np.clip(np.ceil((ends - span[0]) * scale - 0.5), 0, TRIED_ISOVALUES).astype(
            np.int64
        )
        sums[0] += sign * np.bincount(places, gradient, TRIED_ISOVALUES + 1)
        sums[1] += sign * np.bincount(places, minlength=TRIED_ISOVALUES + 1)


def smooth(curve: np.ndarray) -> np.ndarray:
    """The curve under a Gaussian of SMOOTHING_BINS, its ends carried on."""
    reach = math.ceil(3 * SMOOTHING_BINS)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SMOOTHING_BINS) ** 2)
    return np.convolve(np.pad(curve, reach, "edge"), weights / weights.sum(), "valid")


def peaks(curve: np.ndarray) -> list[float]:
    """The middles of the MAX_SUGGESTED_PRESETS most prominent peaks, or fewer: see LEAST_FALL,
    PEAK_SHARE and RANGE_MARGIN.
    """
    falls = np.array([prominence(curve, at) for at in range(len(curve))])
    found: list[tuple[int, int]] = []
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
    """How far the curve falls on both sides of a place before it rises higher; it is 0 beyond its
    ends.
    """
    return float(curve[at]) - max(
        _saddle(side, curve[at]) for side in (curve[:at][::-1], curve[at + 1 :])
    )


def _saddle(side: np.ndarray, height: float) -> float:
    """The lowest that one goes on a side, from its start, before it is higher than ``height``."""
    higher = np.flatnonzero(side > height)
    if len(higher):
        return float(side[: higher[0]].min(initial=height))
    return 0.0


def _top(curve: np.ndarray, at: int) -> tuple[int, int]:
    """The first and the last place around a peak that are no lower than PEAK_SHARE of it."""
    low = np.flatnonzero(curve < PEAK_SHARE * curve[at])
    return int(low[low < at].max(initial=-1)) + 1, int(low[low > at].min(initial=len(curve))) - 1


MOST_NAMED = 24
"""Most presets that a scene may name: a person finds one among these at a glance."""

MAX_NAME_LENGTH = 40
"""Most characters of a preset's name."""


@dataclass(frozen=True)
class Preset:
    """An isovalue with a name, in the volume's own units; ``suggested`` where the scene does not
    name it.
    """

    name: str
    isovalue: float
    suggested: bool = False


def read_presets(settings: Settings, isovalues: tuple[float, float]) -> tuple[Preset, ...]:
    """Read the scene's own presets, in its order; SceneError where one has no name or lies outside
    ``isovalues``.
    """
    entries = settings.tables("presets", MOST_NAMED)
    presets = tuple(_preset(entry, isovalues) for entry in entries)
    if len({preset.name for preset in presets}) < len(presets):
        raise SceneError("Two presets of the scene have the same name: give each its own.")
    return presets


def suggested_presets(values: tuple[float, ...]) -> tuple[Preset, ...]:
    """Presets that are named by their isovalues."""
    return tuple(Preset(shortest(value), value, suggested=True) for value in values)


def _preset(entry: Mapping[str, Any], isovalues: tuple[float, float]) -> Preset:
    if set(entry) != {"name", "isovalue"}:
        given = ", ".join(sorted(map(str, entry))) or "nothing"
        raise SceneError(
            f"A preset of the scene has {given}: give it name and isovalue, and no more."
        )
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
"""Azimuth and elevation from which a volume is seen that is as wide as it is deep."""

SKEW_AZIMUTHS = (20.0, 70.0)
"""Azimuths between which others are seen: of the longer they are, the more from the side."""

FACE_VIEW = (65.0, 15.0)
"""Azimuth and elevation for a patient, whose face is at azimuth 90."""

ROOM_VIEW = (90.0, 5.0)
"""Azimuth and elevation in a room, from its open side."""

MAX_NORMALS = 4096
"""Normals that stand for a surface, at most."""

BRIGHT_SHARE = 0.98
"""Share of the seen surface that shows its albedo or less."""

MAX_SHOWN_ALBEDO = 0.75
"""Highest albedo that is shown as it is: lighter surfaces are darkened to it, so that their
highlights keep shape.
"""

FALL = 0.5
"""Least brightness that the front counts as having, of that on the brightest side of a ball: no
turn of the camera ends in white.
"""

BALL_DIRECTIONS = pixel_directions(16, 32).reshape(-1, 3)
"""Directions all around, (n, 3)."""


class SeenNormals(NamedTuple):
    """Outward unit ``normals`` (n, 3) of a surface in the volume's box, and how much each is seen
    of, (n,).
    """

    normals: np.ndarray
    weights: np.ndarray


def front_of(volume: Volume, inside: bool) -> tuple[float, float]:
    """The azimuth and the elevation from which a ``volume`` is seen at first: its longer side lies
    across.

    ``inside`` a room it is seen from the open side.
    """
    if inside:
        return ROOM_VIEW
    if volume.orientation.letters:
        return FACE_VIEW
    (_, deep, wide), (x, y, _) = volume.shape, volume.spacing
    azimuth = FRONT[0] - 45.0 + math.degrees(math.atan2(wide * x, deep * y))
    return float(round(min(max(azimuth, SKEW_AZIMUTHS[0]), SKEW_AZIMUTHS[1]))), FRONT[1]


def find_seen(volume: Volume, level: Isovalue, front: tuple[float, float]) -> SeenNormals:
    """The normals of an isosurface that look to the ``front``, weighted by the area that is seen of
    them from there.

    Parts that others hide count, too. A ball stands for a surface that is not there.
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
    weights = np.maximum(normals @ towards, 0.0) / (np.abs(normals) @ np.array(volume.spacing))
    return SeenNormals(normals, weights)


def surface_normals(volume: Volume, level: Isovalue) -> np.ndarray:
    """Outward unit normals (n, 3) of the cells that an isosurface passes, among about
    CELLS_WAITED_FOR cells.
    """
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
    sound = np.isfinite(lengths) & (lengths > 0.0)
    return np.asarray(slopes[sound] / lengths[sound, None])


def exposure_for(light: np.ndarray, albedo: Colour, seen: SeenNormals) -> float:
    """The exposure at which BRIGHT_SHARE of what is ``seen`` shows its ``albedo`` or less, and at
    most MAX_SHOWN_ALBEDO; three digits.

    ``light`` is all that shines on it, as harmonics, linear RGB (3, n²). The exposure is 1 where
    that is nothing.
    """
    if any(albedo):
        tint = np.array(albedo) / max(albedo)
    else:
        tint = np.ones(3)
    front = percentile(brightness(light, tint, seen.normals), seen.weights, BRIGHT_SHARE)
    white = max(front, FALL * float(brightness(light, tint, BALL_DIRECTIONS).max()))
    if white > 0.0:
        return float(f"{MAX_SHOWN_ALBEDO / max(*albedo, MAX_SHOWN_ALBEDO) / white:.3g}")
    return 1.0


def brightness(light: np.ndarray, tint: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The brightest channel of a surface of colour ``tint`` (3,) under a ``light``, without
    shadows: tint · E/π at each of the ``normals`` (n, 3); (n,).
    """
    order = math.isqrt(light.shape[1])
    x, y, z = normals.T
    bands = np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1)
    arriving = (light * bands) @ evaluate_harmonics(
        order, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    )
    return np.asarray((tint[:, None] * arriving).max(axis=0))


def percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The least of ``values`` (n,) that a ``share`` of their ``weights`` (n,) does not exceed."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
