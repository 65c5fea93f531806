"""Put frames together from the results of their steps, and paint the faces of windows."""

from functools import cache

import numpy as np

from isogi_core.frame.frame import Frame, Quality
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import version_of
from isogi_core.frame.projected_texels import ProjectedReading, Projection
from isogi_core.frame.rays.control_pixels import expected_error, planned_error
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_reading import Lacking, Reading
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.tracing.camera import read_values
from isogi_core.kernels.transport.colours import Colours, fill_albedos
from isogi_core.model.colours import linear_of
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene

PAPER = 0.8
"""Reflectance of the largest value on the face of a window, under the light that a surface
turned to it has.
"""


def frame_of(
    shot: Shot,
    framebuffer: Framebuffer,
    texels: ViewTexels | None = None,
    reading: Reading | None = None,
    checked: PictureState | None = None,
    rays: bytes = b"",
) -> Frame:
    """Make the frame of a ``shot`` from its framebuffer, and paint the faces of its window into it.

    ``texels`` and their ``reading`` are those that it was made from, if any; ``checked`` is the
    state of its picture's check; ``rays`` names the rays of shine, or through glass, that it shows.
    """
    gbuffer = shot.gbuffer
    view = shot.view
    scene = shot.scene
    # Faces of a window show the values of the volume, or the colours of its labels.
    if len(gbuffer.faces.pixels):
        colours = scene.surfaces.colours
        if colours is not None and colours.scale.labels:
            paint_faces(gbuffer, scene, framebuffer, shot.prepared.colours)
        else:
            paint_faces(gbuffer, scene, framebuffer)

    # Texels tell how much light the picture still lacks, and how far they are projected.
    lacking = None
    projection = None
    needed = 0
    short = 0
    by_paths = checked is not None and checked.goes_without_texels
    # A picture by paths of its pixels lacks no light of texels, even if it shows some meanwhile.
    if texels and reading and not by_paths:
        lacking = Lacking(texels, reading, framebuffer)
        needed = len(texels.chunks)
        short = int(reading.short.sum())
        if isinstance(reading, ProjectedReading):
            projection = Projection(texels, reading, framebuffer)
    expected = 0.0
    if texels and view.shading == "gi":
        expected = expected_error(scene, gbuffer.isovalue)
    elif checked is not None and checked.transferred:
        expected = planned_error(scene)

    # Name all that the picture depends on and that ``version_of`` leaves out: the light that was
    # read, and window and glow, which are no part of a view's repr.
    read = b""
    if reading:
        read += reading.version
    if checked:
        read += checked.version
    read += rays
    if view.window:
        read += repr(view.window).encode()
    if view.glow != 1.0:
        read += repr(view.glow).encode()
    return Frame(
        view=view,
        radiance=framebuffer.radiance.reshape(*gbuffer.shape, 3),
        state=framebuffer.state.reshape(gbuffer.shape),
        error=framebuffer.error.reshape(gbuffer.shape),
        gbuffer=gbuffer,
        version=version_of(shot.light, read),
        seconds=shot.watch.seconds,
        quality=Quality(lacking, (needed, needed - short), projection, checked, rays, expected),
    )


@cache
def linear_greys() -> np.ndarray:
    """Return the linear light of 256 even steps of grey, float64."""
    return np.array([linear_of(code / 255.0) for code in range(256)])


def values_at(volume: Volume, points: np.ndarray) -> np.ndarray:
    """Return the values of a volume at ``points`` (n, 3) float32 in index space, within its box:
    trilinear between voxels, in the file's units; (n,) float64.
    """
    voxels = np.empty(len(points), np.float32)
    read_values(volume.voxels, points, voxels)
    return np.asarray(volume.offset + volume.scale * voxels.astype(np.float64))


def paint_faces(
    gbuffer: GBuffer, scene: Scene, framebuffer: Framebuffer, labels: Colours | None = None
) -> None:
    """Paint the faces that a window cuts into the solid: the volume's values as greys over the
    core of their range, evenly lit. In a segmentation they are shades of the colours of its
    ``labels``.
    """
    faces = gbuffer.faces
    volume = scene.volume
    values = values_at(volume, faces.points)
    low, high = volume.core
    share = (values - low) / max(high - low, np.finfo(np.float64).tiny)
    greys = np.interp(255.0 * share, np.arange(256), linear_greys())
    # Divide by the exposure, so that values look the same at any brightness of the light.
    light = greys * PAPER / scene.default_exposure
    painted = np.repeat(light[:, None], 3, axis=1)
    if labels is not None:
        albedos = np.empty((len(light), 3), np.float32)
        fill_albedos(labels, faces.points, albedos)
        painted *= albedos / PAPER
    framebuffer.radiance[faces.pixels] = painted
    framebuffer.state[faces.pixels] = FINAL
    framebuffer.error[faces.pixels] = 0.0
