"""The surfaces of a scene: what they reflect, let through and shine with, as its file says.

Albedos that reflected light is kept for, and the mixing of light of any other albedo from these.
Light that arrives at a texel after k bounces, Σ R^k τ_k, is a curve of the albedo R. It is kept at
a few nodes R_j, of the same paths, and mixed: Σ v_j(R) Σ R_j^k τ_k. If all hits were alike, with a
chance f to leave at each, then τ_k = f (1 - f)^k. The weights v fit such light best for all
chances, and so for all mixtures of them. At a node its own weight is 1 and the others are 0; all
are 0 where nothing is reflected.

That takes fewer numbers than light after each bounce, and fewer than a polynomial through the
nodes. On texels of the engine, the CT head, the MNI brain, the carp, the bonsai and the casting,
and of paths of 43 bounces, three nodes up to albedo 0.9 err by 0.24 to 0.40 % of all light, a root
mean square at the worst albedo, where 0.42 % is estimated; cubic polynomials through three nodes of
Chebyshev's and 0 by 0.6 to 2.9 %.

Levels of a range: isovalues between which light is mixed on surfaces that are pinned beside the one
that slides. Between two levels the surface that slides moves by LEVEL_VOXELS on the average: what
it shades then changes no faster than the lattice holds. As the isovalue grows by dc the surface
moves by dc / |∇f|: summed over the range, that says how many levels there are. Source: Beason et
al. 2006 (S3) mix light of walls between levels; the measure is ours.
"""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.scene_file import MATERIAL_NUMBERS, MaterialSettings, Settings
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.lights import LARGEST_LIGHT, Colour, Lamp, Light
from isogi_core.model.material import (
    DIFFUSE,
    INDICES,
    MATERIALS,
    OPAQUE,
    WINDOW_GLASS,
    Material,
    PinnedSurface,
    Shine,
    leaving,
    pinned_surfaces,
    refuse_gain,
    shine_from_mapping,
)
from isogi_core.model.scene_plan import LeftOut, Saving
from isogi_core.model.volume import Volume
from isogi_core.plan.inputs import PlanOverrides
from isogi_core.plan.projection import RANGE_BINS, edges_between, extremes_between

DEFAULT_FREE_PATH = 0.02
"""The mean free path of a subsurface that gives none, over the radius of its volume."""

EXCLUDED_SETTINGS = {
    "glass": {"albedo": "it reflects no diffuse light"}
    | dict.fromkeys(("clear", "transmission"), "it lets light pass by its index already"),
    "subsurface": dict.fromkeys(("clear", "transmission"), "it lets light in already"),
}
"""What a scene of one of these cannot have, and why."""

BESIDE_BOTH = {
    "albedos": "its light is baked for one colour",
    "shine": "it shines by no lobe",
    "glow": "glow is not seen through it",
    "surfaces": "it lies alone",
    "volumes": "it has one colour",
    "labels": "it has one colour",
}
"""What no scene can have whose surface rays pass, and why."""

MIN_SUBSURFACE_ALBEDO = 0.01
"""Least albedo of a subsurface: what its texels keep is over that."""


def read_material(settings: Settings, volume: Volume) -> Material:
    """What the scene's surface is made of. SceneError where a value has no meaning, or the scene
    has what it cannot.
    """
    kind = settings.choice("material", MATERIALS) or MATERIALS[0]
    given = settings.source.document
    index = settings.number("index", WINDOW_GLASS, *INDICES)
    absorption = _material_colour(settings, "absorption")
    path = settings.number("mean_free_path", DEFAULT_FREE_PATH * volume.radius, 0.0, LARGEST_LIGHT)
    for key, of in MATERIAL_NUMBERS.items():
        if key in given and of != kind:
            raise SceneError(
                f'{key} is of {of}: add material = "{of}" to the scene, or leave {key} out.'
            )
    if kind == "diffuse":
        return DIFFUSE
    for key, why in (BESIDE_BOTH | EXCLUDED_SETTINGS[kind]).items():
        if key in given:
            raise SceneError(f"The surface is {kind}, and {why}: leave {key} out.")
    if kind == "glass":
        return Material(kind, index, absorption)
    if min(settings.colour("albedo", 0.7)) < MIN_SUBSURFACE_ALBEDO:
        raise SceneError(
            "The albedo of a subsurface is what scattering leaves: "
            f"give {MIN_SUBSURFACE_ALBEDO:g} or more of each colour."
        )
    return Material(kind, mean_free_path=path)


