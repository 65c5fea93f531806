"""A scene: a volume with its lights, surfaces and plan, and the digests that name its light."""

import math
from dataclasses import astuple, dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import SceneSource
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.kernels.tracing.field import RAY_OFFSET_VOXELS, Field
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.kernels.transport.light_paths import Open, Surroundings
from isogi_core.kernels.transport.matter.matter_paths import Through
from isogi_core.kernels.transport.room_paths import InRoom
from isogi_core.kernels.transport.surface_paths import Among
from isogi_core.model.first_view import FirstView
from isogi_core.model.scene_plan import GLOW_KIND, GlowLayer, Layer, LeftOut, ScenePlan
from isogi_core.model.value_survey import digest_of
from isogi_core.model.view import NO_TURN, Camera, Turn, orbit, orthographic
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.inputs import PlanInputs, PlanOverrides, find_once
from isogi_core.plan.isovalue_levels import find_levels
from isogi_core.plan.isovalue_presets import (
    Preset,
    SeenNormals,
    exposure_for,
    find_boundaries,
    find_seen,
    front_of,
    suggested_presets,
)
from isogi_core.plan.left_out import (
    left_out_of_several,
    left_out_of_shine,
    left_out_of_sides,
    unprojected,
    unseen,
)
from isogi_core.plan.lighting import SceneLighting
from isogi_core.plan.materials import unrefracted
from isogi_core.plan.projection import ProjectionPlan, SampledRange, find_stops, plan_projection
from isogi_core.plan.reachable_texels import TexelCount, count_texels
from isogi_core.plan.surfaces import SceneSurfaces

BAKE_FORMAT = 6
"""Version of baked light: increased if a chunk's content, or the computation of its light,
changes.
"""

NORMAL_KINDS = ("bspline", "gradient")
"""Gradients that normals may be computed from: smoothed with the tricubic B-spline, or plain
(S1, figure 5).
"""

ROOM_KIND = "room"
COLOURED_KIND = "coloured"
AMONG_KIND = "among"
INSIDE_KIND = "inside"
GLOW_AMONG_KIND = "glow among"
"""Kinds of layers whose paths need other kernels: among walls; on a surface with colours, if
light may turn; among several surfaces; inside a subsurface; and glow among several surfaces.
"""

PATH_KINDS: dict[tuple[type, type], str] = {
    **{
        (InRoom, Surroundings): ROOM_KIND,
        (Among, Surroundings): AMONG_KIND,
        (Through, Surroundings): INSIDE_KIND,
    },
    **{(InRoom, Glows): GLOW_KIND, (Among, Glows): GLOW_AMONG_KIND},
}
"""Kind of a layer by the two records that select its kernel, the geometry that paths meet and
the light that they gather: those of ``transport.entries``.
"""

CHUNK_SIDES = (8, 16, 32)
"""Sides that a chunk may have, in texels. Small chunks spread over more workers; large ones are
fewer objects in the store.
"""


