"""Print a digest of what each kernel of paths adds up, over a grid of scenes; arguments name grids,
else all run.

After a change of the loop of paths that keeps all bits, the lines printed on one machine are equal:
run ``python -m tests.kernels.transport.path_bytes`` at both commits. With NUMBA_DISABLE_JIT=1
Python runs a few paths.
"""

import hashlib
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.colours import colours_of
from isogi_core.kernels.transport.glow_paths import glow_among_surfaces, glow_in_room
from isogi_core.kernels.transport.matter.matter_paths import (
    ALONG_RAY,
    INWARD,
    Through,
    light_through_matter,
)
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange, TransferRules
from isogi_core.kernels.transport.room_paths import InRoom, light_in_room
from isogi_core.kernels.transport.surface_paths import light_among_surfaces
from isogi_core.kernels.transport.transfer import (
    ColouredRules,
    bake_coloured_texels,
    bake_irradiance,
    bake_texels,
)
from tests.kernels.fields import cells_of, field_of, surface_of
from tests.kernels.glows import ball, block, glows_of
from tests.kernels.rooms import X, Y, Z, among, box, room_of, sky, wall
from tests.kernels.transport.lighting import (
    AREA,
    DIRECTIONAL,
    NOISY,
    POINT,
    lamps,
    on_ball,
    place_at,
    surroundings,
    trace_points,
)
from tests.kernels.transport.matter.passables import passable
from tests.scale import few

FIELD = field_of(NOISY, (1.0, 1.1, 0.9))
CELLS = cells_of(FIELD, 0.0)
RANDOM = np.random.default_rng(3)
IMAGE = (RANDOM.random((8, 16, 3)) ** 8).astype(np.float32)
LAMPS = lamps(
    (POINT, (45.0, 10.0, 40.0), None, (90.0, 80.0, 70.0)),
    (DIRECTIONAL, (0.0, 0.6, 0.8), None, (1.0, 2.0, 3.0)),
    (AREA, (5.0, 5.0, 48.0), ((6.0, 0.0, 0.0), (0.0, 6.0, 0.0)), (9.0, 9.0, 9.0)),
)
LIGHTS = {
    "constant": sky(0.7),
    "image": surroundings(IMAGE, 0.1),
    "lamps": surroundings(IMAGE, table=True, lamps=LAMPS),
}
FLOOR = wall((-400.0, -400.0, -4.0), 900.0 * X, 900.0 * Y, 0.5)
PANEL = wall((12.0, 12.0, 46.0), 9.0 * Y, 9.0 * X, 0.2, 5.0, True)
GLOWS = glows_of(ball([34.0, 20.0, 20.0], 3.0), block([6.0, 20.0, 34.0], [2.0, 4.0, 3.0]))
COLOURS = colours_of(
    RANDOM.integers(0, 255, (41, 41, 41)).astype(np.uint8), (1.0, 1.0, 1.0), RANDOM.random((256, 3))
)
RULES = {"one": (0, 1.0), "five": (4, 1.0), "roulette": (5, 0.7)}
POINTS, NORMALS = on_ball(7)
PLACE = place_at(np.ascontiguousarray(POINTS), np.ascontiguousarray(NORMALS))
SAMPLES, FEW = (SampleRange(3, count) for count in few((700, 40), (1, 1)))

Sums = Iterator[tuple[str, np.ndarray]]


def starts_on(*walls: float) -> PathStarts:
    """Starts on the ball, or on what stands for a wall, and some on the floor."""
    points = np.hstack([POINTS, [[30.0, 8.0], [12.0, 50.0], [-4.0, -4.0]]])
    normals = np.hstack([NORMALS, np.tile(Z[:, None], 2)])
    g = points.shape[1]
    numbers = np.append(np.resize(walls, g - 2), [0.0, 0.0])
    points = np.ascontiguousarray(points / np.array(FIELD.spacing)[:, None])
    return PathStarts(
        points,
        np.ascontiguousarray(normals),
        np.zeros(g),
        np.arange(1, g + 1, dtype=np.uint64),
        numbers,
    )


def weights_of(bounces: int, survival: float) -> PathRules:
    """What a path's light counts after each bounce off a surface with a colour."""
    k = np.arange(bounces + 1.0)[:, None]
    return PathRules(
        np.array([0.9, 0.6, 0.3]) ** k / survival ** np.maximum(k - 1.0, 0.0), survival
    )


def in_the_open() -> Sums:
    """Irradiance of texels, and pixels traced on their own."""
    for (light, around), (name, rules) in itertools.product(LIGHTS.items(), RULES.items()):
        sums = np.zeros((len(PLACE[0]), 2, 3))
        bake_irradiance(
            FIELD, CELLS, PLACE, np.arange(len(sums)), SAMPLES, weights_of(*rules), around, sums
        )
        yield f"irradiance {light} {name}", sums
        pixels = SurfacePoints(
            *(np.ascontiguousarray(each.T, np.float32) for each in PLACE[1:3]),
            np.arange(len(sums), dtype=np.uint32),
        )
        sums = np.zeros((len(sums), 2, 3))
        trace_points(surface_of(FIELD, 0.0), pixels, around, weights_of(*rules), 5, FEW, sums)
        yield f"pixels {light} {name}", sums


