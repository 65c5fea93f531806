"""A scene: a volume, its lights, its material and what may be asked of it; read from TOML or a bare volume."""

import hashlib
import json
import re
from dataclasses import astuple, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.nrrd import read_nrrd
from isogi_core.kernels.field import OFFSET
from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.demo import DEMOS, demo_volume
from isogi_core.model.environment import Environment, environment
from isogi_core.model.lamps import Lamps, gather_lamps
from isogi_core.model.light_tables import light_from_mapping
from isogi_core.model.lights import Light
from isogi_core.model.plan import REPRESENTATIONS, Layer, LeftOut, ScenePlan
from isogi_core.model.settings import Settings
from isogi_core.model.source import DEFAULT_DEMO, SceneSource, find_source
from isogi_core.model.view import Camera, orbit
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.needs import Needs, Told
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.savings import unseen
from isogi_core.plan.texels import TexelCount, count_texels

BAKE_FORMAT = 5
"""Counts up when what a chunk holds, or how its light is computed, changes."""

NORMALS = ("bspline", "gradient")
"""What normals may be of: the gradient smoothed with the tricubic B-spline, or the plain one (S1, figure 5)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What can be rendered. ``isovalue`` and the range ``isovalues`` are in the volume's own units.

    ``albedo`` is linear RGB, ``lattice`` texels per voxel along each axis, ``target_error`` the
    relative error at which a texel counts as final, ``rotating`` whether the light may be turned.
    ``normals`` says which gradient they are of, "bspline" (smoothed) or "gradient" (plain), and ``offset`` how many
    voxels above a surface rays leave it. ``plan`` was made for ``needs``, with what the scene has ``told``.
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
    target_error: float
    rotating: bool
    normals: str
    offset: float
    needs: Needs
    told: Told
    plan: ScenePlan

    @property
    def name(self) -> str:
        """The name that a person reads."""
        return self.source.name

    @property
    def bounces(self) -> int:
        """Surface hits after the first that light paths may take."""
        return self.plan.bounces

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
        return count_texels(self.volume.voxels, self.lattice_shape, lowest, highest, CHUNK)

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What the scene does without: what its plan leaves out, and texels that are never lit."""
        return (*self.plan.left_out, *unseen(self.texels, self.plan))

    def layer_digest(self, layer: Layer) -> str:
        """Hex name of everything that a layer's light depends on, and of nothing else.

        The scene's lights are among it for irradiance alone (S1, eq. 6), albedo and bounces for reflected light.
        """
        parts = [BAKE_FORMAT, self.volume.digest, self.lattice, *astuple(layer), *self.departures]
        if layer.reflected:
            parts += [self.albedo[: layer.channels], self.bounces, self.plan.survival]
        if layer.kind == "irradiance":
            parts += [self.environment.digest, self.lamps.digest, self.albedo]
        return digest_of(parts)

    @property
    def departures(self) -> list[Any]:
        """How rays leave surfaces, where that is not as usual: what names of light have besides, so as to keep."""
        usual = self.normals == NORMALS[0] and self.offset == OFFSET
        return [] if usual else [self.normals, self.offset]

    def plan_digest(self, plan: ScenePlan) -> str:
        """Hex name of all layers of a ``plan`` for this scene."""
        return digest_of([self.layer_digest(layer) for layer in plan.layers])

    @cached_property
    def bake_digest(self) -> str:
        """Hex name of all layers of the plan."""
        return self.plan_digest(self.plan)

    @cached_property
    def digest(self) -> str:
        """Hex name of everything that a frame of this scene depends on besides its view."""
        lights = [self.environment.digest, self.lamps.digest]
        return digest_of([self.bake_digest, *lights, self.albedo, self.plan.order, self.target_error])

    def camera(self, azimuth: float, elevation: float, distance: float, fov: float) -> Camera:
        """Camera around the middle of the volume's box; degrees, and distance in its bounding radii."""
        return orbit(self.volume.centre, self.volume.radius, azimuth, elevation, distance, fov)


