"""Cases of extreme settings: albedo, bounces, isovalues, lattices, offsets, exposures, target errors at their ends."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.lighting import ball, lit, solid
from benchmarks.stability.pictures import faults
from benchmarks.stability.shapes import grid
from benchmarks.stability.stage import CONSTANT, frame_of, view_of
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.kernels.planes import FINAL
from isogi_core.model.scene import Scene
from isogi_core.model.volume import make_volume

GROUP = "extreme settings"

ALMOST = 1.0 - 1e-7

FURNACES: tuple[Mapping[str, Any], ...] = (
    {"albedo": 1.0},
    {"albedo": ALMOST},
    {"albedo": [1.0, 0.0, 0.0]},
    {"lattice": 0.125},
    {"lattice": 4.0},
    {"offset": 2.0},
    {"normals": "gradient"},
    {"target_error": 1.0},
    {"precision": "single"},
)
"""Settings under which a white body in even light is not to be seen: its radiance is that of the light."""


CREASE = """\
A texel in a crease may be nearly shut in by its own isosurface: from right on the surface its paths take more bounces \
to come out than there are, and pixels beside it are too dark. Paths from pixels lose nothing, and with the usual \
offset no texel did."""


@case(GROUP, "white furnace", "a white body in light of 1 has the radiance 1, whatever else is set", 0.005, "relative")
def white_furnace(size: Size) -> Outcome:
    """The mean over the pixels; of the red body, in red. Single pixels may be off by more, see CREASE."""
    seen = [furnace(settings, size) for settings in FURNACES]
    off = [abs(float(pixels.mean()) - 1.0) for pixels in seen]
    farthest = max(float(np.abs(pixels - 1.0).max()) for pixels in seen)
    worst = FURNACES[int(np.argmax(off))]
    return Outcome(max(off), f"{len(off)} settings, worst at {worst}, the farthest pixel off by {farthest:.1%}")


@case(GROUP, "white furnace, no offset", "the same where rays start right on the surface", 0.5, "relative", CREASE)
def no_offset(size: Size) -> Outcome:
    """The farthest pixel."""
    farthest = float(np.abs(furnace({"offset": 0.0}, size) - 1.0).max())
    return Outcome(farthest, "of a bored ball, one beside it and the plate that they touch")


def furnace(settings: Mapping[str, Any], size: Size) -> np.ndarray:
    """The radiance of the surface's pixels, with as many bounces as it takes to come out of most creases."""
    frame = shown(lit(solid(), 0.5, CONSTANT, **{"albedo": 1.0, "bounces": 1000, **settings}), size, 64)
    return np.asarray(frame.radiance[frame.state > 0, 0])


def shown(scene: Scene, size: Size, samples: int | None = None) -> Frame:
    """The baked frame of a scene."""
    return frame_of(scene, view_of(scene, size.pick(16, 64)), samples)


@case(GROUP, "black surfaces", "albedo 0 is black, and so is each channel that has it", 0, "radiance")
def black_surfaces(size: Size) -> Outcome:
    """Black in all channels, and red alone."""
    black, red = (shown(lit(solid(), 0.5, CONSTANT, albedo=albedo), size, 16) for albedo in (0.0, [1.0, 0.0, 0.0]))
    return Outcome(float(max(black.radiance.max(), red.radiance[..., 1:].max())), "two albedos")


@case(GROUP, "closed cavity", "k bounces add up to 1 + R + … + R^k, and 1000 bounces to 1/(1 - R)", 0.01, "relative")
def closed_cavity(size: Size) -> Outcome:
    """A hollow ball around a lamp, seen from within: its light beside that without bounces."""
    cases = ((0.5, 1), (0.5, 4), (1.0, 8), (0.9, 1000), (0.99, 1000))[: size.pick(4, 5)]
    off = [series_error(*told, size) for told in cases]
    return Outcome(max(off), "worst at R = {:g} and {} bounces".format(*cases[int(np.argmax(off))]))


def series_error(albedo: float, bounces: int, size: Size) -> float:
    """How far the light of so many bounces, beside that of none, is from Σ R^j for j = 0 … bounces."""
    series = math.fsum(albedo**j for j in range(bounces + 1))
    return abs(cavity_light(albedo, bounces, size) / cavity_light(albedo, 0, size) / series - 1.0)