def transfer() -> Sums:
    """Radiance transfer by one albedo and by colours."""
    rows = np.arange(len(PLACE[0]))
    for (name, (bounces, survival)), branches in itertools.product(RULES.items(), (1, 4)):
        counts = weights_of(bounces, survival).weights.T
        shares = np.ascontiguousarray(np.hstack([np.full((3, 1), 0.1), counts]))
        sums = np.zeros((len(rows), 2, 3, 25))
        some = SAMPLES if branches == 1 else FEW
        tree = TransferRules(shares, survival, branches)
        bake_texels(FIELD, CELLS, PLACE, rows, some, tree, np.array([5, 3, 2]), sums)
        yield f"transfer {name} {branches}", sums
        mixes = np.vstack([np.eye(3), np.ones((1, 3))])
        straight = np.array([1.0, 0.0, 0.5, 0.0])
        squared = np.array([False, False, False, True])
        coloured = ColouredRules(
            np.array([3, 2, 2, 1]),
            straight,
            np.ones(4),
            mixes,
            squared,
            bounces,
            survival,
            branches,
        )
        sums = np.zeros((len(rows), 2, 4, 9))
        bake_coloured_texels(FIELD, CELLS, COLOURS, PLACE, rows, some, coloured, sums)
        yield f"coloured {name} {branches}", sums


def in_rooms() -> Sums:
    """Light and glow among walls, and over colours without any."""
    rooms = {
        "floor": room_of([FLOOR, PANEL], FIELD.spacing, 0.6),
        "box": room_of(box(60.0, 0.4, 0.1), FIELD.spacing, 0.6),
        "colours": room_of([FLOOR], FIELD.spacing, colours=COLOURS),
    }
    for (name, room), (rules, given) in itertools.product(rooms.items(), RULES.items()):
        ones = PathRules(np.full((given[0] + 1, 3), 0.8), given[1])
        for light, around in LIGHTS.items():
            sums = np.zeros((9, 3))
            light_in_room(
                InRoom(FIELD, CELLS, room), starts_on(NO_WALL), SAMPLES, ones, around, sums
            )
            yield f"room {name} {rules} {light}", sums
        dark = room._replace(radiances=np.zeros_like(room.radiances))
        sums = np.zeros((9, 6))
        glow_in_room(InRoom(FIELD, CELLS, dark), starts_on(NO_WALL), SAMPLES, ones, GLOWS, sums)
        yield f"glow {name} {rules}", sums


def among_surfaces() -> Sums:
    """Light and glow among several surfaces that let some of it through."""
    through = [0.3, (0.1, 0.2, 0.0), 0.0]
    for (name, given), walls in itertools.product(RULES.items(), ([FLOOR], [FLOOR, PANEL])):
        ones = PathRules(np.full((given[0] + 1, 3), 0.8), given[1])
        several = among(
            FIELD, 0.0, [3.0, -4.0], [0.5, (0.6, 0.4, 0.2), 0.7], [0.25, 0.0, 0.5], through, walls
        )
        for light, around in LIGHTS.items():
            sums = np.zeros((9, 3))
            light_among_surfaces(several, starts_on(NO_WALL), SAMPLES, ones, around, sums)
            yield f"several {len(walls)} {name} {light}", sums
        dark = several.room._replace(radiances=np.zeros_like(several.room.radiances))
        sums = np.zeros((9, 6))
        glow_among_surfaces(
            several._replace(room=dark), starts_on(NO_WALL), SAMPLES, ones, GLOWS, sums
        )
        yield f"glow among {len(walls)} {name}", sums


def through_matter() -> Sums:
    """Light through glass, and out of matter that scatters."""
    met = {
        "glass": passable([FLOOR, PANEL], 1.5, 0.05),
        "milk": passable([FLOOR, PANEL], 1.3, 0.0, 0.4, 0.95),
    }
    for (name, each), (rules, given) in itertools.product(met.items(), RULES.items()):
        ones = PathRules(np.full((given[0] + 1, 3), 0.8), given[1])
        for light, around in LIGHTS.items():
            sums = np.zeros((9, 3))
            starts = starts_on(INWARD, ALONG_RAY, NO_WALL)
            light_through_matter(Through(FIELD, CELLS, *each), starts, FEW, ones, around, sums)
            yield f"matter {name} {rules} {light}", sums


GRIDS: tuple[Callable[[], Sums], ...] = (
    in_the_open,
    transfer,
    in_rooms,
    among_surfaces,
    through_matter,
)


def digests(grids: Iterable[Callable[[], Sums]] = GRIDS) -> Iterator[str]:
    """A line for each scene: its name, the digest of its sums, and their mean."""
    for name, sums in (each for grid in grids for each in grid()):
        yield f"{name}: {hashlib.sha256(sums.tobytes()).hexdigest()[:16]} {sums.mean():.6g}"


if __name__ == "__main__":
    wanted = [grid for grid in GRIDS if grid.__name__ in sys.argv[1:]]
    for line in digests(wanted or GRIDS):
        sys.stdout.write(f"{line}\n")
