"""Frames put together from what their steps have made, and the panorama, a picture of the light around a scene."""

from functools import cache

import numpy as np

from isogi_core.frame.film import LEVELS, tone_table
from isogi_core.frame.frame import Frame, PictureState, Quality
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight, version_of
from isogi_core.frame.projected_texels import ProjectedReading, Projection
from isogi_core.frame.rays.control_pixels import expected_error
from isogi_core.frame.texel_reading import Lacking, Reading
from isogi_core.frame.tiles import Stopwatch
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.tracing.camera import read_values
from isogi_core.kernels.transport.colours import Colours, fill_albedos
from isogi_core.kernels.transport.lights import DIRECTIONAL
from isogi_core.model.colours import linear_of
from isogi_core.model.environment import LUMINANCE_WEIGHTS, Environment, Lamps, pixel_directions, resample, solid_angles
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene

PAPER = 0.8
"""What the greatest value on the face of a window reflects of the light that a surface turned to it has."""


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
    """The frame of a view from its framebuffer, from the texels and their reading where it was made of any, and from
    what is known of a picture that was ``checked``. ``rays`` names those that it cast besides. Faces of a window are
    painted into the framebuffer.
    """
    scene = light.spec.prepared.scene
    if len(gbuffer.faces.pixels):
        labelled = scene.surfaces.colours is not None and bool(scene.surfaces.colours.scale.labels)
        paint_faces(gbuffer, scene, framebuffer, light.spec.prepared.colours if labelled else None)
    lacking = Lacking(texels, reading, framebuffer) if texels and reading else None
    projection = Projection(texels, reading, framebuffer) if texels and isinstance(reading, ProjectedReading) else None
    needed, short = (len(lacking.texels.chunks), int(lacking.reading.short.sum())) if lacking else (0, 0)
    expected = expected_error(scene, gbuffer.isovalue) if texels and light.view.shading == "gi" else 0.0
    read = (reading.version if reading else b"") + (checked.version if checked else b"") + rays
    read += repr(light.view.window).encode() if light.view.window else b""
    read += repr(light.view.glow).encode() if light.view.glow != 1.0 else b""
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
    """The values of a volume's file at ``points`` (n, 3) float32 in index space, within its box; (n,) float64."""
    voxels = np.empty(len(points), np.float32)
    read_values(volume.voxels, points, voxels)
    return np.asarray(volume.offset + volume.scale * voxels.astype(np.float64))


def paint_faces(gbuffer: GBuffer, scene: Scene, framebuffer: Framebuffer, labels: Colours | None = None) -> None:
    """Show the volume's values where a window opens what is solid: greys over the core of its range, evenly lit.

    In a segmentation these are shades of the colours of its ``labels``.
    """
    faces, volume = gbuffer.faces, scene.volume
    values = values_at(volume, faces.points)
    share = (values - volume.core[0]) / max(volume.core[1] - volume.core[0], np.finfo(np.float64).tiny)
    light = np.interp(255.0 * share, np.arange(256), linear_greys()) * PAPER / scene.default_exposure
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
"""How bright the middle of the light is shown, before the tone curve: twice Reinhard's, for a picture this small."""

DARKEST_SHARE = 1e-4
"""Light darker than this share of the mean counts as this much where the middle is sought: black has no logarithm."""

GLARE, GLARE_REACH = 0.02, 16
"""The share of light that strays around what is bright, as in an eye, and the part of the picture's width, one in
GLARE_REACH, over which it does, in steps of a pixel: a sun is smaller than a pixel, and would hardly be seen."""

MARK_RADIUS = 0.05
"""Radius of the mark of a directional light, radians."""


def paint_panorama(environment: Environment, lamps: Lamps, width: int, turn: np.ndarray | None = None) -> np.ndarray:
    """The picture (width // 2, width, 3) uint8 sRGB of what comes from infinitely far, unturned.

    Its grid is that of a probe: the top row is +z, column 0 starts at azimuth 0. Directional lights are discs in
    their own colour. Lamps that stand in the scene are in no direction, and are not shown. Where the light is that of
    a volume's box, ``turn`` (3, 3) is the box's rotation in the world, which is shown.
    """
    overview = environment if turn is None else environment.turned(turn.T)
    picture = tone(glare(resample(overview.overview, width // 2, width)))
    directions = pixel_directions(*picture.shape[:2]) @ (np.eye(3) if turn is None else turn)
    far = lamps.arrays.kinds == DIRECTIONAL
    for towards, colour in zip(lamps.arrays.places[far], lamps.arrays.colours[far], strict=True):
        if colour.any():
            away = np.arccos(np.clip(directions @ towards, -1.0, 1.0))
            picture[away <= max(MARK_RADIUS, away.min())] = colour / colour.max()
    return np.asarray(tone_table()[np.rint(picture * (LEVELS - 1)).astype(np.int64)])


def glare(radiance: np.ndarray) -> np.ndarray:
    """A lat-long image (h, w, 3) of radiance with some of its light spread by binomial steps; see GLARE."""
    stray = radiance
    for _ in range(radiance.shape[1] // GLARE_REACH):
        across = (np.roll(stray, 1, axis=1) + 2.0 * stray + np.roll(stray, -1, axis=1)) / 4.0
        padded = np.pad(across, ((1, 1), (0, 0), (0, 0)), "edge")
        stray = (padded[:-2] + 2.0 * across + padded[2:]) / 4.0
    return np.asarray(radiance + GLARE * stray)


def tone(radiance: np.ndarray) -> np.ndarray:
    """A lat-long image (h, w, 3) of radiance brought into [0, 1], float64: its middle to MIDDLE_BRIGHTNESS, and nothing
    burns out.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002, eqs. 1 to 3, with
    the mean logarithm over the sphere.
    """
    luminance = radiance @ LUMINANCE_WEIGHTS
    shares = solid_angles(*luminance.shape) / (4.0 * np.pi)
    mean = float((shares * luminance).sum())
    if mean <= 0.0:
        return np.zeros_like(radiance)
    middle = np.exp((shares * np.log(np.maximum(luminance, DARKEST_SHARE * mean))).sum())
    factor = MIDDLE_BRIGHTNESS / (middle + MIDDLE_BRIGHTNESS * luminance)
    return np.asarray(np.minimum(radiance * factor[..., None], 1.0))
