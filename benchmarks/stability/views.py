"""Cases of extreme views: within the solid, far away, with the widest and the narrowest fields."""

import numpy as np

from benchmarks.stability.cameras import FURTHEST, far_eye, hard_views, square
from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import faults, no_numbers
from benchmarks.stability.shapes import body, ramp
from benchmarks.stability.specimen import volumes
from benchmarks.stability.stage import STAND, renderer_of, scene_of, scenes_of, view_of
from benchmarks.stability.surface import surface_in
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.kernels.planes import CONVERGING
from isogi_core.model.scene import Scene
from isogi_core.model.view import SHADINGS, View
from isogi_core.model.volume import make_volume
from isogi_core.report.bake import ViewBake

GROUP = "extreme views"
SPACING = (1.0, 1.25, 0.8)


def bodies() -> Scene:
    """The body, with soft skin, in voxels that are not cubes."""
    return scene_of(make_volume(ramp(body(), 4.0), SPACING), 0.5)


@case(GROUP, "finite", "from wherever one looks, every number of every plane is finite", 0, "numbers")
def finite(size: Size) -> Outcome:
    """Thirty hard views in all shadings: light, error, positions, normals, and what is wanted of the bake."""
    with renderer_of(bodies()) as renderer:
        views, wrong, frames = hard_views(renderer, size.pick(16, 64)), 0, 0
        for view in views.values():
            for shading in ("gi", "phong_shadow") if size is Size.QUICK else SHADINGS:
                frame = renderer.render(View(**{**vars(view), "shading": shading, "samples": 1}))
                normals = frame.gbuffer.normals(renderer.recipe, renderer.tiles, None)
                weights = np.array([demand.weight for demand in frame.demands])
                wrong, frames = wrong + faults(frame) + no_numbers(normals, weights), frames + 1
    return Outcome(wrong, f"of {frames} frames of {len(views)} views")


@case(GROUP, "where pixels look", "what a pixel shows lies on the ray through its middle", 1e-4, "voxels")
def where_pixels_look(size: Size) -> Outcome:
    """Hits of thirty hard views against rays by extended precision; the farthest view of all as well."""
    with renderer_of(bodies()) as renderer:
        views, worst, hits = hard_views(renderer, size.pick(32, 128)), 0.0, 0
        for view in views.values():
            gbuffer = renderer.gbuffer(view)
            if len(gbuffer.points):
                worst = max(worst, float(off_the_ray(view, gbuffer.pixels, gbuffer.points).max()))
                hits += len(gbuffer.points)
    return Outcome(worst, f"of {hits:,} hits in {len(views)} views")


