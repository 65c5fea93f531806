"""A scene: a volume, its lights, its material and its plan, and the digests that name its light."""

import math
from collections.abc import Collection
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.scene_file import SceneSource
from isogi_core.kernels.shading.lattice import CHUNK
from isogi_core.kernels.tracing.field import OFFSET, Field
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.matter_paths import Through
from isogi_core.kernels.transport.open_paths import Open
from isogi_core.kernels.transport.room_paths import InRoom
from isogi_core.kernels.transport.surface_paths import Among
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.environment import Environment, Lamps
from isogi_core.model.glow import NO_GLOW, STRONGEST, Glowing
from isogi_core.model.lights import Colour, Light
from isogi_core.model.material import DIFFUSE, Material
from isogi_core.model.room import NO_ROOM, Room
from isogi_core.model.scene_plan import GLOW, GlowLayer, Layer, LeftOut, ScenePlan
from isogi_core.model.shine import Shine
from isogi_core.model.surfaces import OPAQUE, PinnedSurface, leaving
from isogi_core.model.value_survey import digest_of
from isogi_core.model.view import Camera, orbit, orthographic
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.first_view import SeenNormals, exposure_for, find_seen, front_of
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.isovalue_presets import Preset, find_boundaries, suggested_presets
from isogi_core.plan.left_out import unprojected, unseen, unshared, unshining, untold_sides
from isogi_core.plan.levels import find_levels
from isogi_core.plan.materials import unrefracted
from isogi_core.plan.projection import ProjectionPlan, plan_projection
from isogi_core.plan.range_sampling import SampledRange, find_stops
from isogi_core.plan.reachable_texels import TexelCount, count_texels

BAKE_FORMAT = 6
"""Version of baked light: increased when a chunk's content, or the way its light is computed, changes."""

NORMALS = ("bspline", "gradient")
"""Gradients that normals may be made of: smoothed with the tricubic B-spline, or plain (S1, figure 5)."""

SURVEYED = ("texels", "projection", "presets", "stops", "levels", "seen")
"""Properties of a scene that take a pass over its volume, and that no plan changes."""

ROOM, COLOURED, AMONG, INSIDE, GLOW_AMONG = "room", "coloured", "among", "inside", "glow among"
"""Stand for the kinds of layers that are baked among walls, on a surface with colours where its light may turn, among
several surfaces, or inside of one.
"""

PATH_KINDS: dict[tuple[type, type], str] = {
    **{(InRoom, Surroundings): ROOM, (Among, Surroundings): AMONG, (Through, Surroundings): INSIDE},
    **{(InRoom, Glows): GLOW, (Among, Glows): GLOW_AMONG},
}
"""The kinds of layers by what their paths meet and gather: those of ``transport.entries``."""