def digest_of(parts: list[Any]) -> str:
    """Hex name of numbers and words."""
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=10).hexdigest()


def load_scene(target: str | Path | None = None, **overrides: Any) -> Scene:
    """Load a scene file (.toml), a volume (.nrrd, .nhdr) or a demo ("demo:casting", also the default).

    ``overrides`` replace settings of the scene, by the names they have in a scene file. Raises
    SceneError, VolumeError or LightError.
    """
    return build_scene(find_source(target, overrides))


def build_scene(source: SceneSource) -> Scene:
    """Open the volume and the lights of ``source`` and check every setting."""
    settings = Settings(source)
    volume = open_volume(settings, source.base)
    lights = tuple(light_from_mapping(entry, source.base) for entry in settings.lights())
    lamps = gather_lamps(lights)
    isovalues = settings.interval("isovalues", volume.value_range)
    fallback = min(max(default_isovalue(settings, volume), isovalues[0]), isovalues[1])
    isovalue = settings.number("isovalue", fallback, *isovalues)
    albedo = settings.colour("albedo", 0.7)
    target_error = settings.number("target_error", 0.02, 1e-4, 1.0)
    light, rotating = environment(lights), may_rotate(settings, lamps)
    needs = Needs(light, lamps, volume.centre, volume.radius, rotating, albedo, target_error)
    told = told_by(settings)
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
        target_error=target_error,
        rotating=rotating,
        normals=settings.choice("normals", NORMALS) or NORMALS[0],
        offset=settings.number("offset", OFFSET, 0.0, 2.0),
        needs=needs,
        told=told,
        plan=plan_scene(needs, told),
    )
    settings.refuse_unknown()
    return scene


def told_by(settings: Settings) -> Told:
    """What the scene says of its own plan."""
    return Told(
        representation=settings.choice("representation", REPRESENTATIONS),
        order=settings.count("order", MAX_ORDER, 1),
        indirect_order=settings.count("indirect_order", MAX_ORDER, 1),
        bounces=settings.count("bounces", 1000),
        precision=settings.choice("precision", ("bytes", "half", "single")),
    )


def may_rotate(settings: Settings, lamps: Lamps) -> bool:
    """Whether the light may be turned: by default where there are no lamps, and never where there are."""
    rotating = settings.flag("rotating", not lamps.any)
    if rotating and lamps.any:
        raise SceneError("Lamps stay where they are: leave out rotating = true, or the lamps.")
    return rotating


def open_volume(settings: Settings, base: Path) -> Volume:
    """The volume that the scene names: a demo or a file, with the spacing and the solid side that it asks for."""
    name = settings.text("volume", DEFAULT_DEMO)
    solid = settings.text("solid", "above")
    spacing = settings.numbers("spacing", 3)
    if not name.startswith("demo:"):
        array, steps = read_nrrd(base / name)
        return make_volume(array, spacing or steps, solid, Path(name).stem)
    if name.removeprefix("demo:") not in DEMOS:
        raise VolumeError(f"There is no {name}: choose one of {', '.join('demo:' + key for key in DEMOS)}.")
    if spacing or solid != "above":
        raise SceneError(f"{name} is made with spacing 1 and solid above: leave out 'spacing' and 'solid'.")
    return demo_volume(name.removeprefix("demo:"))


def default_isovalue(settings: Settings, volume: Volume) -> float:
    """Where a view starts when the scene does not say: the demo's own isovalue, or Otsu's threshold."""
    name = settings.text("volume", DEFAULT_DEMO)
    if name.startswith("demo:"):
        return float(DEMOS[name.removeprefix("demo:")][1])
    return otsu(*volume.histogram())


def otsu(counts: np.ndarray, edges: np.ndarray) -> float:
    """The edge that parts a histogram into the two classes farthest apart (Otsu 1979)."""
    middles = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    mass = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = (mass[-1] - mass[:-1]) / above - mass[:-1] / below
        between = np.nan_to_num(below.astype(float) * above * apart**2)
    return float(edges[1 + int(np.argmax(between))])