@dataclass(frozen=True)
class SceneSettings:
    """The settings of a scene's file that concern texels, rays and views.

    - ``lattice``: texels per voxel along each axis; ``chunk``: texels along each side of a chunk.
    - ``normals``: one of NORMAL_KINDS; ``offset``: distance in voxels above a surface at which rays
      start.
    - ``projected``: True if texels are projected onto the isosurface of a view at rest; None leaves
      that to ``plan.projection``.
    - ``presets``: isovalues that the scene names.
    - ``projection``: one of PROJECTIONS, for views that ask for none; ``first``: the first view.
    - ``overrides``: choices for the planner.
    """

    lattice: float
    chunk: int
    normals: str
    offset: float
    projected: bool | None
    presets: tuple[Preset, ...]
    projection: str
    first: FirstView
    overrides: PlanOverrides


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that can be rendered: volume, surfaces, lighting and settings, and the ``plan`` made
    for ``inputs``.

    ``isovalue``, at which views start, and the range ``isovalues`` that views may ask for are in
    the units of the volume's file. ``target_error`` is the relative error at which a picture is
    final. ``exposed_for`` is given if the scene is a variant of another one or cut open: it is the
    surface of that other scene as first seen, so that the same light is equally bright in pictures
    of both. ``turn`` is the turn of the views for which the scene's light is baked, of a variant of
    a scene whose light is baked for each turn.
    """

    id: str
    source: SceneSource
    volume: Volume
    isovalue: float
    isovalues: tuple[float, float]
    target_error: float
    settings: SceneSettings
    surfaces: SceneSurfaces
    lighting: SceneLighting
    inputs: PlanInputs
    plan: ScenePlan
    exposed_for: SeenNormals | None = None
    turn: Turn = NO_TURN

    @property
    def bakes(self) -> frozenset[str]:
        """The kinds of layers that are baked, see ``kind_of``; none for glass."""
        if self.surfaces.material.refracts:
            return frozenset()
        return frozenset(self.kind_of(layer, self.plan) for layer in self.plan.layers)

    @property
    def many_albedos(self) -> bool:
        """True if paths meet more than one albedo: those of walls, or of colours."""
        return self.lighting.room.any or self.surfaces.colours is not None

    @property
    def meets(self) -> type:
        """The record of the geometry that paths of light meet; it selects their kernels, see
        ``transport.entries``.

        Paths go Through matter, Among several surfaces, InRoom, or in the Open. All other code asks
        this property.
        """
        if self.surfaces.material.passable:
            return Through
        if self.surfaces.several:
            return Among
        return InRoom if self.many_albedos else Open

    @property
    def glow_meets(self) -> type:
        """The record of the geometry that paths of glow meet: InRoom also serves scenes without
        walls.
        """
        return Among if self.surfaces.several else InRoom

    def kind_of(self, layer: Layer, plan: ScenePlan) -> str:
        """Return the kind of a ``layer`` of a ``plan`` that names its kernel: the layer's, or
        one of PATH_KINDS or COLOURED_KIND that stands for it.
        """
        if layer.kind == "irradiance":
            return PATH_KINDS.get((self.meets, Surroundings), layer.kind)
        if layer.kind == GLOW_KIND:
            return PATH_KINDS[self.glow_meets, Glows]
        reflected = any(each.reflected and each.kind != GLOW_KIND for each in plan.layers)
        if self.surfaces.colours and reflected:
            return COLOURED_KIND
        return layer.kind

    @property
    def name(self) -> str:
        """The scene's name, for display."""
        return self.source.name

    @property
    def bounces(self) -> int:
        """Number of surface hits after the first that light paths may take."""
        return self.plan.bounces

    @property
    def solid(self) -> str:
        """The solid side of the isovalue, "above" or "below"."""
        return self.volume.solid

    @property
    def lattice_shape(self) -> tuple[int, int, int]:
        """Number of texels along z, y, x, at least 2: ``lattice`` per voxel, with the outermost
        texels on the outermost voxels.
        """
        z, y, x = (max(round((n - 1) * self.settings.lattice) + 1, 2) for n in self.volume.shape)
        return z, y, x

    @property
    def seen(self) -> SeenNormals:
        """The normals of the surface as first seen, from which the exposure is found."""
        inside = self.lighting.room.any
        find = partial(find_seen, self.volume, self.start, front_of(self.volume, inside))
        return self.exposed_for or find_once(self.volume, ("seen", self.start, inside), find)

    @property
    def front(self) -> tuple[float, float]:
        """Azimuth and elevation that the scene is first seen from, degrees."""
        first = self.settings.first
        azimuth, elevation = front_of(self.volume, self.lighting.room.any)
        return (
            azimuth if first.azimuth is None else first.azimuth,
            elevation if first.elevation is None else first.elevation,
        )

    @cached_property
    def default_exposure(self) -> float:
        """The exposure of pictures that ask for none: the scene's, or the one of
        ``exposure_for``.
        """
        if self.settings.first.exposure is not None:
            return self.settings.first.exposure
        # Take all light as harmonics, without shadows: environment, lamps as if far away, and glows
        # as an even light. Light of radiance L from all sides has L √4π in band 0.
        lamps = self.lighting.lamps.approximate(MAX_ORDER, self.volume.centre, self.volume.radius)
        light = self.inputs.harmonics + lamps
        light[:, 0] += self.glow_around * math.sqrt(4.0 * math.pi)
        # Light that turns has no lamps, and is kept in the axes of the world: turn the normals from
        # the volume's box to these. All other light is in the axes of the box, as the normals are.
        if self.lighting.rotating:
            turn = self.volume.orientation.matrix.T
        else:
            turn = np.eye(3)
        return exposure_for(
            light, self.surfaces.albedo, self.seen._replace(normals=self.seen.normals @ turn)
        )

    @property
    def glow_around(self) -> np.ndarray:
        """E/π of all glows, linear RGB (3,), at the distance of the volume's radius."""
        return self.lighting.glowing.seen_from(self.volume.radius)

    @property
    def start(self) -> Isovalue:
        """The isovalue at which views start, normalised."""
        return self.volume.normalise_isovalue(self.isovalue)

    @cached_property
    def span(self) -> tuple[Isovalue, Isovalue]:
        """The least and the greatest isovalue that views may ask for, normalised."""
        return self.volume.normalise_span(*self.isovalues)

    @property
    def texels(self) -> TexelCount:
        """The number of texels of the lattice, and of those that some view can show."""
        facts = self.lattice_shape, *self.span, self.settings.chunk
        return find_once(
            self.volume,
            ("texels", *facts, *self._rays),
            partial(count_texels, self._bare_field, *facts),
        )

    @property
    def projection(self) -> ProjectionPlan:
        """The isovalues at which texels are projected."""
        if self.settings.projected is not None:
            return ProjectionPlan.settled(self.span, self.settings.projected)
        facts = self.span, self.start, self.target_error
        find = partial(plan_projection, self._bare_field, *facts)
        return find_once(self.volume, ("projection", *facts, *self._rays), find)

    @property
    def levels(self) -> tuple[float, ...]:
        """Isovalues for which light of pinned surfaces is kept, ascending; views between two of
        them mix their light.
        """
        facts = self.isovalues, (self.isovalue, *(each.isovalue for each in self.settings.presets))
        return find_once(self.volume, ("levels", *facts), partial(find_levels, self.volume, *facts))

    @property
    def _rays(self) -> tuple[str, float]:
        """The settings of rays that meet the volume."""
        return self.settings.normals, self.settings.offset

    @property
    def _bare_field(self) -> Field:
        """The volume as kernels take it, without macrocells."""
        none = np.empty((0, 0, 0), np.float32)
        smooth = self.settings.normals == NORMAL_KINDS[0]
        return Field(
            self.volume.voxels, none, none, self.volume.spacing, smooth, self.settings.offset
        )

    @property
    def presets(self) -> tuple[Preset, ...]:
        """Isovalues that are suggested to people: those that the scene names, else boundaries
        in its volume. A segmentation gets none that it does not name.
        """
        colours = self.surfaces.colours
        named = self.settings.presets
        if named or (colours is not None and colours.scale.labels):
            return named
        find = partial(find_boundaries, self.volume, self.isovalues)
        return find_once(
            self.volume, ("presets", self.isovalues), lambda: suggested_presets(find())
        )

    @property
    def stops(self) -> SampledRange:
        """Isovalues at which the page's slider stops: evenly spaced surfaces."""
        find = partial(find_stops, self.volume, self.isovalues)
        return find_once(self.volume, ("stops", self.isovalues), find)

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """All things that are left out: by the plan, texels that are never lit or not
        projected, light of pinned surfaces between levels, and shine.
        """
        surfaces = self.surfaces
        found = [*self.plan.left_out]
        found += unseen(self.texels, self.plan)
        found += unprojected(self.projection, self.start)
        # Several surfaces leave out light between levels, or surfaces deep in a pixel.
        if surfaces.pinned or surfaces.clear > 0.0:
            levels = len(self.levels) if surfaces.pinned else 0
            found += left_out_of_several(len(surfaces.pinned), levels, self.plan)
        if surfaces.transmits:
            found += left_out_of_sides(self.plan)
        sharp = self.lighting.environment.sharp
        found += unrefracted(surfaces.material, self.lighting.lights, sharp)
        found += left_out_of_shine(surfaces.shine)
        return tuple(found)

    def with_settings(self, **changes: Any) -> "Scene":
        """Return the scene with ``changes`` of its settings; its plan stays."""
        return replace(self, settings=replace(self.settings, **changes))

    def require_texels(self) -> None:
        """Raise SceneError if the surface keeps no texels, as glass does, and their light is
        asked for.
        """
        if self.surfaces.material.refracts:
            raise SceneError(
                f"The surface of '{self.name}' is glass and keeps no light of its own: render "
                "views of it."
            )

    def layer_digest(self, layer: Layer, shown: Isovalue | None = None) -> str:
        """Return the digest (hex) of everything that a layer's light depends on, and of nothing
        else: equal digests share light.

        Irradiance depends on the scene's lights (S1, eq. 6), reflected light on bounces and
        albedos. Texels that are projected onto the isosurface ``shown``, a normalised isovalue,
        depend on it.
        """
        if isinstance(layer, GlowLayer):
            return self._glow_digest(layer, shown)
        surfaces = self.surfaces
        lighting = self.lighting
        # All layers depend on the volume, the lattice and the settings of rays.
        *kept, nodes = astuple(layer)
        parts = [BAKE_FORMAT, self.volume.digest, self.settings.lattice, *kept, *self.departures]
        if shown is not None:
            parts += ["shown", shown]
        # Reflected light also depends on the albedos that paths meet, and on their rules.
        if layer.reflected:
            if nodes:
                parts += [["nodes", *nodes]]
            else:
                parts += [surfaces.albedo[: layer.channels]]
            parts += [self.bounces, self.plan.survival]
            if self.plan.branches > 1:
                parts += ["branches", self.plan.branches]
        # Irradiance has met the scene's lights, walls and other surfaces.
        if layer.kind == "irradiance":
            parts += [*lighting.sources, surfaces.albedo, *lighting.walls]
            parts += surfaces.several_facts
            if surfaces.material.scatters:
                parts += surfaces.material_facts
        if layer.reflected:
            parts += surfaces.colour_facts
        return digest_of(parts)

    def _glow_digest(self, layer: GlowLayer, shown: Isovalue | None) -> str:
        """Return the digest of a layer of glow: of the places of glows and of all surfaces that
        reflect, but not of colours and strengths of glows or of other lights, as frames apply
        these.
        """
        surfaces = self.surfaces
        lighting = self.lighting
        parts = [
            BAKE_FORMAT,
            self.volume.digest,
            self.settings.lattice,
            *astuple(layer),
            *self.departures,
        ]
        parts += ["shown", shown]
        parts += [surfaces.albedo[: layer.colours], self.bounces, self.plan.survival]
        parts += [lighting.glowing.digest]
        # Walls reflect glow, but their light is not part of it.
        if lighting.room.any:
            parts += ["walls", lighting.room.dark_digest]
        return digest_of([*parts, *surfaces.several_facts, *surfaces.colour_facts])

    def wall_digest(self, *state: Any) -> str:
        """Return the digest (hex) of everything that the light of walls depends on, and of the
        numbers of a ``state``.
        """
        surfaces = self.surfaces
        lighting = self.lighting
        parts = [BAKE_FORMAT, self.volume.digest]
        parts += [*lighting.sources, lighting.room.digest, *lighting.glow]
        parts += [self.bounces, self.plan.survival, self.settings.normals, self.settings.offset]
        parts += [*surfaces.several_facts, *surfaces.material_facts, *surfaces.colour_facts]
        return digest_of([*parts, *state])

    @property
    def departures(self) -> list[Any]:
        """Settings of rays and chunks that differ from the defaults. Digests hold these alone,
        so that names of light made before such a setting existed stay valid.
        """
        if self._rays == (NORMAL_KINDS[0], RAY_OFFSET_VOXELS):
            rays = []
        else:
            rays = [*self._rays]
        if self.settings.chunk == DEFAULT_CHUNK_SIDE:
            return rays
        return [*rays, self.settings.chunk]

    def plan_digest(self, plan: ScenePlan, shown: Isovalue | None = None) -> str:
        """Return the digest (hex) of all layers of a ``plan`` for this scene, on the isosurface
        ``shown`` if texels are projected.
        """
        return digest_of([self.layer_digest(layer, shown) for layer in plan.layers])

    @cached_property
    def bake_digest(self) -> str:
        """Digest (hex) of all layers of the scene's plan."""
        return self.plan_digest(self.plan)

    @cached_property
    def digest(self) -> str:
        """Digest (hex) of everything that a frame of this scene depends on, except its view."""
        surfaces = self.surfaces
        lighting = self.lighting
        # Parts that a scene does not have are left out, so that digests of other scenes stay as
        # they are.
        parts = [self.bake_digest, *lighting.sources]
        parts += [surfaces.albedo, self.plan.order, self.plan.lobes, self.target_error]
        if self.settings.projected is not None:
            parts += ["projected", self.settings.projected]
        orientation = self.volume.orientation
        if orientation.placed:
            parts += [orientation.rotation, orientation.origin]
        parts += lighting.walls
        if surfaces.shine:
            parts += ["shine", *astuple(surfaces.shine)]
        parts += [*surfaces.colour_facts, *surfaces.several_facts, *surfaces.material_facts]
        return digest_of([*parts, *lighting.glow])

    def camera(self, azimuth: float, elevation: float, distance: float, fov: float) -> Camera:
        """Return a camera around the middle of the volume, in the volume's box. Angles are in
        the world, degrees; ``distance`` is in radii of the volume; ``fov`` is vertical,
        degrees.
        """
        camera = orbit(
            self.volume.world_centre, self.volume.radius, azimuth, elevation, distance, fov
        )
        return self.in_box(camera)

    def in_box(self, camera: Camera, projection: str | None = None) -> Camera:
        """Return a perspective ``camera`` of the world in the volume's box, with a
        ``projection``, by default the scene's.
        """
        if (projection or self.settings.projection) == "orthographic":
            camera = orthographic(camera, self.volume.radius)
        return camera.in_box(self.volume.orientation)
