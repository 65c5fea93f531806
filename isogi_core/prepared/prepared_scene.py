"""A prepared scene: the field, lattice, surfaces and lights as kernels take them, computed once."""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.volume_copies import get_survey
from isogi_core.kernels.shading.lattice import Lattice
from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.tracing.field import RAY_OFFSET_VOXELS, Field
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.tracing.macrocells import fill_macrocells, macrocell_shape
from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.kernels.tracing.walls import Walls
from isogi_core.kernels.transport.colours import NO_COLOURS, Colours, colours_of
from isogi_core.kernels.transport.light_paths import Open, Surroundings
from isogi_core.kernels.transport.lights import LampArrays
from isogi_core.kernels.transport.matter.matter_paths import Through
from isogi_core.kernels.transport.matter.passage import Matter, Passable
from isogi_core.kernels.transport.room_paths import InRoom, Room
from isogi_core.kernels.transport.surface_paths import Among, Surfaces
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.bands import project_environment
from isogi_core.plan.scene import Scene
from isogi_core.prepared.active_cell_maps import (
    MAP_BYTES,
    ActiveCellMaps,
    Survey,
    VoxelCodes,
    find_codes,
    measure_now,
)
from isogi_core.runs import Run, serially


@dataclass(frozen=True, eq=False)
class Surface:
    """The isosurface of a ``field`` at a normalised ``isovalue``; ``maps`` are the field's
    active-cell maps.

    ``PreparedScene.surface`` makes it from an isovalue in the units of the volume's file.
    """

    isovalue: Isovalue
    field: Field
    maps: ActiveCellMaps

    def cells(self, run: Run = serially) -> ActiveCells:
        """Return the cells that may hold the surface; they are found by means of ``run`` when
        first needed, and kept by ``maps``.
        """
        return self.maps.at(self.isovalue, run)

    def traced(self, run: Run = serially) -> TracedSurface:
        """Return the surface as kernels that cast rays take it: the field, the cells and the
        isovalue.
        """
        return TracedSurface(self.field, self.cells(run), float(self.isovalue))


UNSHADOWED_ORDER = 3
"""Order of the harmonics of unshadowed light: the cosine lobe keeps 99 % of any light in it
(Ramamoorthi and Hanrahan 2001).
"""

Index = tuple[int, int, int]
"""Position of a chunk in the lattice, in chunks along z, y, x."""