def material_settings(material: Material) -> MaterialSettings:
    """The settings of a scene whose surface is of this ``material``, with all of its numbers."""
    given = {
        name: getattr(material, name)
        for name, kind in MATERIAL_NUMBERS.items()
        if kind == material.kind
    }
    if "absorption" in given and len({*given["absorption"]}) == 1:
        given["absorption"] = given["absorption"][0]
    return {"material": material.kind, **given}


def refuse_lamps(material: Material, lights: tuple[Light, ...]) -> None:
    """Raise SceneError where there are lamps that light inside a surface of this ``material``
    cannot meet.
    """
    if material.scatters and any(isinstance(light, Lamp) for light in lights):
        raise SceneError(
            "Lamps do not reach inside a subsurface: make them walls with radiance, or an "
            "environment."
        )


def _material_colour(settings: Settings, key: str) -> Colour:
    """A number for all three channels, or three; 0 where it is left out."""
    given = tuple(float(value) for value in settings.listed(key)) or (0.0,)
    if len(given) not in (1, 3):
        raise SceneError(
            f"{key} in the scene '{settings.source.name}' has {len(given)} numbers: give one, "
            "or three."
        )
    red, green, blue = given * 3 if len(given) == 1 else given
    return red, green, blue


def unrefracted(material: Material, lights: tuple[Light, ...], sharp: bool) -> tuple[LeftOut, ...]:
    """What a surface of this ``material`` leaves out: texels, and caustics of lamps that no ray can
    meet.

    The environment may be ``sharp``: a sun or another bright part of it is met by few rays.
    """
    if not material.refracts:
        return ()
    texels = "Glass has no light of its own: what is seen through it is on the walls, or outside."
    found = [LeftOut("texels of the isosurface", texels, (Saving(100, "percent of all texels"),))]
    names = sorted({light.name for light in lights if isinstance(light, Lamp)})
    if names:
        why = (
            "No ray that is refracted meets it, so that glass casts a shadow: make it a wall "
            "with radiance."
        )
        found.append(LeftOut(f"caustics of the light '{', '.join(names)}'", why))
    if sharp:
        why = (
            "Few rays that are refracted meet its bright parts: their caustics stay noisy for long."
        )
        found.append(LeftOut("a smooth caustic of the environment", why))
    return tuple(found)


BARE_ALBEDOS = (0.0, 1.0)
"""The albedos that views may ask for where nothing is reflected."""


