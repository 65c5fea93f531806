"""From parameters to the view of a scene, in the units and axes that rendering uses."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from isogi_core.bake.noise import Goal
from isogi_core.errors import ViewError
from isogi_core.files.vector import Vector
from isogi_core.model.material import SHINE_KNOBS, Shine
from isogi_core.model.view import (
    IDENTITY,
    NO_TURN,
    Camera,
    Quaternion,
    Turn,
    View,
    light_in_box,
    nearest_turn,
    orbit,
    quaternion_from_angles,
    read_window,
    unit_quaternion,
)
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import turned_by
from isogi_server.errors import ParameterError
from isogi_server.parameters import ANGLES, ExportParams, FoldParams, FrameParams, ViewParams
from isogi_server.settings import Settings
from isogi_server.values import Span

Params = TypeVar("Params", bound=ViewParams)


def goal_of(scene: Scene, max_error: float | None) -> Goal:
    """Return the goal of a picture that is to reach the error ``max_error``, by default the
    ``scene``'s target error, and that control pixels check.
    """
    return Goal.checked(max_error or scene.target_error)


def view_of(scene: Scene, params: ViewParams, settings: Settings) -> View:
    """Return the view that the parameters ask for. Raises ViewError if the scene or the
    ``settings`` do not allow it.
    """
    if isinstance(params, FrameParams) and params.strip:
        first, last = params.strip
    else:
        first = 0
        last = params.height
    if last > params.height:
        raise ParameterError(f"strip ends at row {last} of a picture of {params.height}.", "strip")
    # Limits count the rows that are drawn, not those of the whole picture.
    pixels = params.width * (last - first)
    paths = params.width * (last - first) * params.samples
    if pixels > settings.most_pixels:
        raise ViewError(
            f"width × height must be at most {settings.most_pixels} pixels, not {pixels}."
        )
    if params.shading == "path_traced" and paths > settings.max_paths:
        raise ViewError(
            f"width × height × samples must be at most {settings.max_paths} paths, not {paths}."
        )
    window = None
    if params.window is not None:
        window = read_window(params.window).in_box(scene.volume.orientation)
    return View(
        isovalue=isovalue_of(scene, params),
        camera=camera_of(scene, params),
        light=light_of(scene, params),
        width=params.width,
        height=last - first,
        strip=None if last - first == params.height else (first, params.height),
        shading=params.shading,
        samples=params.samples,
        albedo=albedo_of(scene, params),
        shine=shine_of(scene, params),
        glow=glow_of(scene, params),
        smooth=isinstance(params, FrameParams)
        and params.antialias == "on"
        and params.shading != "path_traced",
        orientation=scene.volume.orientation,
        window=window,
    )


PLACING = frozenset(("distance", "eye", "target", "up"))
"""Parameters that place the camera."""


def with_first_view(
    scene: Scene, knobs: Mapping[str, str], others: Iterable[Mapping[str, str]] = ()
) -> dict[str, str]:
    """Return the parameters ``knobs`` of a view, completed by those of the scene's first view that
    neither ``knobs`` nor ``others`` name.

    ``others`` are views that are combined with these parameters. If they place the camera, the
    scene's target and distance are not used.
    """
    given = set(knobs).union(*others)
    first = scene.settings.first.given
    if given.intersection(PLACING):
        first = {name: value for name, value in first.items() if name not in PLACING}
    # An eye replaces the angles of an orbit, and a quaternion those of the light.
    if "eye" in given:
        given |= {"azimuth", "elevation"}
    if "light" in given:
        given |= {"yaw", "pitch", "roll"}
    told = {
        name: ",".join(map(repr, value)) if isinstance(value, tuple) else str(value)
        for name, value in first.items()
        if name not in given
    }
    return {**told, **knobs}


def isovalue_of(scene: Scene, params: ViewParams) -> float:
    """Return the isovalue that is asked for, else the scene's. Raises ParameterError outside
    the scene's range.
    """
    if params.isovalue is None:
        return scene.isovalue
    try:
        return Span(*scene.isovalues).read(params.isovalue)
    except ValueError as error:
        raise ParameterError(f"isovalue {error}", "isovalue") from None


def albedo_of(scene: Scene, params: ViewParams) -> Vector | None:
    """Return the albedo that is asked for; None if it is the scene's. Raises ParameterError if
    the scene has no light for it.
    """
    try:
        if scene.surfaces.albedo_for(params.albedo) == scene.surfaces.albedo:
            return None
        return params.albedo
    except ViewError as error:
        raise ParameterError(str(error), "albedo") from None


def shine_of(scene: Scene, params: ViewParams) -> Shine | None:
    """Return the shine that is asked for; None if it is the scene's. Raises ParameterError if
    the scene has no shine.
    """
    given = {
        name: getattr(params, name) for name in SHINE_KNOBS if getattr(params, name) is not None
    }
    if not given:
        return None
    if scene.surfaces.shine is None:
        name = next(iter(given))
        raise ParameterError(
            f"{name} is for scenes that shine: leave it out, or give the scene a [shine] table.",
            name,
        )
    # Numbers that are left out stay those of the scene.
    shine = replace(
        scene.surfaces.shine, **{SHINE_KNOBS[name]: value for name, value in given.items()}
    )
    if shine == scene.surfaces.shine:
        return None
    return shine


def glow_of(scene: Scene, params: ViewParams) -> float:
    """Return the brightness of glowing parts, relative to the scene's. Raises ParameterError if
    nothing glows.
    """
    try:
        return scene.lighting.glow_for(params.glow)
    except ViewError as error:
        raise ParameterError(str(error), "glow") from None


def camera_of(scene: Scene, params: ViewParams) -> Camera:
    """Return the camera in the axes of the volume's box: at the eye if that is given, else on
    its orbit about the target.
    """
    target = params.target or scene.volume.world_centre
    radius = scene.volume.radius
    if params.eye is not None:
        camera = Camera(params.eye, target, params.up or (0.0, 0.0, 1.0), params.fov)
    else:
        camera = orbit(
            target, radius, params.azimuth, params.elevation, params.distance, params.fov
        )
        if params.up is not None:
            camera = replace(camera, up=params.up)
    # Rendering works in the axes of the volume's box, which an oblique scan rotates in the world.
    return scene.in_box(camera, params.projection)


Turnable = ViewParams | ExportParams | FoldParams
"""Parameters that may turn the light."""


def turn_asked(params: Turnable) -> Quaternion:
    """Return the rotation of the light in the world that the parameters ask for, a unit quaternion.
    Raises ViewError if theirs is too short or too long.
    """
    if params.light is not None:
        return unit_quaternion(params.light)
    return quaternion_from_angles(params.yaw, params.pitch, params.roll)


def light_of(scene: Scene, params: ViewParams) -> Quaternion:
    """Return the rotation of the light in the axes of the volume's box, a unit quaternion.

    Light that is baked for each turn is not rotated any more. Raises ViewError if the scene's light
    cannot be rotated, or is baked for another turn.
    """
    turn = turn_asked(params)
    lighting = scene.lighting
    if lighting.rotating:
        return light_in_box(turn, scene.volume.orientation)
    if lighting.baked_by_turn and nearest_turn(turn) != scene.turn:
        raise ViewError(
            "This scene's light is baked for each turn, and this is that of another one: leave "
            "light and its angles out."
        )
    # The identity is no rotation, whatever spells it.
    if not lighting.turnable and abs(turn[0]) < 1 - 1e-12:
        raise ViewError(
            "This scene's light does not turn, as it has lamps or says rotating = false: leave "
            "light and its angles out."
        )
    return IDENTITY


def in_turned_light(scene: Scene, params: ViewParams) -> Scene:
    """Return the scene whose light is baked for the turn that the parameters ask for, if its light
    is baked for each turn; else the scene.
    """
    turn = turn_baked(scene, params)
    return scene if turn == scene.turn else turned_by(scene, turn, scene.id)


def turn_baked(scene: Scene, params: ViewParams) -> Turn:
    """Return the turn for which the light of a view is baked; NO_TURN if the scene's light is baked
    for all turns together, or cannot be turned.
    """
    if scene.lighting.baked_by_turn:
        return nearest_turn(turn_asked(params))
    return NO_TURN


def check_view(scene: Scene, params: ViewParams, settings: Settings) -> None:
    """Raise as ``view_of`` does, for views of the scene in any turn of the light that it allows."""
    if scene.lighting.baked_by_turn:
        turn_asked(params)
        params = unturned(params)
    view_of(scene, params, settings)


def unturned(params: Params) -> Params:
    """Return the parameters without a turn of the light."""
    return params.model_copy(update={"light": None, **dict.fromkeys(ANGLES, 0.0)})
