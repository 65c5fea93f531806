"""The frame of a view, put together from what its steps have made."""

from isogi_core.frame.control_pixels import expected_error
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight, version_of
from isogi_core.frame.picture_check import PictureCheck
from isogi_core.frame.projected_texels import ProjectedReading, Projection
from isogi_core.frame.texel_reading import Lacking, Reading
from isogi_core.frame.tiles import Stopwatch
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import Framebuffer


def frame_of(
    gbuffer: GBuffer,
    light: RotatedLight,
    framebuffer: Framebuffer,
    watch: Stopwatch,
    texels: ViewTexels | None = None,
    reading: Reading | None = None,
    check: PictureCheck | None = None,
    shine: bytes = b"",
) -> Frame:
    """The frame of a view from its framebuffer, from the texels and their reading where it was made of any, and from
    the ``check`` of its picture where there is one. The rays of its ``shine`` are named by that.
    """
    lacking = Lacking(texels, reading, framebuffer) if texels and reading else None
    projection = Projection(texels, reading, framebuffer) if texels and isinstance(reading, ProjectedReading) else None
    needed, short = (len(lacking.texels.chunks), int(lacking.reading.short.sum())) if lacking else (0, 0)
    read = (reading.version if reading else b"") + (check.version if check else b"") + shine
    return Frame(
        view=light.view,
        radiance=framebuffer.radiance.reshape(*gbuffer.shape, 3),
        state=framebuffer.state.reshape(gbuffer.shape),
        error=framebuffer.error.reshape(gbuffer.shape),
        gbuffer=gbuffer,
        chunks_needed=needed,
        chunks_final=needed - short,
        lacking=lacking,
        version=version_of(light, read),
        seconds=watch.seconds,
        projection=projection,
        target=check.target if check else None,
        controls=check.controls if check else None,
        uncertainty=check.uncertainty if check else None,
        given_up=check.ended if check else False,
        own=len(check.own.places) if check else 0,
        expected=expected_error(light.spec.prepared.scene, gbuffer.isovalue) if light.view.shading == "gi" else 0.0,
    )
