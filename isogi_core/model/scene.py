"""A scene: a volume, its lights, its material and what may be asked of it; read from TOML or a bare volume."""

import hashlib
import json
import re
from dataclasses import astuple, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.kernels.field import OFFSET, Field
from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.boundaries import find_boundaries
from isogi_core.model.demo import DEMOS
from isogi_core.model.environment import Environment, environment
from isogi_core.model.lamps import Lamps, gather_lamps
from isogi_core.model.light_tables import light_from_mapping
from isogi_core.model.lights import Light
from isogi_core.model.opening import open_volume
from isogi_core.model.plan import REPRESENTATIONS, Layer, LeftOut, ScenePlan
from isogi_core.model.presets import Preset, read_presets, suggested_presets
from isogi_core.model.settings import Settings
from isogi_core.model.source import DEFAULT_DEMO, SceneSource, find_source
from isogi_core.model.survey import Tell, tell_nobody
from isogi_core.model.view import Camera, orbit
from isogi_core.model.volume import Volume
from isogi_core.plan.lobes import MOST as MOST_LOBES
from isogi_core.plan.needs import Needs, Told
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.savings import unseen
from isogi_core.plan.texels import TexelCount, count_texels

BAKE_FORMAT = 6
"""Counts up when what a chunk holds, or how its light is computed, changes."""

NORMALS = ("bspline", "gradient")
"""What normals may be of: the gradient smoothed with the tricubic B-spline, or the plain one (S1, figure 5)."""


CHUNKS = (8, 16, 32)
"""What the side of a chunk may be, in texels: small ones spread over more workers, large ones are fewer objects."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What can be rendered. ``isovalue`` and the range ``isovalues`` are in the volume's own units.

    ``albedo`` is linear RGB, and ``albedos`` are the least and the most that views may ask for in its place, None where
    light is of that one alone; ``lattice`` texels per voxel along each axis, ``target_error`` the
    relative error at which a texel counts as final, ``rotating`` whether the light may be turned.
    A chunk of the lattice has ``chunk`` texels along each side.
    ``normals`` says which gradient they are of, "bspline" (smoothed) or "gradient" (plain), and ``offset`` how many
    voxels above a surface rays leave it. ``plan`` was made for ``needs``, with what the scene has ``told``.
    ``named`` are the isovalues that the scene gives names to. ``sharpen`` says whether a view at rest has texels of its
    own on the isosurface that it shows, where those on theirs are far from it, and ``adaptive`` whether every second
    texel of the lattice is to do where light is smooth.
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
    needs: Needs
    told: Told
    plan: ScenePlan
    named: tuple[Preset, ...] = ()
    sharpen: bool = False
    adaptive: bool = False
    albedos: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """The name that a person reads."""
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
    def default_exposure(self) -> float:
        """The exposure at which a surface turned to the light shows its own albedo."""
        return 1.0 / self.needs.brightest if self.needs.brightest > 0.0 else 1.0

    @cached_property
    def texels(self) -> TexelCount:
        """How many texels the lattice has, and how many of them views can show; found when first asked for."""
        lowest, highest = sorted(map(self.volume.normalise_isovalue, self.isovalues))
        none = np.empty((0, 0, 0), np.float32)
        field = Field(self.volume.voxels, none, none, self.volume.spacing, self.normals == NORMALS[0], self.offset)
        return count_texels(field, self.lattice_shape, lowest, highest, self.chunk)

    @cached_property
    def presets(self) -> tuple[Preset, ...]:
        """Isovalues worth a look: those that the scene names, else boundaries in its volume, found when asked for."""
        return self.named or suggested_presets(find_boundaries(self.volume, self.isovalues))

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What the scene does without: what its plan leaves out, and texels that are never lit."""
        return (*self.plan.left_out, *unseen(self.texels, self.plan))

    def albedo_for(self, asked: tuple[float, float, float] | None) -> tuple[float, float, float]:
        """The albedo that a view has ``asked`` for, else the scene's own. ViewError where its light is not of that."""
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

    def layer_digest(self, layer: Layer, shown: float | None = None) -> str:
        """Hex name of everything that a layer's light depends on, and of nothing else.

        The scene's lights are among it for irradiance alone (S1, eq. 6), bounces for reflected light, with the albedo
        or those that it is kept for, and the normalised isovalue that is ``shown`` where texels lie on that.
        """
        *kept, nodes = astuple(layer)
        parts = [BAKE_FORMAT, self.volume.digest, self.lattice, *kept, *self.departures]
        if shown is not None:
            parts += ["shown", shown]
        if layer.reflected:
            parts += [["nodes", *nodes] if nodes else self.albedo[: layer.channels], self.bounces, self.plan.survival]
        if layer.kind == "irradiance":
            parts += [self.environment.digest, self.lamps.digest, self.albedo]
        return digest_of(parts)

    @property
    def departures(self) -> list[Any]:
        """What is not as usual of rays and chunks: names of light have it besides, so that those without it last."""
        rays = [] if (self.normals, self.offset) == (NORMALS[0], OFFSET) else [self.normals, self.offset]
        return rays if self.chunk == CHUNK else [*rays, self.chunk]

    def plan_digest(self, plan: ScenePlan, shown: float | None = None) -> str:
        """Hex name of all layers of a ``plan`` for this scene."""
        return digest_of([self.layer_digest(layer, shown) for layer in plan.layers])

    @cached_property
    def bake_digest(self) -> str:
        """Hex name of all layers of the plan."""
        return self.plan_digest(self.plan)

    @cached_property
    def digest(self) -> str:
        """Hex name of everything that a frame of this scene depends on besides its view."""
        lights = [self.environment.digest, self.lamps.digest]
        ways = [name for name in ("sharpen", "adaptive") if getattr(self, name)]
        lit = [self.albedo, self.plan.order, self.plan.lobes, self.target_error]
        return digest_of([self.bake_digest, *lights, *lit, *ways])

    def camera(self, azimuth: float, elevation: float, distance: float, fov: float) -> Camera:
        """Camera around the middle of the volume's box; degrees, and distance in its bounding radii."""
        return orbit(self.volume.centre, self.volume.radius, azimuth, elevation, distance, fov)