CHUNKS = (8, 16, 32)
"""Sides that a chunk may have, in texels. Small chunks spread over more workers; large ones are fewer objects."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that can be rendered. ``isovalue`` and the range ``isovalues`` are in the volume's own units.

    ``albedo`` is linear RGB. ``albedos`` are the least and the most that views may ask for in its place; None where
    light is baked for ``albedo`` alone. ``lattice`` is texels per voxel along each axis, ``chunk`` texels along each
    side of a chunk, ``target_error`` the relative error at which a pixel counts as final, and ``rotating`` whether the
    light may be turned. ``normals`` names their gradient, "bspline" (smoothed) or "gradient" (plain). Rays start
    ``offset`` voxels above a surface. ``plan`` was made for ``inputs``, with the scene's own ``overrides``.
    ``named`` are the isovalues that the scene names. ``projected`` settles whether texels that are far from the
    isosurface of a view at rest are projected onto it; None leaves that to the plan, see ``plan.projection``.
    ``colours`` are those of the surface by data, None where it has the one ``albedo``; that is then their brightest.
    ``lamps`` are those of the ``lights`` and the luminaires of the ``room``. ``shine`` is None where the surface is
    diffuse, and views may then ask for none. ``camera_projection``, one of PROJECTIONS, is that of views that ask for
    none. ``glowing`` is what glows in the volume. Beside the surface that slides others are ``pinned``; the share
    ``clear`` of rays passes straight through it, and of the light that falls on one side of it its ``transmission``,
    linear RGB, leaves the other, diffuse.
    """

    id: str
    source: SceneSource
    volume: Volume
    lights: tuple[Light, ...]
    environment: Environment
    lamps: Lamps
    isovalue: float
    isovalues: tuple[float, float]
    albedo: tuple[float, float, float]
    lattice: float
    chunk: int
    target_error: float
    rotating: bool
    normals: str
    offset: float
    inputs: PlanInputs
    overrides: PlanOverrides
    plan: ScenePlan
    named: tuple[Preset, ...] = ()
    projected: bool | None = None
    albedos: tuple[float, float] | None = None
    room: Room = NO_ROOM
    shine: Shine | None = None
    material: Material = DIFFUSE
    camera_projection: str = "perspective"
    colours: SurfaceColours | None = None
    glowing: Glowing = NO_GLOW
    pinned: tuple[PinnedSurface, ...] = ()
    clear: float = 0.0
    transmission: Colour = OPAQUE

    @property
    def bakes(self) -> frozenset[str]:
        """The kinds of layers that are baked; see ``kind_of``. Glass has none."""
        if self.material.refracts:
            return frozenset()
        return frozenset(self.kind_of(layer, self.plan) for layer in self.plan.layers)

    @property
    def many_albedos(self) -> bool:
        """Whether paths meet more than one albedo: of walls, or of colours."""
        return self.room.any or self.colours is not None

    @property
    def several(self) -> bool:
        """Whether light may meet more than one side of one surface: there are others, or some gets through this one."""
        return bool(self.pinned) or self.clear > 0.0 or any(self.transmission)

    @property
    def meets(self) -> type:
        """The record of what paths meet that gather light: it chooses their kernels, see ``transport.entries``.

        One place decides: paths go Through matter, Among several surfaces, InRoom, or in the Open.
        """
        if self.material.passable:
            return Through
        if self.several:
            return Among
        return InRoom if self.many_albedos else Open

    @property
    def glow_meets(self) -> type:
        """The record of what paths meet that gather glow: a room, too, where there are no walls."""
        return Among if self.several else InRoom

    @property
    def transmits(self) -> bool:
        """Whether light gets through any of the surfaces, diffuse."""
        return any(self.transmission) or any(any(each.transmission) for each in self.pinned)

    def kind_of(self, layer: Layer, plan: ScenePlan) -> str:
        """The kind of a ``layer`` of a ``plan``, or what stands for it, by whose kernels it is baked."""
        if layer.kind == "irradiance":
            return PATH_KINDS.get((self.meets, Surroundings), layer.kind)
        if layer.kind == GLOW:
            return PATH_KINDS[self.glow_meets, Glows]
        reflected = any(each.reflected and each.kind != GLOW for each in plan.layers)
        return COLOURED if self.colours and reflected else layer.kind

    @property
    def name(self) -> str:
        """The scene's name, for display."""
        return self.source.name

    @property
    def bounces(self) -> int:
        """Surface hits after the first that light paths may take."""
        return self.plan.bounces

    @property
    def lowest(self) -> float:
        """The lowest albedo of any channel that views may ask for."""
        return min(self.albedo) if self.albedos is None else self.albedos[0]

    @property
    def solid(self) -> str:
        """Which side of the isovalue is solid, "above" or "below"."""
        return self.volume.solid

    @property
    def lattice_shape(self) -> tuple[int, int, int]:
        """Texels along z, y, x: ``lattice`` per voxel, the outermost on the outermost voxels, at least 2."""
        z, y, x = (max(round((n - 1) * self.lattice) + 1, 2) for n in self.volume.shape)
        return z, y, x

    @cached_property
    def seen(self) -> SeenNormals:
        """How the surface lies that is seen at first; found on first use."""
        return find_seen(self.volume, self.start, front_of(self.volume, self.room.any))

    @cached_property
    def default_exposure(self) -> float:
        """The exposure of pictures that ask for none: see ``exposure_for``."""
        light = self.inputs.harmonics + self.lamps.approximate(MAX_ORDER, self.volume.centre, self.volume.radius)
        light[:, 0] += self.glow_around * math.sqrt(4.0 * math.pi)
        turn = self.volume.orientation.matrix.T if self.rotating else np.eye(3)
        return exposure_for(light, self.albedo, self.seen._replace(normals=self.seen.normals @ turn))

    @property
    def glow_around(self) -> np.ndarray:
        """What arrives of glows, E/π linear RGB (3,), as far from them as the volume reaches from its middle."""
        return self.glowing.seen_from(self.volume.radius)

    @property
    def start(self) -> Isovalue:
        """The isovalue where views start, normalised."""
        return self.volume.normalise_isovalue(self.isovalue)

    @cached_property
    def span(self) -> tuple[Isovalue, Isovalue]:
        """The least and the greatest isovalue that views may ask for, normalised."""
        return self.volume.normalise_span(*self.isovalues)

    @cached_property
    def texels(self) -> TexelCount:
        """Texels of the lattice, and how many of them views can show; counted on first use."""
        return count_texels(self._bare_field, self.lattice_shape, *self.span, self.chunk)

    @cached_property
    def projection(self) -> ProjectionPlan:
        """At which isovalues texels are projected; the volume is surveyed for it on first use."""
        if self.projected is not None:
            return ProjectionPlan.settled(self.span, self.projected)
        return plan_projection(self._bare_field, self.span, self.start, self.target_error)

    @cached_property
    def levels(self) -> tuple[float, ...]:
        """Isovalues that pinned surfaces' light is kept for, ascending, and mixed between; found on first use."""
        return find_levels(self.volume, self.isovalues, (self.isovalue, *(each.isovalue for each in self.named)))

    @property
    def _bare_field(self) -> Field:
        """The volume as kernels take it, without macrocells."""
        none = np.empty((0, 0, 0), np.float32)
        return Field(self.volume.voxels, none, none, self.volume.spacing, self.normals == NORMALS[0], self.offset)

    @cached_property
    def presets(self) -> tuple[Preset, ...]:
        """Isovalues worth seeing: the scene's own, else boundaries in its volume, but of labels; found on first use."""
        if self.colours is not None and self.colours.scale.labels:
            return self.named
        return self.named or suggested_presets(find_boundaries(self.volume, self.isovalues))

    @cached_property
    def stops(self) -> SampledRange:
        """Isovalues where the slider stops, evenly spaced surfaces; found on first use."""
        return find_stops(self.volume, self.isovalues)

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Everything that is left out: by the plan, texels that are never lit or not projected, and shine."""
        texels = (*unseen(self.texels, self.plan), *unprojected(self.projection, self.start))
        levels = len(self.levels) if self.pinned else 0
        beside = unshared(len(self.pinned), levels, self.plan) if self.pinned or self.clear > 0.0 else ()
        beside += untold_sides(self.plan) if self.transmits else ()
        beside += unrefracted(self.material, self.lights, self.environment.sharp)
        return (*self.plan.left_out, *texels, *beside, *unshining(self.shine))

    def with_plan(self, plan: ScenePlan) -> "Scene":
        """The scene by another ``plan``; what was surveyed of its volume stays."""
        return self.altered(SURVEYED, plan=plan)

    @property
    def surveys(self) -> dict[str, Any]:
        """What was surveyed of the volume so far, by name: see SURVEYED."""
        return {name: found for name, found in vars(self).items() if name in SURVEYED}

    def altered(self, kept: Collection[str], **changes: Any) -> "Scene":
        """The scene with ``changes``; properties ``kept``, as far as they were worked out, hold for it too."""
        scene = replace(self, **changes)
        vars(scene).update({name: found for name, found in vars(self).items() if name in kept})
        return scene

    def albedo_for(self, asked: tuple[float, float, float] | None) -> tuple[float, float, float]:
        """The albedo that a view has ``asked`` for, else the scene's own. ViewError where no light is baked for it."""
        if asked is not None and self.colours is not None:
            raise ViewError(f"The surface has its albedo from '{self.colours.scale.name}' in this scene: leave it out.")
        if asked is not None and asked != self.albedo and self.several:
            raise ViewError("Surfaces light each other in this scene: its albedos are fixed, leave albedo out.")
        if asked is None or asked == self.albedo:
            return self.albedo
        if self.albedos is None:
            raise ViewError(
                "albedo is fixed in this scene: leave it out, or give the scene a range, albedos = [0, 0.9]."
            )
        lowest, highest = self.albedos
        if not all(lowest <= share <= highest for share in asked):
            given = ",".join(f"{share:g}" for share in asked)
            raise ViewError(f"albedo must be from {lowest:g} to {highest:g} in this scene, not {given}.")
        return asked

    def leaving_for(self, asked: Colour | None) -> Colour:
        """What counts of texels' light in a view that has ``asked`` for an albedo. ViewError as ``albedo_for``."""
        return leaving(self.albedo_for(asked), self.transmission)

    def shine_for(self, asked: Shine | None) -> Shine | None:
        """The shine that a view has ``asked`` for, else the scene's own; None where nothing shines.

        ViewError where views of this scene may not ask for any.
        """
        shine = asked or self.shine
        if shine is None or shine.strength == 0.0:
            return None
        if self.shine is None:
            raise ViewError("This scene's surface is diffuse: give the scene a [shine] table, or leave shine out.")
        if self.colours is not None and shine.kind == "metal":
            raise ViewError("Metal mirrors one albedo, and this surface has colours: choose plastic.")
        return shine

    def glow_for(self, asked: float) -> float:
        """How bright what glows is to be, over the scene's own, as ``asked``; ViewError where nothing glows."""
        if asked == 1.0 or (self.glowing.any and 0.0 <= asked <= STRONGEST):
            return asked
        if self.glowing.any:
            raise ViewError(f"glow must be from 0 to {STRONGEST:g} times the scene's own, not {asked:g}.")
        raise ViewError(
            "glow is for scenes in which something glows: leave it out, or give the scene a [[glow]] table."
        )

    def require_texels(self) -> None:
        """Raise SceneError where the surface keeps no texels: what is asked for is the light that these keep."""
        if self.material.refracts:
            raise SceneError(
                f"The surface of '{self.name}' is glass and keeps no light of its own: render views of it."
            )

    def layer_digest(self, layer: Layer, shown: Isovalue | None = None) -> str:
        """Digest (hex) of everything that a layer's light depends on, and of nothing else.

        Irradiance depends on the scene's lights (S1, eq. 6), and reflected light on bounces and albedos. Texels that
        lie on the isosurface ``shown``, a normalised isovalue, depend on that.
        """
        if isinstance(layer, GlowLayer):
            return self._glow_digest(layer, shown)
        *kept, nodes = astuple(layer)
        parts = [BAKE_FORMAT, self.volume.digest, self.lattice, *kept, *self.departures]
        parts += [] if shown is None else ["shown", shown]
        if layer.reflected:
            parts += [["nodes", *nodes] if nodes else self.albedo[: layer.channels], self.bounces, self.plan.survival]
            parts += ["branches", self.plan.branches] if self.plan.branches > 1 else []
        if layer.kind == "irradiance":
            parts += [self.environment.digest, self.lamps.digest, self.albedo]
            parts += ["walls", self.room.digest] if self.room.any else []
            parts += [*self._company, *(self._made if self.material.scatters else [])]
        return digest_of(parts + (self._coloured if layer.reflected else []))

    def _glow_digest(self, layer: GlowLayer, shown: Isovalue | None) -> str:
        """The digest of a layer of glow: where glow is, and what reflects it; no colour or strength, no other light."""
        parts = [BAKE_FORMAT, self.volume.digest, self.lattice, *astuple(layer), *self.departures, "shown", shown]
        parts += [self.albedo[: layer.colours], self.bounces, self.plan.survival, self.glowing.digest]
        walls = ["walls", self.room.dark_digest] if self.room.any else []
        return digest_of([*parts, *walls, *self._company, *self._coloured])

    def wall_digest(self, *state: Any) -> str:
        """Digest (hex) of everything that the light of walls depends on, besides the numbers of a ``state``."""
        lights = [self.environment.digest, self.lamps.digest, self.room.digest]
        glow = ["glow", self.glowing.digest, self.glowing.radiances.tolist()] if self.glowing.any else []
        paths = [self.bounces, self.plan.survival, self.normals, self.offset]
        parts = [BAKE_FORMAT, self.volume.digest, *lights, *glow, *paths]
        return digest_of([*parts, *self._company, *self._made, *self._coloured, *state])

    @property
    def _company(self) -> list[Any]:
        """What digests hold of surfaces beside each other; nothing where there is one, and no light gets through."""
        others = sorted(each.facts for each in self.pinned)
        through = ["transmission", *self.transmission] if any(self.transmission) else []
        return ["surfaces", others, self.clear, *through] if self.several else []

    @property
    def _made(self) -> list[Any]:
        """What digests hold of the surface's material; nothing where it is diffuse."""
        material = self.material
        facts = material.kind, material.index, *material.absorption
        return [] if material == DIFFUSE else ["material", *facts, 1.0 / material.mean_free_path]

    @property
    def _coloured(self) -> list[Any]:
        """What digests hold of the surface's colours; nothing where there are none."""
        return [] if self.colours is None else ["colours", self.colours.digest]

    @property
    def departures(self) -> list[Any]:
        """Settings of rays and chunks that differ from the defaults; digests hold these alone, and old ones last."""
        rays = [] if (self.normals, self.offset) == (NORMALS[0], OFFSET) else [self.normals, self.offset]
        return rays if self.chunk == CHUNK else [*rays, self.chunk]

    def plan_digest(self, plan: ScenePlan, shown: Isovalue | None = None) -> str:
        """Digest (hex) of all layers of a ``plan`` for this scene."""
        return digest_of([self.layer_digest(layer, shown) for layer in plan.layers])

    @cached_property
    def bake_digest(self) -> str:
        """Digest (hex) of all layers of the plan."""
        return self.plan_digest(self.plan)

    @cached_property
    def digest(self) -> str:
        """Digest (hex) of everything that a frame of this scene depends on, its view left out."""
        lights = [self.environment.digest, self.lamps.digest]
        settled = [] if self.projected is None else ["projected", self.projected]
        orientation = self.volume.orientation
        placed = [orientation.rotation, orientation.origin] if orientation.placed else []
        lit = [self.albedo, self.plan.order, self.plan.lobes, self.target_error]
        walls = ["walls", self.room.digest] if self.room.any else []
        shine = ["shine", *astuple(self.shine)] if self.shine else []
        beside = [*walls, *shine, *self._coloured, *self._company, *self._made]
        glow = ["glow", self.glowing.digest, self.glowing.radiances.tolist()] if self.glowing.any else []
        return digest_of([self.bake_digest, *lights, *lit, *settled, *placed, *beside, *glow])

    def camera(self, azimuth: float, elevation: float, distance: float, fov: float) -> Camera:
        """Camera, in the volume's box, around its middle; angles in the world, degrees; distance in bounding radii."""
        camera = orbit(self.volume.world_centre, self.volume.radius, azimuth, elevation, distance, fov)
        return self.in_box(camera)

    def in_box(self, camera: Camera, projection: str | None = None) -> Camera:
        """A perspective ``camera`` of the world, in the volume's box, with a ``projection``: by default the scene's."""
        if (projection or self.camera_projection) == "orthographic":
            camera = orthographic(camera, self.volume.radius)
        return camera.in_box(self.volume.orientation)