@dataclass(frozen=True, eq=False)
class SceneSurfaces:
    """The surface that slides, and others that are ``pinned``.

    ``albedo`` is linear RGB. ``albedos`` are the least and the most that views may ask for in its
    place; None where light is baked for ``albedo`` alone. ``colours`` are those of the surface by
    data, None where it has the one ``albedo``; that is then their brightest. ``shine`` is None
    where the surface is diffuse, and views may then ask for none. The share ``clear`` of rays
    passes straight through the surface that slides, and of the light that falls on one side of it
    its ``transmission``, linear RGB, leaves the other, diffuse.
    """

    albedo: Colour
    albedos: tuple[float, float] | None = None
    colours: SurfaceColours | None = None
    shine: Shine | None = None
    material: Material = DIFFUSE
    pinned: tuple[PinnedSurface, ...] = ()
    clear: float = 0.0
    transmission: Colour = OPAQUE

    @property
    def several(self) -> bool:
        """Whether light may meet more than one side of one surface: there are others, or some gets
        through this one.
        """
        return bool(self.pinned) or self.clear > 0.0 or any(self.transmission)

    @property
    def passed(self) -> bool:
        """Whether light passes surfaces, or enters one: it is then baked as it falls."""
        return self.several or self.material.scatters

    @property
    def transmits(self) -> bool:
        """Whether light gets through any of the surfaces, diffuse."""
        return any(self.transmission) or any(any(each.transmission) for each in self.pinned)

    @property
    def lowest(self) -> float:
        """The lowest albedo of any channel that views may ask for."""
        if self.albedos is None:
            return min(self.albedo)
        return self.albedos[0]

    @property
    def met(self) -> tuple[Colour, ...]:
        """The albedos that paths meet beside the one of a surface that lies alone."""
        pinned = (share for each in self.pinned for share in (each.albedo, each.leaving))
        if self.passed:
            return (*pinned, self.albedo)
        return tuple(pinned)

    @property
    def company(self) -> list[Any]:
        """What digests hold of surfaces beside each other; nothing where there is one, and no light
        gets through.
        """
        others = sorted(each.facts for each in self.pinned)
        if any(self.transmission):
            through = ["transmission", *self.transmission]
        else:
            through = []
        if self.several:
            return ["surfaces", others, self.clear, *through]
        return []

    @property
    def matter(self) -> list[Any]:
        """What digests hold of the surface's material; nothing where it is diffuse."""
        material = self.material
        facts = material.kind, material.index, *material.absorption
        if material == DIFFUSE:
            return []
        return ["material", *facts, 1.0 / material.mean_free_path]

    @property
    def by_data(self) -> list[Any]:
        """What digests hold of the surface's colours; nothing where there are none."""
        if self.colours is None:
            return []
        return ["colours", self.colours.digest]

    def albedo_for(self, asked: Colour | None) -> Colour:
        """The albedo that a view has ``asked`` for, else the scene's own. ViewError where no light
        is baked for it.
        """
        if asked is not None and self.colours is not None:
            raise ViewError(
                f"The surface has its albedo from '{self.colours.scale.name}' in this scene: "
                "leave it out."
            )
        if asked is not None and asked != self.albedo and self.several:
            raise ViewError(
                "Surfaces light each other in this scene: its albedos are fixed, leave albedo out."
            )
        if asked is None or asked == self.albedo:
            return self.albedo
        if self.albedos is None:
            raise ViewError(
                "albedo is fixed in this scene: leave it out, or give the scene a range, "
                "albedos = [0, 0.9]."
            )
        lowest, highest = self.albedos
        if not all(lowest <= share <= highest for share in asked):
            given = ",".join(f"{share:g}" for share in asked)
            raise ViewError(
                f"albedo must be from {lowest:g} to {highest:g} in this scene, not {given}."
            )
        return asked

    def leaving_for(self, asked: Colour | None) -> Colour:
        """What counts of texels' light in a view that has ``asked`` for an albedo. ViewError as
        ``albedo_for``.
        """
        return leaving(self.albedo_for(asked), self.transmission)

    def shine_for(self, asked: Shine | None) -> Shine | None:
        """The shine that a view has ``asked`` for, else the scene's own; None where nothing shines.

        ViewError where views of this scene may not ask for any.
        """
        shine = asked or self.shine
        if shine is None or shine.strength == 0.0:
            return None
        if self.shine is None:
            raise ViewError(
                "This scene's surface is diffuse: give the scene a [shine] table, or leave "
                "shine out."
            )
        if self.colours is not None and shine.kind == "metal":
            raise ViewError(
                "Metal mirrors one albedo, and this surface has colours: choose plastic."
            )
        return shine


def read_surfaces(
    settings: Settings, volume: Volume, colours: SurfaceColours | None, overrides: PlanOverrides
) -> SceneSurfaces:
    """The scene's surfaces. SceneError where a value has no meaning, or the scene has what cannot
    go together.
    """
    albedo = read_albedo(settings, colours)
    return SceneSurfaces(
        albedo,
        material=read_material(settings, volume),
        albedos=choosable(albedo, colours, overrides),
        colours=colours,
        shine=read_shine(settings, colours),
        pinned=read_pinned(settings, volume, colours),
        clear=read_clear(settings, colours),
        transmission=read_transmission(settings, albedo, colours),
    )


def read_albedo(settings: Settings, colours: SurfaceColours | None) -> Colour:
    """The albedo of the surface; the most that ``colours`` reflect where it has these. SceneError
    where both are given, or a range of albedos.
    """
    if colours is None:
        return settings.colour("albedo", 0.7)
    for key in ("albedo", "albedos"):
        if key in settings.source.document:
            raise SceneError(
                f"The surface has its albedo from '{colours.scale.name}': leave out {key}."
            )
    return colours.brightest


def choosable(
    albedo: Colour, colours: SurfaceColours | None, overrides: PlanOverrides
) -> tuple[float, float] | None:
    """The range of albedos that views may ask for; None where light is baked for one. SceneError
    where the scene's own ``albedo`` is not in it.
    """
    albedos = overrides.albedos
    if albedos is None:
        if overrides.bounces == 0 and max(albedo) > 0.0 and colours is None:
            return BARE_ALBEDOS
        return None
    if not albedos[0] <= min(albedo) <= max(albedo) <= albedos[1]:
        given = f"albedos = [{albedos[0]:g}, {albedos[1]:g}]"
        raise SceneError(
            f"{given} leaves out the scene's own albedo, {min(albedo):g} to {max(albedo):g}: "
            "widen it."
        )
    return albedos


