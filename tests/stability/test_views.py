"""Extreme views: cameras within the solid, on its surface, far away, and with the narrowest and the
widest fields.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.shading.framebuffer import CONVERGING
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.view import Camera, View, orthographic
from isogi_core.model.volume import make_volume
from isogi_core.plan.scene import Scene
from isogi_report.bench import ViewBake
from isogi_server.parameters import ViewParams, read
from isogi_server.views import camera_of
from tests.loaded import load_scene
from tests.stability.scenes import STAND, is_finite, renderer_of, scene_of, surface_in
from tests.stability.volumes import body, ramp

SPACING = (1.0, 1.25, 0.8)

NARROWEST = 0.01
WIDEST = 179.0
FURTHEST = 1e7
"""Degrees of the field of view, and bounding radii, that a view may ask for at most."""

ORBITS: Mapping[str, Mapping[str, float]] = {
    **{
        f"azimuth {azimuth:g}, elevation {elevation:g}": {
            "azimuth": azimuth,
            "elevation": elevation,
        }
        for azimuth in (-360.0, -90.0, 90.0, 360.0)
        for elevation in (-90.0, 0.0, 90.0)
    },
    "narrowest": {"fov": NARROWEST},
    "widest": {"fov": WIDEST},
    "from the middle, widest": {"distance": 0.01, "fov": WIDEST},
    "from the middle, narrowest": {"distance": 0.01, "fov": NARROWEST},
    "a thousand radii away": {"distance": 1e3, "fov": 0.1},
    "ten thousand radii away": {"distance": 1e4, "fov": NARROWEST},
}
"""Views from an orbit, by what differs from STAND."""

SIZES: Mapping[str, tuple[int, int]] = {"one pixel": (1, 1), "a row": (97, 1), "a column": (1, 97)}
"""Pictures, by width and height."""


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    """Of the body, with soft skin, in voxels that are not cubes."""
    with renderer_of(scene_of(make_volume(ramp(body(), 4.0), SPACING), 0.5)) as renderer:
        yield renderer


def hard_views(renderer: Renderer, size: int) -> dict[str, View]:
    """Thirty views of a scene, ``size`` pixels a side but where that is what is hard."""
    scene = renderer.prepared.scene
    usual = square(scene, scene.camera(**STAND), size)
    found = {
        name: square(scene, scene.camera(**{**STAND, **knobs}), size)
        for name, knobs in ORBITS.items()
    }
    for name, (width, height) in SIZES.items():
        found[name] = View(scene.isovalue, scene.camera(**STAND), width=width, height=height)
    points = renderer.gbuffer(usual).points
    on = points[len(points) // 2] * np.array(scene.volume.spacing)
    return found | {name: square(scene, camera, size) for name, camera in eyes(scene, on).items()}


def square(scene: Scene, camera: Camera, size: int) -> View:
    """A square picture of the scene."""
    return View(scene.isovalue, camera, width=size, height=size)


def eyes(scene: Scene, on: np.ndarray) -> dict[str, Camera]:
    """Cameras within the solid, at the point ``on`` of its surface, and on the box; world."""
    volume = scene.volume
    middle = np.array(volume.centre)
    far_corner = np.array(volume.extent)
    within = np.argwhere(volume.voxels == volume.voxels.max())[0][::-1] * np.array(volume.spacing)
    face = middle * (0, 1, 1)
    return {
        "within the solid": looking(within, middle),
        "on the surface, outwards": looking(on, 2.0 * on - middle, 120.0),
        "on the surface, inwards": looking(on, middle, 120.0),
        "on a voxel": looking(np.rint(on / volume.spacing) * volume.spacing, middle, 90.0),
        "on a corner of the box": looking(far_corner, middle, 90.0),
        "on a face of the box, along it": looking(face, face + np.array((0, 1, 0)), 90.0),
        "on a face of the box, inwards": looking(face, middle, 120.0),
        "a million boxes away": far_eye(scene, 1e6 * max(volume.extent)),
        "parallel rays": orthographic(looking(2.0 * far_corner, middle), volume.radius),
        "parallel rays from within": orthographic(looking(within, middle, 120.0), volume.radius),
        "looking away": looking(3.0 * far_corner, 4.0 * far_corner),
    }


def looking(eye: Any, target: Any, fov: float = 40.0) -> Camera:
    """A camera at one point that looks at another, its up at no special angle."""
    (x, y, z), (u, v, w) = (np.asarray(point, np.float64).tolist() for point in (eye, target))
    return Camera((x, y, z), (u, v, w), (0.1, 0.2, 1.0), fov)


def far_eye(scene: Scene, distance: float) -> Camera:
    """A camera so far from the middle of the box, whose field just holds the box."""
    out = np.array((0.36, 0.48, 0.8))
    fov = 2.0 * math.degrees(math.atan(scene.volume.radius / distance))
    return looking(np.array(scene.volume.centre) + distance * out, scene.volume.centre, fov)


@pytest.mark.parametrize("shading", VIEW_SHADINGS)
def test_every_number_is_finite_from_every_hard_view(renderer: Renderer, shading: str) -> None:
    """Light, error, positions, normals, and the weights of what the frame wants baked."""
    for name, view in hard_views(renderer, 16).items():
        frame = renderer.render(View(**{**vars(view), "shading": shading, "samples": 1}))
        assert is_finite(frame), name
        assert np.isfinite(frame.gbuffer.normals(renderer.tiles)).all(), name
        assert all(math.isfinite(demand.weight) for demand in frame.demands), name


def test_hits_lie_on_the_rays_through_the_middles_of_pixels(renderer: Renderer) -> None:
    """To 1e-4 voxels, against rays in extended precision."""
    hits = 0
    for name, view in hard_views(renderer, 32).items():
        gbuffer = renderer.gbuffer(view)
        if len(gbuffer.points):
            assert off_the_ray(view, gbuffer.pixels, gbuffer.points).max() < 1e-4, name
            hits += len(gbuffer.points)
    assert hits > 10_000


def off_the_ray(view: View, pixels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far ``points`` (m, 3), index space, are from the rays through the middles of their
    pixels, in voxels.
    """
    spacing = np.array(SPACING, np.longdouble)
    eye = np.array(view.camera.eye, np.longdouble)
    rays = pixel_rays(view)[pixels]
    away = points * spacing - eye
    along = (away * rays).sum(axis=1) / (rays * rays).sum(axis=1)
    return np.linalg.norm(((away - along[:, None] * rays) / spacing).astype(float), axis=1)


