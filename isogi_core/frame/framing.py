"""Frames put together from what their steps have made, points read from them, and the panorama
around a scene.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from isogi_core.files.vector import Vector, triple
from isogi_core.frame.film import LEVELS, tone_table
from isogi_core.frame.frame import STATE_CODES, Frame, PictureState, Quality
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight, version_of
from isogi_core.frame.projected_texels import ProjectedReading, Projection
from isogi_core.frame.rays.control_pixels import expected_error
from isogi_core.frame.texel_reading import Lacking, Reading
from isogi_core.frame.tiles import Stopwatch
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.local_models import find_normals
from isogi_core.kernels.tracing.camera import read_values
from isogi_core.kernels.transport.colours import Colours, fill_albedos
from isogi_core.kernels.transport.lights import DIRECTIONAL
from isogi_core.model.colours import linear_of
from isogi_core.model.environment import (
    LUMINANCE_WEIGHTS,
    Environment,
    Lamps,
    pixel_directions,
    resample,
    solid_angles,
)
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import surfaces_of

PAPER = 0.8
"""What the greatest value on the face of a window reflects of the light that a surface turned to it
has.
"""


def frame_of(
    gbuffer: GBuffer,
    light: RotatedLight,
    framebuffer: Framebuffer,
    watch: Stopwatch,
    texels: ViewTexels | None = None,
    reading: Reading | None = None,
    checked: PictureState | None = None,
    rays: bytes = b"",
) -> Frame:
    """The frame of a view from its framebuffer, from the texels and their reading where it was made
    of any, and from what is known of a picture that was ``checked``. ``rays`` names those that it
    cast besides. Faces of a window are painted into the framebuffer.
    """
    scene = light.spec.prepared.scene
    if len(gbuffer.faces.pixels):
        labelled = scene.surfaces.colours is not None and bool(scene.surfaces.colours.scale.labels)
        paint_faces(gbuffer, scene, framebuffer, light.spec.prepared.colours if labelled else None)
    if texels and reading:
        lacking = Lacking(texels, reading, framebuffer)
    else:
        lacking = None
    if texels and isinstance(reading, ProjectedReading):
        projection = Projection(texels, reading, framebuffer)
    else:
        projection = None
    if lacking:
        needed = len(lacking.texels.chunks)
        short = int(lacking.reading.short.sum())
    else:
        needed = 0
        short = 0
    if texels and light.view.shading == "gi":
        expected = expected_error(scene, gbuffer.isovalue)
    else:
        expected = 0.0
    read = (reading.version if reading else b"") + (checked.version if checked else b"") + rays
    if light.view.window:
        read += repr(light.view.window).encode()
    else:
        read += b""
    if light.view.glow != 1.0:
        read += repr(light.view.glow).encode()
    else:
        read += b""
    return Frame(
        view=light.view,
        radiance=framebuffer.radiance.reshape(*gbuffer.shape, 3),
        state=framebuffer.state.reshape(gbuffer.shape),
        error=framebuffer.error.reshape(gbuffer.shape),
        gbuffer=gbuffer,
        version=version_of(light, read),
        seconds=watch.seconds,
        quality=Quality(lacking, (needed, needed - short), projection, checked, rays, expected),
    )


@cache
def linear_greys() -> np.ndarray:
    """Linear light of 256 even steps of grey, float64."""
    return np.array([linear_of(code / 255.0) for code in range(256)])


def values_at(volume: Volume, points: np.ndarray) -> np.ndarray:
    """The values of a volume's file at ``points`` (n, 3) float32 in index space, within its box;
    (n,) float64.
    """
    voxels = np.empty(len(points), np.float32)
    read_values(volume.voxels, points, voxels)
    return np.asarray(volume.offset + volume.scale * voxels.astype(np.float64))


def paint_faces(
    gbuffer: GBuffer, scene: Scene, framebuffer: Framebuffer, labels: Colours | None = None
) -> None:
    """Show the volume's values where a window opens what is solid: greys over the core of its
    range, evenly lit.

    In a segmentation these are shades of the colours of its ``labels``.
    """
    faces = gbuffer.faces
    volume = scene.volume
    values = values_at(volume, faces.points)
    share = (values - volume.core[0]) / max(
        volume.core[1] - volume.core[0], np.finfo(np.float64).tiny
    )
    light = (
        np.interp(255.0 * share, np.arange(256), linear_greys()) * PAPER / scene.default_exposure
    )
    painted = np.repeat(light[:, None], 3, axis=1)
    if labels is not None:
        albedos = np.empty((len(light), 3), np.float32)
        fill_albedos(labels, faces.points, albedos)
        painted *= albedos / PAPER
    framebuffer.radiance[faces.pixels] = painted
    framebuffer.state[faces.pixels] = FINAL
    framebuffer.error[faces.pixels] = 0.0


PANORAMA_FORMAT = 1
"""Counts up when the same light makes another picture."""

MIDDLE_BRIGHTNESS = 0.36
"""How bright the middle of the light is shown, before the tone curve: twice Reinhard's, for a
picture this small.
"""

DARKEST_SHARE = 1e-4
"""Light darker than this share of the mean counts as this much where the middle is sought: black
has no logarithm.
"""

GLARE = 0.02
GLARE_REACH = 16
"""The share of light that strays around what is bright, as in an eye, and the part of the picture's
width, one in GLARE_REACH, over which it does, in steps of a pixel: a sun is smaller than a pixel,
and would hardly be seen."""

MARK_RADIUS = 0.05
"""Radius of the mark of a directional light, radians."""


def paint_panorama(
    environment: Environment, lamps: Lamps, width: int, turn: np.ndarray | None = None
) -> np.ndarray:
    """The picture (width // 2, width, 3) uint8 sRGB of what comes from infinitely far, unturned.

    Its grid is that of a probe: the top row is +z, column 0 starts at azimuth 0. Directional lights
    are discs in their own colour. Lamps that stand in the scene are in no direction, and are not
    shown. Where the light is that of a volume's box, ``turn`` (3, 3) is the box's rotation in the
    world, which is shown.
    """
    if turn is None:
        overview = environment
    else:
        overview = environment.turned(turn.T)
    picture = tone(glare(resample(overview.overview, width // 2, width)))
    directions = pixel_directions(*picture.shape[:2]) @ (np.eye(3) if turn is None else turn)
    far = lamps.arrays.kinds == DIRECTIONAL
    for towards, colour in zip(lamps.arrays.places[far], lamps.arrays.colours[far], strict=True):
        if colour.any():
            away = np.arccos(np.clip(directions @ towards, -1.0, 1.0))
            picture[away <= max(MARK_RADIUS, away.min())] = colour / colour.max()
    return np.asarray(tone_table()[np.rint(picture * (LEVELS - 1)).astype(np.int64)])


def glare(radiance: np.ndarray) -> np.ndarray:
    """A lat-long image (h, w, 3) of radiance with some of its light spread by binomial steps; see
    GLARE.
    """
    stray = radiance
    for _ in range(radiance.shape[1] // GLARE_REACH):
        across = (np.roll(stray, 1, axis=1) + 2.0 * stray + np.roll(stray, -1, axis=1)) / 4.0
        padded = np.pad(across, ((1, 1), (0, 0), (0, 0)), "edge")
        stray = (padded[:-2] + 2.0 * across + padded[2:]) / 4.0
    return np.asarray(radiance + GLARE * stray)


def tone(radiance: np.ndarray) -> np.ndarray:
    """A lat-long image (h, w, 3) of radiance brought into [0, 1], float64: its middle to
    MIDDLE_BRIGHTNESS, and nothing burns out.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002,
    eqs. 1 to 3, with the mean logarithm over the sphere.
    """
    luminance = radiance @ LUMINANCE_WEIGHTS
    shares = solid_angles(*luminance.shape) / (4.0 * np.pi)
    mean = float((shares * luminance).sum())
    if mean <= 0.0:
        return np.zeros_like(radiance)
    middle = np.exp((shares * np.log(np.maximum(luminance, DARKEST_SHARE * mean))).sum())
    factor = MIDDLE_BRIGHTNESS / (middle + MIDDLE_BRIGHTNESS * luminance)
    return np.asarray(np.minimum(radiance * factor[..., None], 1.0))


@dataclass(frozen=True)
class SurfacePoint:
    """What one pixel shows: ``position`` and outward unit ``normal``, world, and the ``voxel``
    indices there, x first.

    ``value`` is the volume's there, in the units of its file: the isovalue, or another where a
    window shows a face. On a wall it is None, and ``wall`` its number. ``radiance`` is linear RGB,
    ``state`` one of STATE_CODES, and ``error`` the relative error of the pixel, whatever its
    causes.
    """

    position: Vector
    normal: Vector
    voxel: Vector
    value: float | None
    wall: int | None
    radiance: Vector
    state: str
    error: float


def point_at(frame: Frame, column: int, row: int, scene: Scene) -> SurfacePoint | None:
    """What the pixel in a ``column`` and a ``row`` of a ``frame`` of a ``scene`` shows; None where
    nothing is.
    """
    gbuffer = frame.gbuffer
    pixel = np.uint32(row * frame.state.shape[1] + column)
    wall = None
    value = None
    if (place := place_of(gbuffer.pixels, pixel)) is not None:
        index = gbuffer.points[place]
        normal = surface_normal(frame, place)
        value = isovalue_at(frame, place, scene)
    elif (place := place_of(gbuffer.walls.pixels, pixel)) is not None:
        index = gbuffer.walls.points[place]
        wall = int(gbuffer.walls.numbers[place])
        normal = wall_normal(frame, index, scene.lighting.room.edges[wall])
    elif (place := place_of(gbuffer.faces.pixels, pixel)) is not None:
        index = gbuffer.faces.points[place]
        normal = face_normal(frame, index)
        value = float(values_at(scene.volume, index[None])[0])
    else:
        return None
    orientation = frame.view.orientation
    return SurfacePoint(
        position=triple(orientation.to_world(index.astype(np.float64) * gbuffer.spacing)),
        normal=triple(orientation.matrix @ normal),
        voxel=triple(index),
        value=value,
        wall=wall,
        radiance=triple(frame.radiance[row, column]),
        state=next(
            name for name, state in STATE_CODES.items() if state == frame.state[row, column]
        ),
        error=float(frame.total_error[row, column]),
    )


def isovalue_at(frame: Frame, place: int, scene: Scene) -> float:
    """The isovalue of what is in front at a ``place`` of the G-buffer: that of the view, or of a
    pinned surface.
    """
    shown = frame.view.isovalue
    if not scene.surfaces.pinned:
        return shown
    value = float(values_at(scene.volume, frame.gbuffer.points[place : place + 1])[0])
    return min(
        (each.isovalue for each in surfaces_of(scene, shown)), key=lambda level: abs(level - value)
    )


def place_of(pixels: np.ndarray, pixel: np.uint32) -> int | None:
    """Where a ``pixel`` is among ascending ``pixels``; None where it is not."""
    place = int(np.searchsorted(pixels, pixel))
    if place < len(pixels) and pixels[place] == pixel:
        return place
    return None


def face_normal(frame: Frame, index: np.ndarray) -> np.ndarray:
    """The normal, in the volume's box, of the plane of the frame's window that is nearest to a
    point: towards the eye from what is left.
    """
    if frame.view.window:
        planes = np.array(frame.view.window.planes)
    else:
        planes = np.empty((0, 4))
    heights = planes[:, :3] @ (index * frame.gbuffer.spacing) + planes[:, 3]
    return np.asarray(-planes[np.abs(heights).argmin(), :3])


def surface_normal(frame: Frame, place: int) -> np.ndarray:
    """The normal of the isosurface, in the volume's box, at a ``place`` of the G-buffer; (3,)
    float64.
    """
    gbuffer = frame.gbuffer
    normals = np.empty((1, 3), np.float32)
    find_normals(gbuffer.surface.field, gbuffer.points[place : place + 1], gbuffer.eye, normals)
    return normals[0].astype(np.float64)


def wall_normal(frame: Frame, index: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The normal, in the volume's box, of the side of a wall with these ``edges`` (2, 3) that the
    camera sees.
    """
    normal = np.cross(*edges)
    towards = np.subtract(frame.gbuffer.eye, index) * frame.gbuffer.spacing
    return np.asarray(np.copysign(1.0, normal @ towards) * normal / np.linalg.norm(normal))