def read_shine(settings: Settings, colours: SurfaceColours | None) -> Shine | None:
    """The scene's shine; None where its surface is diffuse. SceneError where it has no meaning, or
    none with ``colours``.
    """
    table = settings.table("shine")
    if table is None:
        shine = None
    else:
        shine = shine_from_mapping(table)
    if shine is not None and shine.kind == "metal" and colours is not None:
        raise SceneError("Metal mirrors one albedo, and this surface has colours: choose plastic.")
    return shine


def read_pinned(
    settings: Settings, volume: Volume, colours: SurfaceColours | None
) -> tuple[PinnedSurface, ...]:
    """The scene's [[surfaces]]. SceneError where one has no meaning, or the scene cannot have
    any.
    """
    found = pinned_surfaces(settings.tables("surfaces"), volume)
    if found:
        refuse_company(settings, colours, "[[surfaces]]")
    return found


def read_clear(settings: Settings, colours: SurfaceColours | None) -> float:
    """The share of rays that passes the surface which slides. SceneError as ``read_pinned``."""
    clear = settings.number("clear", 0.0, 0.0, 1.0)
    if clear > 0.0:
        refuse_company(settings, colours, "clear")
    return clear


def read_transmission(settings: Settings, albedo: Colour, colours: SurfaceColours | None) -> Colour:
    """The share of light that gets through the surface which slides, of this ``albedo``, diffuse,
    linear RGB.

    SceneError as ``read_pinned``, and where more light would leave than falls on it.
    """
    transmission = settings.colour("transmission", 0.0)
    if any(transmission):
        refuse_company(settings, colours, "transmission")
        refuse_gain(albedo, transmission, f"The surface of the scene '{settings.source.name}'")
    return transmission


def refuse_company(settings: Settings, colours: SurfaceColours | None, what: str) -> None:
    """Raise SceneError where the scene has what several surfaces are not lit with yet."""
    beside = {"colours by data": colours is not None}
    beside |= {"a shine": settings.table("shine") is not None}
    beside |= {"albedos that views choose": settings.span("albedos", 0.0, 1.0) is not None}
    for each, there in beside.items():
        if there:
            raise SceneError(
                f"The scene '{settings.source.name}' has {what} and {each}: leave one of them out."
            )


MAX_NODES = 6
"""Most nodes."""

ESCAPE_CHANCES = np.geomspace(1e-3, 0.98, 96)
"""Chances f to leave at each hit that the weights are fitted to: from deep cavities to nearly open
places.
"""

EVALUATED_ALBEDOS = 48
"""Albedos at which the error is evaluated."""


@cache
def choose_nodes(most: float, bounces: int, allowed: float) -> tuple[float, ...]:
    """Choose the fewest nodes up to an albedo ``most`` at which paths of ``bounces`` have the
    ``allowed`` error.

    The error is relative to all light of a texel. Where it is never reached, MAX_NODES nodes.
    """
    tries = (spread_nodes(count, most, bounces) for count in range(1, MAX_NODES + 1))
    return next(
        (nodes for nodes in tries if mixing_error(nodes, bounces) <= allowed),
        spread_nodes(MAX_NODES, most, bounces),
    )


def spread_nodes(count: int, most: float, bounces: int) -> tuple[float, ...]:
    """``count`` nodes up to ``most``, even in the logarithm of 1 - R, as light of deep cavities
    varies.

    Where paths are short the last nodes are farther from 1.
    """
    depth = min(most, 1.0 - 1.0 / (bounces + 1))
    steps = np.arange(1, count + 1) / count
    return tuple((most * (1.0 - (1.0 - depth) ** steps) / depth).tolist())


@cache
def mixing_error(nodes: tuple[float, ...], bounces: int) -> float:
    """The largest error of light mixed from ``nodes``, over all light of a texel, at any lower
    albedo.
    """
    kept = reflected_light(np.array(nodes), bounces)
    albedos = nodes[-1] * np.arange(1, EVALUATED_ALBEDOS) / EVALUATED_ALBEDOS
    light = reflected_light(albedos, bounces)
    mixed = kept @ np.array([mixing_weights(albedo, nodes, bounces) for albedo in albedos]).T
    return float((np.abs(mixed - light) / (ESCAPE_CHANCES[:, None] + light)).max())


@cache
def mixing_weights(albedo: float, nodes: tuple[float, ...], bounces: int) -> np.ndarray:
    """The weights v_j(R) of the light kept at each of the ``nodes`` at an ``albedo``; (nodes,)
    float64.
    """
    kept = reflected_light(np.array(nodes), bounces)
    light = reflected_light(np.array([albedo]), bounces)
    whole = ESCAPE_CHANCES[:, None] + light
    weights = np.linalg.lstsq(kept / whole, (light / whole)[:, 0], rcond=None)[0]
    weights.flags.writeable = False
    return np.asarray(weights)