def pixel_rays(view: View) -> np.ndarray:
    """World directions (pixels, 3) through the middles of all pixels, in extended precision."""
    camera = view.camera
    one = np.longdouble(1)
    forward = np.array(camera.target, np.longdouble) - np.array(camera.eye, np.longdouble)
    forward /= np.sqrt((forward**2).sum())
    right = np.cross(forward, np.array(camera.up, np.longdouble))
    right /= np.sqrt((right**2).sum())
    tangent = np.tan(np.deg2rad(one * camera.fov) / 2)
    y, x = np.mgrid[: view.height, : view.width] + one / 2
    u = (x - one * view.width / 2) / (one * view.height / 2)
    v = 1 - y / (one * view.height / 2)
    rays = forward + tangent * (u[..., None] * right + v[..., None] * np.cross(right, forward))
    return rays.reshape(-1, 3)


def test_hits_lie_in_the_box_and_on_the_surface(renderer: Renderer) -> None:
    """To 1e-5 voxels, as the steepest slope has it."""
    volume = renderer.prepared.scene.volume
    surface = surface_in(volume, renderer.prepared.scene.isovalue)
    steepest = max(float(abs(np.diff(volume.voxels, axis=axis)).max()) for axis in range(3))
    for name, view in hard_views(renderer, 32).items():
        points = renderer.gbuffer(view).points
        assert np.maximum(-points, points - np.subtract(volume.size, 1)).max(initial=0.0) <= 1e-5, (
            name
        )
        off = abs(surface.height(points.astype(np.float64))).max(initial=0.0)
        assert off / steepest <= 1e-5, name


@pytest.mark.parametrize("eye", ["a million boxes away", "as far as a view may ask for"])
def test_far_eyes_see_what_parallel_rays_meet(renderer: Renderer, eye: str) -> None:
    """But where the surface is seen at a grazing angle."""
    scene = renderer.prepared.scene
    volume = scene.volume
    step = np.array(SPACING)
    if eye == "a million boxes away":
        distance = 1e6 * max(volume.extent)
    else:
        distance = FURTHEST * volume.radius
    view = square(scene, far_eye(scene, distance), 48)
    gbuffer = renderer.gbuffer(view)
    (right, up, forward) = view.camera.basis()
    aside = pixel_rays(view)[gbuffer.pixels] @ np.stack([right, up], axis=1) * distance
    starts = (
        np.array(volume.centre)
        + (aside @ np.stack([right, up])).astype(float)
        - 2.0 * volume.radius * forward
    )
    t, _ = surface_in(volume, scene.isovalue).cast(
        starts / step, np.broadcast_to(forward / step, starts.shape)
    )
    met = starts / step + np.where(np.isfinite(t), t, 0.0)[:, None] * (forward / step)
    judged = np.isfinite(t) & (gbuffer.normals(renderer.tiles) @ forward < -0.4)
    assert judged.sum() > 200
    assert abs(met - gbuffer.points)[judged].max() < 1e-4


@pytest.mark.parametrize(
    ("one", "other"), [(0.0, 360.0), (0.0, -360.0), (90.0, -270.0), (-90.0, 270.0)]
)
def test_a_full_turn_of_the_camera_changes_no_hit(
    renderer: Renderer, one: float, other: float
) -> None:
    scene = renderer.prepared.scene
    cameras = (scene.camera(**{**STAND, "azimuth": azimuth}) for azimuth in (one, other))
    a, b = (renderer.gbuffer(square(scene, camera, 48)) for camera in cameras)
    assert np.array_equal(a.pixels, b.pixels)
    assert abs(a.points - b.points).max() < 1e-4


def test_light_is_baked_for_every_pixel_of_every_hard_view(renderer: Renderer) -> None:
    """After a few paths from each texel; an open body has no dark place."""
    pixels = 0
    for name, view in hard_views(renderer, 6).items():
        bake = ViewBake(renderer, view)
        if not len(bake.texels):
            continue
        bake.grow(FIRST_LEVEL)
        frame = bake.frame()
        on = frame.state > 0
        assert (frame.state[on] >= CONVERGING).all(), name
        assert (frame.radiance[on] > 0.0).all(), name
        assert is_finite(frame), name
        pixels += int(on.sum())
    assert pixels > 300


@pytest.fixture(scope="module")
def orbital() -> Scene:
    return load_scene("demo:orbital")


def camera_in(scene: Scene, query: str) -> Camera:
    """The camera that a query asks for, its pairs apart by blanks; ViewError where it is
    refused.
    """
    pairs = (pair.partition("=") for pair in query.split())
    return camera_of(scene, read(ViewParams, ((name, value) for name, _, value in pairs)))


@pytest.mark.parametrize(
    "query",
    [f"fov={NARROWEST}", f"fov={WIDEST}", f"distance={FURTHEST}", "distance=0.01", "azimuth=-360"],
)
def test_the_ends_of_the_ranges_of_views_may_be_asked_for(orbital: Scene, query: str) -> None:
    assert camera_in(orbital, query)
