"""Cases of stiff fields: numbers that are finite, light where there is light, and how far off it is."""

from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import faults
from benchmarks.stability.shapes import ball, grid, ramp
from benchmarks.stability.specimen import SPECIMENS, volumes
from benchmarks.stability.stage import frame_of, renderer_of, scene_of, scenes_of, view_of
from benchmarks.stability.stiff_volumes import GROUP
from isogi_core.model.volume import make_volume
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import FAR, luminance

DARK = 0.5
"""Share of its light that a pixel lacks where it counts as dark."""

TARGET = 0.02
"""The relative error that light is baked to, as by default."""

MOST = {
    "mask": 2.5 * TARGET,
    "mask of bytes": 2.5 * TARGET,
    "ramp of a voxel": 2.0 * TARGET,
    "terraces": 2.0 * TARGET,
    "metal in a scan": 2.0 * TARGET,
    "gradients apart by 1e6": 2.0 * TARGET,
}
"""The error of each specimen's light at most: as much again as the target, as texels are in other places than pixels;

of masks half as much more, as these are also looked at near their ends, half a voxel from where texels are lit.
"""


@case(GROUP, "finite light", "every number of every specimen's baked frame is finite", 0, "numbers")
def finite_light(size: Size) -> Outcome:
    """Bake and render every specimen that is not refused; count what is not a number."""
    wrong, frames = 0, 0
    for scene in (scene for each in volumes() for scene in scenes_of(each, target_error=0.1)):
        wrong += faults(frame_of(scene, view_of(scene, size.pick(12, 64)), 16))
        frames += 1
    return Outcome(wrong, f"of {frames} frames")


@cache
def against_paths(name: str, size: Size) -> tuple[float, float, int]:
    """A specimen's frames against paths from each pixel: the worst relative RMSE and percentile, and dark pixels."""
    worst, far, dark = 0.0, 0.0, 0
    for scene in scenes_of(SPECIMENS[name], target_error=TARGET):
        with TemporaryDirectory() as folder:
            bench = Bench(scene, view_of(scene, size.pick(24, 64)), Path(folder))
            radiance, best = bench.planned.frame().radiance, bench.reference(size.pick(128, 1024))
        found, lacks = bench.score(radiance, best), luminance(best.mean - radiance)
        dark += int((lacks > DARK * luminance(best.mean)).sum())
        worst, far = max(worst, found.rmse), max(far, found.p99)
    return worst, far, dark


def error_of(name: str, size: Size) -> Outcome:
    """The error of a specimen's light."""
    worst, far, _ = against_paths(name, size)
    return Outcome(worst, f"{FAR:g} % of pixels below {far:.1%}")


for _name, _most in MOST.items():
    case(GROUP, _name, "light is that of the path tracer, by its relative RMSE", _most, "relative")(
        partial(error_of, _name)
    )


BESIDE = """\
At an isovalue just beside that of a plateau the surface lies half a voxel from where its texels are lit: in the \
corner of a crease a pixel may read one that is shut in."""


@case(GROUP, "dark pixels", f"no pixel lacks more than {DARK:.0%} of its light", 4, "pixels", BESIDE)
def dark_pixels(size: Size) -> Outcome:
    """Pixels of all those specimens that lack light."""
    return Outcome(sum(against_paths(name, size)[2] for name in MOST), f"of {len(MOST)} specimens")


@case(GROUP, "outline of a mask", "a ball's outline has its disc's area, within half a voxel of radius", 0.5, "voxels")
def outline_of_a_mask(size: Size) -> Outcome:
    """The radius of the disc that a mask of a ball covers, seen from afar, against the ball's own; the worst view."""
    radius, side = 20.3, 48
    volume = make_volume(ramp(ball(grid(side, side, side), (0.0, 0.0, 0.0), radius), 0.0))
    scene, pixels, count, worst = scene_of(volume, 0.5), size.pick(256, 512), size.pick(6, 60), 0.0
    distance, fov = 100.0, 0.9
    across = 2.0 * distance * volume.radius * np.tan(np.radians(fov / 2))
    with renderer_of(scene) as renderer:
        for azimuth, elevation in np.random.default_rng(2).uniform((0, -80), (360, 80), (count, 2)):
            view = view_of(scene, pixels, azimuth=azimuth, elevation=elevation, distance=distance, fov=fov)
            covered = len(renderer.gbuffer(view).pixels) / pixels**2
            worst = max(worst, abs(across * np.sqrt(covered / np.pi) - radius))
    return Outcome(worst, f"of {count} views")