def cavity_light(albedo: float, bounces: int, size: Size) -> float:
    """Mean radiance within a hollow ball around a lamp."""
    x, y, z = grid(32, 32, 32)
    hollow = make_volume(np.sqrt(x**2 + y**2 + z**2), name="hollow")
    lamp = {"type": "point", "position": list(hollow.centre), "intensity": 1.0}
    scene = lit(hollow, 12.0, lamp, albedo=albedo, bounces=bounces)
    frame = frame_of(scene, view_of(scene, size.pick(8, 16), distance=0.1, fov=90.0), size.pick(128, 256))
    return float(frame.radiance[frame.state > 0].mean())


@case(GROUP, "isovalues at the ends", "frames at and just inside the ends of the range are finite", 0, "numbers")
def isovalues_at_the_ends(size: Size) -> Outcome:
    """Of a body, a ball whose surface meets the box, and a constant volume."""
    wrong, frames = 0, 0
    for volume in (solid(), ball(), make_volume(np.full((8, 8, 8), 3.0))):
        for isovalue in ends(*volume.value_range):
            wrong += faults(shown(lit(volume, isovalue, CONSTANT, target_error=0.1), size, 16))
            frames += 1
    return Outcome(wrong, f"of {frames} frames")


def ends(low: float, high: float) -> tuple[float, ...]:
    """Both ends of a range, and the next numbers within."""
    return low, math.nextafter(low, high), math.nextafter(high, low), high


@case(
    GROUP, "nothing above the maximum", "a frame at the greatest value is empty, final and without error", 0, "pixels"
)
def nothing_above_the_maximum(size: Size) -> Outcome:
    """What is solid exceeds the isovalue; a constant volume is nowhere solid."""
    shown_pixels = 0
    for volume in (solid(), ball(), make_volume(np.full((8, 8, 8), 3.0))):
        frame = shown(lit(volume, volume.value_range[1], CONSTANT), size, 16)
        shown_pixels += frame.surface + frame.provisional + (frame.estimated_error != 0.0)
    return Outcome(shown_pixels, "3 volumes")


@case(GROUP, "one isovalue", "a range of zero width bakes and shows its one isovalue as a wide one does", 0, "relative")
def one_isovalue(size: Size) -> Outcome:
    """The range says what may be asked for, and not how it looks; texels that show it are counted all the same."""
    wide = lit(solid(), 0.5, CONSTANT)
    narrow = replace(wide, isovalues=(0.5, 0.5))
    off = float(np.abs(shown(wide, size, 16).radiance - shown(narrow, size, 16).radiance).max())
    return Outcome(off if 0 < narrow.texels.shown < wide.texels.shown else math.inf)


@case(GROUP, "exposure", "brighter light is never darker in the picture, at any exposure", 0, "grey levels")
def exposure(_: Size) -> Outcome:
    """A picture of every strength of light from 0 to 3e38, at exposures 0 and 1e-30 to 1e30: the largest step down."""
    strengths = np.concatenate([[0.0], np.geomspace(1e-38, 3e38, 1023)]).astype(np.float32)
    exposures = (0.0, 1e-30, 1e-9, 1.0, 1e9, 1e30)
    frame = shown(lit(ball(), 0.0, CONSTANT), Size.QUICK, 16)
    pictures = [developed(frame, strengths, exposure).astype(int) for exposure in exposures]
    falls = max(int((picture[:-1] - picture[1:]).max()) for picture in pictures)
    return Outcome(max(falls, int(pictures[0].max())), f"{len(strengths)} strengths at {len(exposures)} exposures")


def developed(frame: Frame, strengths: np.ndarray, exposure: float) -> np.ndarray:
    """Grey levels of a frame that has light of these strengths."""
    light = np.repeat(strengths[:, None, None], 3, axis=-1)
    return develop(replace(frame, radiance=light, state=np.full((len(strengths), 1), FINAL, np.uint8)), exposure)[
        :, 0, 0
    ]


@case(GROUP, "target errors", "light that is final is as good as the target, from 1 down to 0.002", 1, "targets")
def target_errors(size: Size) -> Outcome:
    """A ball in even light: the root mean square of what it is off by, over the target, and the same as told."""
    worst = 0.0
    targets: tuple[float, ...] = (1.0, 0.1, 0.02, 0.002)
    for target in targets[: size.pick(3, 4)]:
        scene = lit(ball(), 0.0, CONSTANT, target_error=target, bounces=0)
        frame = shown(scene, size)
        light = frame.radiance[frame.state > 0, 0] / scene.albedo[0]
        worst = max(worst, math.sqrt(float(((light - 1.0) ** 2).mean())) / target, frame.estimated_error / target)
    return Outcome(worst, "of light and of told errors")
