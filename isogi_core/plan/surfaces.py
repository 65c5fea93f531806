"""The surfaces of a scene: albedo, material, shine, transmission and pinned surfaces, read from
its file.
"""

from dataclasses import dataclass
from typing import Any

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.scene_file import Settings
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.lights import Colour
from isogi_core.model.material import (
    DIFFUSE,
    OPAQUE,
    Material,
    PinnedSurface,
    Shine,
    leaving,
    pinned_surfaces,
    refuse_gain,
    shine_from_mapping,
)
from isogi_core.model.volume import Volume
from isogi_core.plan.inputs import PlanOverrides
from isogi_core.plan.materials import read_material

BARE_ALBEDOS = (0.0, 1.0)
"""Range of albedos that views may ask for if no light is reflected: any albedo is then right."""


@dataclass(frozen=True, eq=False)
class SceneSurfaces:
    """The surfaces of a scene: the one that slides with the isovalue, and others that are
    ``pinned``.

    - ``albedo``: of the sliding surface, linear RGB; the brightest of ``colours`` if there are any.
    - ``albedos``: least and highest albedo that views may ask for; None if light is baked for
      ``albedo`` alone.
    - ``colours``: the albedo by data; None if the surface has one albedo.
    - ``shine``: None if the surface is diffuse, and views may not ask for shine.
    - ``material``: of the sliding surface.
    - ``clear``: share of rays that pass straight through the sliding surface.
    - ``transmission``: share of the light falling on one side that leaves the other, diffuse,
      linear RGB.
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
        """True if light may meet more than one side of one surface: there are pinned surfaces,
        or light gets through the sliding one.
        """
        return bool(self.pinned) or self.clear > 0.0 or any(self.transmission)

    @property
    def light_passes(self) -> bool:
        """True if light passes through some surface or enters it; such light is baked as it
        falls, and cannot be turned.
        """
        return self.several or self.material.scatters

    @property
    def transmits(self) -> bool:
        """True if any of the surfaces transmits diffuse light."""
        return any(self.transmission) or any(any(each.transmission) for each in self.pinned)

    @property
    def lowest(self) -> float:
        """The lowest albedo of any channel that views may ask for."""
        if self.albedos is None:
            return min(self.albedo)
        return self.albedos[0]

    @property
    def met(self) -> tuple[Colour, ...]:
        """The albedos that paths meet in addition to the one of a surface that lies alone."""
        pinned = (share for each in self.pinned for share in (each.albedo, each.leaving))
        if self.light_passes:
            return (*pinned, self.albedo)
        return tuple(pinned)

    @property
    def several_facts(self) -> list[Any]:
        """The part of digests that describes several surfaces; empty for one surface that lets
        no light through.
        """
        if not self.several:
            return []
        facts = ["surfaces", sorted(each.facts for each in self.pinned), self.clear]
        if any(self.transmission):
            facts += ["transmission", *self.transmission]
        return facts

    @property
    def material_facts(self) -> list[Any]:
        """The part of digests that describes the surface's material; empty for a diffuse one."""
        material = self.material
        if material == DIFFUSE:
            return []
        facts = [material.kind, material.index, *material.absorption]
        return ["material", *facts, 1.0 / material.mean_free_path]

    @property
    def colour_facts(self) -> list[Any]:
        """The part of digests that describes the surface's colours; empty if there are none."""
        if self.colours is None:
            return []
        return ["colours", self.colours.digest]

    def albedo_for(self, asked: Colour | None) -> Colour:
        """Return the albedo that a view has ``asked`` for, or the scene's if it asked for none.

        Raises ViewError if light is not baked for that albedo.
        """
        # Refuse an albedo that the scene's light does not allow.
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
        # The albedo must lie in the range that nodes of reflected light cover.
        lowest, highest = self.albedos
        if not all(lowest <= share <= highest for share in asked):
            given = ",".join(f"{share:g}" for share in asked)
            raise ViewError(
                f"albedo must be from {lowest:g} to {highest:g} in this scene, not {given}."
            )
        return asked

    def leaving_for(self, asked: Colour | None) -> Colour:
        """Return the factor on texels' light in a view that has ``asked`` for an albedo: albedo
        plus transmission. Raises ViewError as ``albedo_for`` does.
        """
        return leaving(self.albedo_for(asked), self.transmission)

    def shine_for(self, asked: Shine | None) -> Shine | None:
        """Return the shine that a view has ``asked`` for, or the scene's; None if nothing shines.

        Raises ViewError if views of this scene may not ask for that shine.
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
    """Read the surfaces of a scene from its ``settings``.

    ``colours`` are those of the surface by data, if any. Raises SceneError if a value has no
    meaning, or settings of the scene exclude each other.
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
    """Read the albedo of the sliding surface; if it has ``colours``, return the brightest of these.

    Raises SceneError if the scene has colours and also gives an albedo or a range of albedos.
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
    """Return the range of albedos that views may ask for; None if light is baked for one albedo.

    Raises SceneError if the scene's ``albedo`` lies outside of its range.
    """
    albedos = overrides.albedos
    if albedos is None:
        # Light without bounces does not depend on the albedo.
        if overrides.bounces == 0 and max(albedo) > 0.0 and colours is None:
            return BARE_ALBEDOS
        return None
    if not albedos[0] <= min(albedo) <= max(albedo) <= albedos[1]:
        given = f"albedos = [{albedos[0]:g}, {albedos[1]:g}]"
        raise SceneError(
            f"{given} leaves out the scene's albedo, {min(albedo):g} to {max(albedo):g}: widen it."
        )
    return albedos


def read_shine(settings: Settings, colours: SurfaceColours | None) -> Shine | None:
    """Read the scene's shine; None if its surface is diffuse. Raises SceneError if the shine
    has no meaning, or is metal on a surface with ``colours``.
    """
    table = settings.table("shine")
    if table is None:
        return None
    shine = shine_from_mapping(table)
    if shine.kind == "metal" and colours is not None:
        raise SceneError("Metal mirrors one albedo, and this surface has colours: choose plastic.")
    return shine


def read_pinned(
    settings: Settings, volume: Volume, colours: SurfaceColours | None
) -> tuple[PinnedSurface, ...]:
    """Read the scene's [[surfaces]]. Raises SceneError if one has no meaning, or the scene
    cannot have several surfaces.
    """
    found = pinned_surfaces(settings.tables("surfaces"), volume)
    if found:
        refuse_with_several(settings, colours, "[[surfaces]]")
    return found


def read_clear(settings: Settings, colours: SurfaceColours | None) -> float:
    """Read the share of rays that pass through the sliding surface. Raises SceneError as
    ``read_pinned`` does.
    """
    clear = settings.number("clear", 0.0, 0.0, 1.0)
    if clear > 0.0:
        refuse_with_several(settings, colours, "clear")
    return clear


def read_transmission(settings: Settings, albedo: Colour, colours: SurfaceColours | None) -> Colour:
    """Read the share of light that the sliding surface, of this ``albedo``, transmits, diffuse,
    linear RGB.

    Raises SceneError as ``read_pinned`` does, and if more light would leave the surface than falls
    on it.
    """
    transmission = settings.colour("transmission", 0.0)
    if any(transmission):
        refuse_with_several(settings, colours, "transmission")
        refuse_gain(albedo, transmission, f"The surface of the scene '{settings.source.name}'")
    return transmission


def refuse_with_several(settings: Settings, colours: SurfaceColours | None, what: str) -> None:
    """Raise SceneError if the scene has colours by data, a shine, or albedos that views choose.

    Several surfaces light each other: that light is baked for one fixed albedo each, without shine.
    ``what`` is the key of the scene's file that makes the surfaces several, for the message.
    """
    excluded = {
        "colours by data": colours is not None,
        "a shine": settings.table("shine") is not None,
        "albedos that views choose": settings.span("albedos", 0.0, 1.0) is not None,
    }
    for feature, given in excluded.items():
        if given:
            raise SceneError(
                f"The scene '{settings.source.name}' has {what} and {feature}: leave one of them "
                "out."
            )