Met = Open | InRoom | Among | Through
"""Geometry that paths may meet, as kernels take it: see ``transport.entries``."""


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A ``scene`` as kernels take it. At most ``most`` bytes of active-cell maps are kept.

    ``survey`` returns arrays that are measured on the voxels, if another process has measured them.
    """

    scene: Scene
    most: int = MAP_BYTES
    survey: Survey | None = None

    @cached_property
    def field(self) -> Field:
        """The volume with its macrocells."""
        smooth = self.scene.settings.normals == "bspline"
        return make_field(self.scene.volume, smooth, self.scene.settings.offset, self.survey)

    @cached_property
    def maps(self) -> ActiveCellMaps:
        """The active-cell maps of the volume."""
        survey = self.survey or survey_of(self.scene.volume)
        return ActiveCellMaps(self.scene.volume.voxels, self.most, survey)

    @cached_property
    def voxel_codes(self) -> VoxelCodes:
        """The volume's voxels as graphics cards take them."""
        return find_codes(self.scene.volume)

    def beside(self, scene: Scene) -> "PreparedScene":
        """Prepare another ``scene`` of the same volume, in finer or other light: both share
        everything that was computed from the voxels.
        """
        made = PreparedScene(scene, self.most, self.survey)
        vars(made).update(field=self.field, maps=self.maps)
        return made

    def surface(self, isovalue: float) -> Surface:
        """Return the isosurface at an ``isovalue`` in the units of the volume's file."""
        return Surface(self.scene.volume.normalise_isovalue(isovalue), self.field, self.maps)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Texels along z, y, x."""
        return self.scene.lattice_shape

    @cached_property
    def step(self) -> np.ndarray:
        """Voxels per texel along x, y, z; (3,) float64."""
        return np.array(
            [
                (n - 1) / (t - 1)
                for n, t in zip(self.scene.volume.size, self.shape[::-1], strict=True)
            ]
        )

    @cached_property
    def lattice(self) -> Lattice:
        """The lattice as kernels take it."""
        x, y, z = (1.0 / self.step).tolist()
        return Lattice.of(self.shape, (x, y, z), self.scene.settings.chunk)

    @property
    def chunks(self) -> tuple[int, int, int]:
        """Chunks along z, y, x."""
        return self.lattice.chunks

    @cached_property
    def around(self) -> np.ndarray:
        """SH coefficients of the unturned lights as an unshadowed surface receives them, linear
        RGB, (3, n²) float64.

        The order is UNSHADOWED_ORDER, and 1 for constant light.
        """
        environment = self.scene.lighting.environment
        lamps = self.scene.lighting.lamps
        volume = self.scene.volume
        if lamps.any or environment.image.any():
            order = UNSHADOWED_ORDER
        else:
            order = 1
        return project_environment(environment, order) + lamps.approximate(
            order, volume.centre, volume.radius
        )

    def room(self, albedo: tuple[float, float, float]) -> Room:
        """Return the scene's walls as paths meet them, around an isosurface with its colours,
        or with this ``albedo``.
        """
        return self._room._replace(albedo=np.array(albedo), colours=self.colours)

    @cached_property
    def colours(self) -> Colours:
        """The isosurface's colours by data; NO_COLOURS if it has one albedo."""
        given = self.scene.surfaces.colours
        if given is None:
            return NO_COLOURS
        return colours_of(given.places, given.step, given.table)

    @cached_property
    def passable(self) -> Passable:
        """The walls, and the matter behind the isosurface, for rays that pass into it."""
        material = self.scene.surfaces.material
        scattering = 1.0 / material.mean_free_path, np.array(self.scene.surfaces.albedo, np.float64)
        return Passable(
            self._room, Matter(material.index, np.array(material.absorption), *scattering)
        )

    def met(self, albedo: Colour, cells: ActiveCells, run: Run = serially) -> Met:
        """Return the geometry that paths meet which start on isosurfaces of this ``albedo``, within
        their active ``cells``.

        The active cells of pinned surfaces are found by means of ``run``.
        """
        if self.scene.meets is Through:
            return Through(self.field, cells, *self.passable)
        if self.scene.meets is Among:
            return Among(self.field, self.surfaces_around(cells, run), self._room)
        if self.scene.meets is InRoom:
            return InRoom(self.field, cells, self.room(albedo))
        return Open(self.field, cells)

    def met_by_glow(self, albedo: Colour, cells: ActiveCells) -> InRoom | Among:
        """Return the geometry that paths of glow meet: as ``met``, but with walls that give off
        no light, as a layer of glow holds the light of glows alone.

        Without walls it is a room of none, as the kernels of glow know no open surroundings.
        """
        room = self.room(albedo)
        dark = room._replace(radiances=np.zeros_like(room.radiances))
        if self.scene.glow_meets is Among:
            return Among(self.field, self.surfaces_around(cells), dark)
        return InRoom(self.field, cells, dark)

    @cached_property
    def glows(self) -> Glows:
        """The glows of the scene, as rays gather them."""
        given = self.scene.lighting.glowing
        # Kernels take columns, one for each glow.
        middles, halves = (np.ascontiguousarray(each.T) for each in (given.middles, given.halves))
        lows, highs = np.ascontiguousarray(given.ranges.T)
        # An infinite range tells the kernel that all of a region glows, which a mask contradicts:
        # make its low end finite.
        lows = np.where(given.masked, np.maximum(lows, np.finfo(np.float64).min), lows)
        rest = (
            given.radii,
            lows,
            highs,
            1.0 / given.chords,
            given.masked.astype(np.float64),
            given.bits,
        )
        return Glows(middles, halves, given.round.astype(np.float64), *rest)

    @cached_property
    def _room(self) -> Room:
        """The walls around a black isosurface, whose albedo ``room`` fills in; no wall lets any
        ray through.
        """
        room = self.scene.lighting.room
        spacing = np.array(self.scene.volume.spacing)
        # Write corners, normals and edges in index space, in which rays are cast. ``across`` maps a
        # point to its coordinates along both edges, from 0 to 1.
        normals = np.cross(room.edges[:, 0], room.edges[:, 1])
        areas = np.linalg.norm(normals, axis=1)
        normals = normals / areas[:, None]
        across = room.edges / (room.edges**2).sum(axis=2, keepdims=True) * spacing
        walls = Walls(
            room.corners / spacing, normals * spacing, across, np.full(len(areas), np.inf)
        )
        given = [(wall.albedo, wall.radiance) for wall in room.walls]
        albedos, radiances = np.array(given, np.float64).reshape(-1, 2, 3).transpose(1, 0, 2).copy()
        twofold = np.array([wall.sides == 2 for wall in room.walls], np.float64)
        lit = albedos, radiances, twofold
        return Room(walls, room.corners, room.edges, normals, areas, *lit, np.zeros(3), NO_COLOURS)

    @cached_property
    def walls_in_view(self) -> Walls | None:
        """The walls as eye rays meet them: these pass through backs that are not lit. None if
        there are no walls.
        """
        if not self.scene.lighting.room.any:
            return None
        # Infinity stops rays from both sides, 0 those alone that hit the front: see ``Walls``.
        backs = np.where(self._room.twofold > 0.0, np.inf, 0.0)
        return self._room.walls._replace(backs=backs)

    def surfaces_around(self, cells: ActiveCells, run: Run = serially) -> Surfaces:
        """Return all surfaces of the scene, as paths meet them around an isosurface whose
        active ``cells`` are given.
        """
        scene = self.scene
        levels = [scene.volume.normalise_isovalue(each.isovalue) for each in scene.surfaces.pinned]
        maps = [cells, *(self.maps.at(level, run) for level in levels)]
        albedos = np.array(
            [scene.surfaces.albedo, *(each.albedo for each in scene.surfaces.pinned)], np.float64
        )
        clears = np.array(
            [scene.surfaces.clear, *(each.clear for each in scene.surfaces.pinned)], np.float64
        )
        # Kernels take a fixed number of maps: repeat the first one.
        filled = tuple(maps + [cells] * (MAX_SURFACES - len(maps)))
        through = np.array(
            [scene.surfaces.transmission, *(each.transmission for each in scene.surfaces.pinned)],
            np.float64,
        )
        return Surfaces(filled, np.array([np.nan, *levels], np.float64), albedos, clears, through)

    def surroundings(self, matrix: np.ndarray) -> Surroundings:
        """Return all light as it is, for paths that meet it, with the environment rotated by
        ``matrix`` (3, 3).

        Luminaires are left out, as paths meet them on the walls; see ``room``.
        """
        environment = self.scene.lighting.environment
        arrays = self.scene.lighting.lamps.arrays
        # The luminaires of walls are the last lamps.
        if luminaires := len(self.scene.lighting.room.lamps):
            arrays = LampArrays(*(each[:-luminaires] for each in arrays))
        return Surroundings(
            environment.constant, environment.image, matrix, environment.table, arrays
        )


