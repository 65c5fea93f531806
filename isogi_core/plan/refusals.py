"""What a scene may not tell the planner: settings that contradict its lights, and settings that would do nothing."""

from isogi_core.errors import LightError, SceneError
from isogi_core.model.plan import Layer
from isogi_core.plan.budget import even
from isogi_core.plan.needs import Needs, Told

DIMMEST, BRIGHTEST = 1e-32, 1e32
"""Radiances of a white surface that frames, which are of single floats, show with all shades from a millionth up."""


def refuse_brightness(needs: Needs) -> None:
    """Raise LightError where all lights together are too bright for frames to hold, or so dim that they show black."""
    if needs.brightest != 0.0 and not DIMMEST <= needs.brightest <= BRIGHTEST:
        given = f"The lights give a white surface the radiance {needs.brightest:.3g}"
        raise LightError(f"{given}: scale them to give it from {DIMMEST:g} to {BRIGHTEST:g}, or nothing.")


def refuse_idle(representation: str, bounces: int, needs: Needs, told: Told) -> None:
    """Raise SceneError where what is told cannot show the scene's light, or changes nothing in its plan."""
    refuse_lights(representation, needs)
    refuse_orders(representation, bounces, told)
    refuse_lobes(representation, needs, told)
    refuse_reflections(bounces, needs, told)
    refuse_albedos(representation, bounces, told)


def refuse_lights(representation: str, needs: Needs) -> None:
    """Raise SceneError where a representation that was told cannot show the lights."""
    if representation in ("vicinity", "constant") and not even(needs):
        raise SceneError(f"representation = '{representation}' shows constant light alone: leave it out.")
    if representation == "transfer" and needs.lamps.any:
        raise SceneError("representation = 'transfer' is of light from far away, and lamps are near: leave it out.")
    if representation == "irradiance" and needs.rotating:
        raise SceneError("representation = 'irradiance' is of light that does not turn: set rotating = false.")


def refuse_orders(representation: str, bounces: int, told: Told) -> None:
    """Raise SceneError for orders of harmonics where none are kept."""
    for name, order in (("order", told.order), ("indirect_order", told.indirect_order)):
        if order is not None and representation != "transfer":
            raise SceneError(f"{name} = {order} is of harmonics, and this light needs none: leave it out.")
    if told.indirect_order is not None and not bounces:
        raise SceneError(
            f"indirect_order = {told.indirect_order} is of reflected light, and there is none: leave it out."
        )
    if told.order is not None and told.indirect_order is not None and told.indirect_order > told.order:
        raise SceneError(f"indirect_order = {told.indirect_order} is above order = {told.order}: take at most that.")


def refuse_lobes(representation: str, needs: Needs, told: Told) -> None:
    """Raise SceneError where more lobes are told of than the light has, or of light that has met texels as it is."""
    if told.lobes and representation != "transfer":
        raise SceneError(f"lobes = {told.lobes} are beside harmonics, and this light needs none: leave it out.")
    if told.lobes and told.lobes > len(needs.lobes):
        raise SceneError(f"lobes = {told.lobes} is more than this light has: take at most {len(needs.lobes)}.")


def refuse_reflections(bounces: int, needs: Needs, told: Told) -> None:
    """Raise SceneError where something is told of reflected light, and there is none."""
    if told.representation == "vicinity" and told.bounces:
        raise SceneError("representation = 'vicinity' is of light before it is reflected: leave out 'bounces'.")
    if told.bounces and max(needs.albedo) == 0.0:
        raise SceneError(f"bounces = {told.bounces} is of reflected light, and albedo 0 has none: leave it out.")
    if told.representation == "constant" and not bounces:
        raise SceneError("representation = 'constant' is of reflected light too, and there is none: leave it out.")


def refuse_albedos(representation: str, bounces: int, told: Told) -> None:
    """Raise SceneError where views may ask for another albedo, and light has met the scene's lights already."""
    if told.albedos is not None and representation == "irradiance" and bounces:
        given = f"albedos = [{told.albedos[0]:g}, {told.albedos[1]:g}]"
        advice = "set rotating = true, bounces = 0, or leave it out"
        raise SceneError(f"{given} is of light that may turn, and this is baked as it stands: {advice}.")


def refuse_no_bytes(layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
    """The layers; SceneError where none of them has a band that is kept in bytes."""
    if all(layer.coarse is None for layer in layers):
        raise SceneError("precision = 'bytes' is of higher bands of harmonics, and there are none: leave it out.")
    return layers