def digest_of(parts: list[Any]) -> str:
    """Hex name of numbers and words."""
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=10).hexdigest()


def load_scene(target: str | Path | None = None, **overrides: Any) -> Scene:
    """Load a scene file (.toml), a volume (.nrrd, .nhdr, .zarr) or a demo ("demo:casting", also the default).

    ``overrides`` replace settings of the scene, by the names they have in a scene file. Raises
    SceneError, VolumeError or LightError.
    """
    return build_scene(find_source(target, overrides))


def build_scene(source: SceneSource, tell: Tell = tell_nobody, volume: Volume | None = None) -> Scene:
    """Open the volume and the lights of ``source`` and check every setting.

    ``tell`` hears of the progress where a copy of a large volume is made. A ``volume`` that is open already is taken in
    place of the one that the scene names.
    """
    settings = Settings(source)
    volume = volume or open_volume(settings, source.base, tell)
    lights = tuple(light_from_mapping(entry, source.base) for entry in settings.lights())
    lamps = gather_lamps(lights)
    isovalues = settings.interval("isovalues", volume.value_range, volume.core)
    fallback = min(max(default_isovalue(settings, volume), isovalues[0]), isovalues[1])
    isovalue = settings.number("isovalue", fallback, *isovalues)
    albedo = settings.colour("albedo", 0.7)
    told = told_by(settings, albedo)
    target_error = settings.number("target_error", 0.02, 1e-4, 1.0)
    light, rotating = environment(lights), may_rotate(settings, lamps)
    most = albedo if told.albedos is None else (told.albedos[1],) * 3
    needs = Needs(light, lamps, volume.centre, volume.radius, rotating, most, target_error)
    plan = plan_scene(needs, told)
    scene = Scene(
        id=re.sub(r"[^a-z0-9_-]+", "-", source.name.lower()).strip("-")[:64] or "scene",
        source=source,
        volume=volume,
        lights=lights,
        environment=light,
        lamps=lamps,
        isovalue=isovalue,
        isovalues=isovalues,
        albedo=albedo,
        lattice=settings.number("lattice", 1.0, 0.125, 4.0),
        chunk=settings.choice("chunk", CHUNKS) or CHUNK,
        target_error=target_error,
        rotating=rotating,
        normals=settings.choice("normals", NORMALS) or NORMALS[0],
        offset=settings.number("offset", OFFSET, 0.0, 2.0),
        needs=needs,
        told=told,
        plan=plan,
        named=read_presets(settings, isovalues),
        sharpen=settings.flag("sharpen", False),
        adaptive=settings.flag("adaptive", False),
        albedos=told.albedos or ((0.0, 1.0) if told.bounces == 0 and max(albedo) > 0.0 else None),
    )
    settings.refuse_unknown()
    return scene


def told_by(settings: Settings, albedo: tuple[float, float, float]) -> Told:
    """What the scene says of its own plan; its ``albedo`` is to be one of those that views may ask for."""
    albedos = settings.span("albedos", 0.0, 1.0)
    if albedos is not None and not albedos[0] <= min(albedo) <= max(albedo) <= albedos[1]:
        given = f"albedos = [{albedos[0]:g}, {albedos[1]:g}]"
        raise SceneError(f"{given} leaves out the scene's own albedo, {min(albedo):g} to {max(albedo):g}: widen it.")
    return Told(
        representation=settings.choice("representation", REPRESENTATIONS),
        order=settings.count("order", MAX_ORDER, 1),
        indirect_order=settings.count("indirect_order", MAX_ORDER, 1),
        bounces=settings.count("bounces", 1000),
        precision=settings.choice("precision", ("bytes", "half", "single")),
        lobes=settings.count("lobes", MOST_LOBES),
        albedos=albedos,
    )


def may_rotate(settings: Settings, lamps: Lamps) -> bool:
    """Whether the light may be turned: by default where there are no lamps, and never where there are."""
    rotating = settings.flag("rotating", not lamps.any)
    if rotating and lamps.any:
        raise SceneError("Lamps stay where they are: leave out rotating = true, or the lamps.")
    return rotating


def default_isovalue(settings: Settings, volume: Volume) -> float:
    """Where a view starts when the scene does not say: the demo's own isovalue, or Otsu's threshold."""
    name = settings.text("volume", DEFAULT_DEMO)
    if name.startswith("demo:"):
        return float(DEMOS[name.removeprefix("demo:")][1])
    return otsu(*volume.histogram())


def otsu(counts: np.ndarray, edges: np.ndarray) -> float:
    """The edge that parts a histogram of even bins into the two classes farthest apart (Otsu 1979).

    Distances are counted in bins: squares of values may be more than a double holds, or less.
    """
    middles = np.arange(len(counts)) + 0.5
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    mass = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = (mass[-1] - mass[:-1]) / above - mass[:-1] / below
        between = np.nan_to_num(below.astype(float) * above * apart**2)
    return float(edges[1 + int(np.argmax(between))])