def survey_of(volume: Volume) -> Survey:
    """Return the survey of a ``volume``, which measures arrays on its voxels.

    For a volume that takes much of the memory budget the survey keeps results in files by the
    volume's digest, so that this machine measures once: reading all voxels of 1024³ takes each
    process seconds, and pushes out of memory the pages that its rays need.
    """
    large = volume.voxels.nbytes > UNMAPPED_SHARE * budget()
    if large:
        return partial(get_survey, f"{volume.digest}-{SURVEY_VERSION}")
    return measure_now


SURVEY_VERSION = 1
"""Version of the arrays that are measured on volumes: increased if the same voxels give other
arrays.
"""


def make_field(
    volume: Volume,
    smooth: bool = True,
    offset: float = RAY_OFFSET_VOXELS,
    survey: Survey | None = None,
) -> Field:
    """Return the volume's voxels with the macrocells that serve every isovalue.

    ``smooth`` selects the gradient that normals are made of, ``offset`` is the distance in voxels
    at which rays leave a surface.
    """

    def measure() -> np.ndarray:
        """Find the least and the greatest voxel of each macrocell."""
        found = np.empty((2, *macrocell_shape(volume.shape)), np.float32)
        fill_macrocells(volume.voxels, *found)
        return found

    low, high = (survey or survey_of(volume))("macrocells", measure)
    return Field(volume.voxels, low, high, volume.spacing, smooth, offset)
