"""The view that parameters make in a scene."""

from dataclasses import replace

from isogi_core.errors import ViewError
from isogi_core.model.scene import Scene
from isogi_core.model.view import (
    IDENTITY,
    Camera,
    Quaternion,
    Vec3,
    View,
    orbit,
    quaternion_from_angles,
    unit_quaternion,
)
from server.errors import ParameterError
from server.params import ViewParams
from server.settings import Settings
from server.values import Span


def view_of(scene: Scene, params: ViewParams, settings: Settings) -> View:
    """The view that the parameters ask for; ViewError where this scene or these settings do not allow it."""
    pixels, paths = params.width * params.height, params.width * params.height * params.samples
    if pixels > settings.max_pixels:
        raise ViewError(f"width × height must be at most {settings.max_pixels} pixels, not {pixels}.")
    if params.shading == "path_traced" and paths > settings.max_paths:
        raise ViewError(f"width × height × samples must be at most {settings.max_paths} paths, not {paths}.")
    return View(
        isovalue=isovalue_of(scene, params),
        camera=camera_of(scene, params),
        light=light_of(scene, params),
        width=params.width,
        height=params.height,
        shading=params.shading,
        samples=params.samples,
        albedo=albedo_of(scene, params),
    )


def isovalue_of(scene: Scene, params: ViewParams) -> float:
    """The isovalue asked for, else the scene's; ParameterError where it is outside the scene's range."""
    if params.isovalue is None:
        return scene.isovalue
    try:
        return Span(*scene.isovalues).read(params.isovalue)
    except ValueError as error:
        raise ParameterError(f"isovalue {error}", "isovalue") from None


def albedo_of(scene: Scene, params: ViewParams) -> Vec3 | None:
    """The albedo asked for, None where it is the scene's; ParameterError where the scene's light is not of it."""
    try:
        return None if scene.albedo_for(params.albedo) == scene.albedo else params.albedo
    except ViewError as error:
        raise ParameterError(str(error), "albedo") from None


def camera_of(scene: Scene, params: ViewParams) -> Camera:
    """The camera: at the eye where one is given, else on its orbit about the target."""
    target, radius = params.target or scene.volume.centre, scene.volume.radius
    if params.eye is not None:
        return Camera(params.eye, target, params.up or (0.0, 0.0, 1.0), params.fov)
    camera = orbit(target, radius, params.azimuth, params.elevation, params.distance, params.fov)
    return camera if params.up is None else replace(camera, up=params.up)


def light_of(scene: Scene, params: ViewParams) -> Quaternion:
    """The light rotation as a unit quaternion; ViewError where the scene's light does not turn."""
    if params.light is not None:
        turn = unit_quaternion(params.light)
    else:
        turn = quaternion_from_angles(params.yaw, params.pitch, params.roll)
    if not scene.rotating and abs(turn[0]) < 1 - 1e-12:
        raise ViewError("This scene's light does not turn (rotating = false): leave light and its angles out.")
    return turn if scene.rotating else IDENTITY