def reflected_light(albedos: np.ndarray, bounces: int) -> np.ndarray:
    """Σ R^k f (1 - f)^k over k = 1 … ``bounces``, for each of ESCAPE_CHANCES and each of
    ``albedos``; (chances, albedos).
    """
    ratio = albedos * (1.0 - ESCAPE_CHANCES)[:, None]
    return np.asarray(ESCAPE_CHANCES[:, None] * ratio * (1.0 - ratio**bounces) / (1.0 - ratio))


LEVEL_VOXELS = 1.0
"""How far a surface moves from one level to the next, in voxels on the average."""

MAX_READ_VOXELS = 1 << 26
"""Voxels that are read of a volume, about: of a larger one every so manyth layer."""

CELLS_PER_VOXEL = 1.5
"""Cells that a surface meets for each voxel of its area: the mean of |nx| + |ny| + |nz| over all
unit normals n.
"""


def find_levels(
    volume: Volume, isovalues: tuple[float, float], named: Iterable[float]
) -> tuple[float, ...]:
    """The levels of a range, ascending in the units of the volume's file: its ends, and those that
    are ``named``, too.

    A view of a level mixes nothing.
    """
    first, last = sorted(isovalues)
    span = float(volume.normalise_isovalue(first)), float(volume.normalise_isovalue(last))
    if span[0] == span[1]:
        return (first,)
    each = mean_ways(volume, (min(span), max(span)))
    ways = np.append(0.0, np.cumsum(each if span[0] < span[1] else each[::-1]))
    edges = np.linspace(first, last, RANGE_BINS + 1)
    found = {first, last}
    found |= {level for level in named if first <= level <= last}
    onward = np.append(True, np.diff(ways) > 0.0)
    for one, other in pairwise(sorted(found)):
        near, far = np.interp([one, other], edges, ways)
        steps = max(round((far - near) / LEVEL_VOXELS), 1)
        found |= {
            *np.interp(
                np.linspace(near, far, steps + 1)[1:-1], ways[onward], edges[onward]
            ).tolist()
        }
    return tuple(sorted(found))


def mean_ways(volume: Volume, span: tuple[float, float]) -> np.ndarray:
    """How far the surface moves through each of RANGE_BINS even parts of a ``span`` of normalised
    isovalues, in voxels.

    (RANGE_BINS,) float64. A cell is passed at an even speed from its least corner to its greatest
    one: in 1 / (high - low) voxels for each step of the isovalue, over CELLS_PER_VOXEL, as large as
    the way is along its normal.
    """
    sums = np.zeros((2, RANGE_BINS + 1))
    for z in range(0, len(volume.voxels) - 1, -(-volume.voxels.size // MAX_READ_VOXELS)):
        low, high = extremes_between(edges_between(volume.voxels[z], volume.voxels[z + 1]))
        met = (high > span[0]) & (low < span[1]) & (high > low)
        low, high = (
            (each[met].astype(np.float64) - span[0]) / (span[1] - span[0]) * RANGE_BINS
            for each in (low, high)
        )
        width = np.maximum(high - low, 1.0)
        first = np.clip(np.floor(low), 0, RANGE_BINS - 1).astype(np.int64)
        last = np.clip(np.maximum(np.ceil(high), first + 1), 1, RANGE_BINS).astype(np.int64)
        for row, counts in enumerate((np.ones_like(width), 1.0 / width)):
            sums[row] += np.bincount(first, counts, RANGE_BINS + 1) - np.bincount(
                last, counts, RANGE_BINS + 1
            )
    cells, speeds = np.cumsum(sums, axis=1)[:, :RANGE_BINS]
    return np.where(cells > 0.5, CELLS_PER_VOXEL * speeds / np.maximum(cells, 1.0), 0.0)


def levels_around(
    levels: Sequence[float], pinned: Iterable[float], shown: float
) -> tuple[tuple[float, float], ...]:
    """The ``levels`` around an isovalue ``shown``, and what each counts: one of them, or two that
    it is between.

    Where a ``pinned`` surface is there, too, it is ``shown`` itself: light jumps where one surface
    passes another.
    """
    k = bisect_left(levels, shown)
    if k in (0, len(levels)) or levels[k] == shown:
        return ((shown, 1.0),)
    low, high = levels[k - 1 : k + 1]
    if any(low <= each <= high for each in pinned):
        return ((shown, 1.0),)
    share = (shown - low) / (high - low)
    return (low, 1.0 - share), (high, share)