def off_the_ray(view: View, pixels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far ``points`` (m, 3), index space, are from the rays through the middles of their pixels, in voxels."""
    spacing = np.array(SPACING, np.longdouble)
    eye = np.array(view.camera.eye, np.longdouble)
    rays = pixel_rays(view)[pixels]
    away = points * spacing - eye
    along = (away * rays).sum(axis=1) / (rays * rays).sum(axis=1)
    return np.linalg.norm(((away - along[:, None] * rays) / spacing).astype(float), axis=1)


def pixel_rays(view: View) -> np.ndarray:
    """World directions (pixels, 3) through the middles of all pixels, in extended precision."""
    camera, one = view.camera, np.longdouble(1)
    forward = np.array(camera.target, np.longdouble) - np.array(camera.eye, np.longdouble)
    forward /= np.sqrt((forward**2).sum())
    right = np.cross(forward, np.array(camera.up, np.longdouble))
    right /= np.sqrt((right**2).sum())
    tangent = np.tan(np.deg2rad(one * camera.fov) / 2)
    y, x = np.mgrid[: view.height, : view.width] + one / 2
    u, v = (x - one * view.width / 2) / (one * view.height / 2), 1 - y / (one * view.height / 2)
    rays = forward + tangent * (u[..., None] * right + v[..., None] * np.cross(right, forward))
    return rays.reshape(-1, 3)


@case(GROUP, "hits in the box", "hits lie in the box, and on the surface", 1e-5, "voxels")
def hits_in_the_box(size: Size) -> Outcome:
    """How far the hits of thirty hard views lie outside, or from the isosurface, as the steepest slope has it."""
    with renderer_of(bodies()) as renderer:
        scene, worst = renderer.recipe.scene, 0.0
        surface = surface_in(scene.volume, scene.isovalue)
        steepest = max(float(abs(np.diff(scene.volume.voxels, axis=axis)).max()) for axis in range(3))
        views = hard_views(renderer, size.pick(32, 128))
        for view in views.values():
            points = renderer.gbuffer(view).points
            outside = np.maximum(-points, points - np.subtract(scene.volume.size, 1)).max(initial=0.0)
            off = abs(surface.height(points.astype(np.float64))).max(initial=0.0) / steepest
            worst = max(worst, float(outside), float(off))
    return Outcome(worst, f"of {len(views)} views")


@case(GROUP, "far eyes", "what a far eye shows is what parallel rays meet", 1e-4, "voxels")
def far_eyes(size: Size) -> Outcome:
    """From a million boxes, and from as far as may be asked for, but where the surface is seen at a grazing angle."""
    side, worst, hits = size.pick(48, 256), 0.0, 0
    with renderer_of(bodies()) as renderer:
        scene = renderer.recipe.scene
        surface, step = surface_in(scene.volume, scene.isovalue), np.array(SPACING)
        for distance in (1e6 * max(scene.volume.extent), FURTHEST * scene.volume.radius):
            view = square(scene, far_eye(scene, distance), side)
            gbuffer, (right, up, forward) = renderer.gbuffer(view), view.camera.basis()
            aside = pixel_rays(view)[gbuffer.pixels] @ np.stack([right, up], axis=1) * distance
            starts = np.array(scene.volume.centre) + (aside @ np.stack([right, up])).astype(float)
            starts -= 2.0 * scene.volume.radius * forward
            t, _ = surface.cast(starts / step, np.broadcast_to(forward / step, starts.shape))
            met = starts / step + np.where(np.isfinite(t), t, 0.0)[:, None] * (forward / step)
            faces = gbuffer.normals(renderer.recipe, renderer.tiles, None) @ forward < -0.4
            worst = max(worst, float(abs(met - gbuffer.points)[faces & np.isfinite(t)].max()))
            hits += int((faces & np.isfinite(t)).sum())
    return Outcome(worst, f"of {hits:,} hits, {FURTHEST:.0e} radii away at most")


@case(GROUP, "full turns", "a full turn of the camera changes no hit", 1e-4, "voxels")
def full_turns(size: Size) -> Outcome:
    """Azimuths that are a full turn apart."""
    side, worst = size.pick(48, 256), 0.0
    with renderer_of(bodies()) as renderer:
        scene = renderer.recipe.scene
        for one, other in ((0.0, 360.0), (0.0, -360.0), (90.0, -270.0), (-90.0, 270.0)):
            cameras = (scene.camera(**{**STAND, "azimuth": azimuth}) for azimuth in (one, other))
            a, b = (renderer.gbuffer(square(scene, camera, side)) for camera in cameras)
            same = np.array_equal(a.pixels, b.pixels)
            worst = max(worst, float(abs(a.points - b.points).max()) if same else np.inf)
    return Outcome(worst, f"of pictures of {side} × {side} pixels")


@case(GROUP, "normals", "the normal at a hit is finite and of length 1, however flat the field", 1e-6, "of its length")
def normals(size: Size) -> Outcome:
    """Every specimen that is not refused, also where the gradient vanishes."""
    worst, hits = 0.0, 0
    for scene in (scene for each in volumes() for scene in scenes_of(each)):
        with renderer_of(scene) as renderer:
            gbuffer = renderer.gbuffer(view_of(scene, size.pick(32, 128)))
            found = gbuffer.normals(renderer.recipe, renderer.tiles, None).astype(float)
            wrong = abs(np.linalg.norm(found, axis=1) - 1.0)
            worst = max(worst, float(np.where(np.isfinite(wrong), wrong, np.inf).max(initial=0.0)))
            hits += len(found)
    return Outcome(worst, f"of {hits:,} hits")


@case(
    GROUP,
    "baked light",
    "from wherever one looks, light is baked for every pixel, and is a number above 0",
    0,
    "pixels",
)
def baked_light(size: Size) -> Outcome:
    """Hard views of the body after a few paths from each texel; an open body has no dark place."""
    with renderer_of(bodies()) as renderer:
        wrong, pixels = 0, 0
        for view in hard_views(renderer, size.pick(6, 24)).values():
            bake = ViewBake(renderer, view)
            if not len(bake.texels):
                continue
            bake.grow(FIRST_RUNG)
            frame = bake.frame()
            on = frame.state > 0
            lit = (frame.radiance > 0.0).all(axis=2) & np.isfinite(frame.radiance.sum(axis=2) + frame.error)
            wrong += int((on & ~(lit & (frame.state >= CONVERGING))).sum())
            pixels += int(on.sum())
    return Outcome(wrong, f"of {pixels:,} pixels")
