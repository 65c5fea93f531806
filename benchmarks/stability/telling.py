"""Cases of ``isogi inspect``: what is stiff is told, and what is not stiff is not called so."""

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.shapes import ball, body, grid, ramp
from benchmarks.stability.stage import scene_of
from isogi_core.model.volume import make_volume
from server.inspect.document import stiffness_facts
from server.inspect.facts import SurfaceFacts

GROUP = "inspect"


def told(voxels: np.ndarray, isovalue: float = 0.5) -> SurfaceFacts:
    """What is told of a volume's surface."""
    found = stiffness_facts(scene_of(make_volume(voxels), isovalue))
    return found.surfaces[found.own]


@case(GROUP, "soft ball", "no cell of a ball whose skin is a ramp of 3 voxels or more is called stiff", 0, "relative")
def soft_ball(size: Size) -> Outcome:
    """The greatest share that is called steep, plateau or noisy, over widths of the ramp."""
    side = size.pick(48, 96)
    distance = ball(grid(side, side, side), (0.3, 0.1, -0.2), 0.3 * side)
    surfaces = [told(ramp(distance, width)) for width in (3.0, 4.0, 8.0)]
    return Outcome(max(max(each.steep, each.plateau, each.noisy) for each in surfaces), "of its cells, three ramps")


@case(GROUP, "steep", "every cell of a mask is told to be steep, and 90 % of a ramp of one voxel", 0.1, "relative")
def steep(size: Size) -> Outcome:
    """The share that is not told, of a mask and of a thin ramp."""
    distance = body(size.pick(48, 96))
    left = [1.0 - told(ramp(distance, width)).steep for width in (0.0, 1.0)]
    return Outcome(max(left[1], 1.0 if left[0] else 0.0), f"of the ramp's cells are not; {left[0]:.0%} of the mask's")


@case(GROUP, "terraces", "where the isovalue is a tread's own value, all of the surface is on a plateau", 0, "relative")
def terraces(size: Size) -> Outcome:
    """The share that is not told, over the treads of a staircase."""
    treads = np.floor(np.indices((size.pick(32, 96),) * 3)[0] / 8.0)
    left = [1.0 - told(treads, float(tread)).plateau for tread in range(int(treads.max()))]
    return Outcome(max(left), f"of the cells are not, at {len(left)} treads")


@case(GROUP, "noise", "nine of ten cells of white noise are told to be noisy", 0.1, "relative")
def noise(size: Size) -> Outcome:
    """The share that is not told."""
    side = size.pick(32, 96)
    return Outcome(1.0 - told(np.random.default_rng(5).normal(size=(side,) * 3), 0.0).noisy, "of the cells are not")


@case(GROUP, "cut open", "the faces of the box that a surface meets are told, and no others", 0, "faces")
def cut_open(size: Size) -> Outcome:
    """Faces that are told wrongly, of a ball moved through each of the six faces."""
    side = size.pick(24, 64)
    wrong = 0
    for face, name in enumerate(f"{axis} = {end}" for axis in "xyz" for end in (0, side - 1)):
        centre = [0.0, 0.0, 0.0]
        centre[face // 2] = (side / 2) * (1 if face % 2 else -1)
        met = set(told(ramp(ball(grid(side, side, side), (centre[0], centre[1], centre[2]), side / 4), 4.0)).box)
        wrong += len(met ^ {name})
    return Outcome(wrong, "of 36")
