"""Cases of thin walls: how much light of a room comes through one into a closed room, by the cache and by paths."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import surface_light
from benchmarks.stability.ramps import unmoved
from benchmarks.stability.stage import frame_of, scene_of
from isogi_core.model.scene import Scene
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import luminance

GROUP = "thin walls"

SOLID, ROOM = 4, 12
"""Voxels of solid around both rooms, and of a room, along each axis."""

LEAN = 0.3
"""Slope of a wall that leans."""

DEPTH = ROOM + 2 * SOLID
MIDDLE = (DEPTH - 1) / 2


def rooms(wall: int, lit: int, slope: float = 0.0) -> np.ndarray:
    """Two rooms side by side along x; ``lit`` is the one without a roof.

    The wall between them is so many voxels thick, and leans by ``slope`` along y; its ramps are a voxel wide.
    """
    width = DEPTH + wall + ROOM
    z, y, x = np.ogrid[:DEPTH, :DEPTH, :width]
    away = abs(x - (width - 1) / 2 + slope * (y - MIDDLE)) / np.hypot(1.0, slope)
    free = (x >= SOLID) & (x < width - SOLID) & (abs(y - MIDDLE) < ROOM / 2) & (z >= SOLID)
    free &= (z < SOLID + ROOM) | ((x > (width - 1) / 2 - slope * (y - MIDDLE)) == bool(lit))
    return np.where(free, np.clip((wall + 1) / 2 - away, 0.0, 1.0), 1.0).astype(np.float32)


def inside(room: int, wall: int, size: int) -> View:
    """From the back of a room at the wall between both."""
    way = 1 if room == 0 else -1
    middle = MIDDLE + room * (wall + ROOM)
    eye, target = (middle - way * 0.4 * ROOM, MIDDLE, MIDDLE), (middle, MIDDLE, MIDDLE)
    return View(0.5, Camera(eye, target, fov=80.0), width=size, height=size)


def by_cache(scene: Scene, view: View) -> float:
    """Mean luminance that texels give the surface of a view."""
    return float(surface_light(frame_of(scene, view, 64)).mean())


def by_paths(scene: Scene, view: View) -> float:
    """Mean luminance that paths give the surface of a view."""
    with TemporaryDirectory() as folder:
        reference = Bench(scene, view, Path(folder)).reference(64)
    return float(luminance(reference.mean[reference.on]).mean())


def leaks(wall: int, slope: float, size: Size) -> Outcome:
    """Light in a closed room over that in the open one beside it, whichever of them is the closed one."""
    shares: dict[str, float] = {}
    states: list[Callable[[], AbstractContextManager[None]]] = [nullcontext, nullcontext, unmoved]
    ways = list(zip(("texels", "paths", "before"), (by_cache, by_paths, by_cache), states, strict=True))
    for lit in (0, 1):
        scene = scene_of(make_volume(rooms(wall, lit, slope)), 0.5, target_error=0.1)
        near, far = (inside(room, wall, size.pick(16, 48)) for room in (lit, 1 - lit))
        for name, light_of, state in ways:
            with state():
                share = light_of(scene, far) / light_of(scene, near)
            shares[name] = max(shares.get(name, 0.0), share)
    got = f"{shares['paths']:.2%} by paths; with texels in their own places {shares['before']:.1%}"
    return Outcome(shares["texels"], got)


EXPECTED = "a closed room beside an open one is dark: what comes through the wall is 1 % of the light there, or less"

MOST = 0.01

UPRIGHT = """\
Texels in a wall one voxel thin are left out, but a texel in the corner where three such walls meet is lit on one side \
of them, and pixels in that corner read it from the other side too. Paths let nothing through."""

LEANING = """\
The cells that such a wall runs through have texels of both its sides at their corners, and a pixel is lit by all of \
its cell that hold light: texels hold no normal by which it could tell them apart. Two voxels are enough. Paths let \
nothing through."""

for _slope, _name, _most, _known in ((0.0, "upright", 0.04, UPRIGHT), (LEAN, "leaning", 0.3, LEANING)):
    case(GROUP, f"a voxel, {_name}", EXPECTED, _most, "relative", _known)(partial(leaks, 1, _slope))
    for _wall in (2, 3):
        case(GROUP, f"{_wall} voxels, {_name}", EXPECTED, MOST, "relative")(partial(leaks, _wall, _slope))
