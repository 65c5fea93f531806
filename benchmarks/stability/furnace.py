"""Cases of the white furnace: where all light is reflected and all of it is 1, everything is 1."""

from collections.abc import Sequence

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import surface_light
from benchmarks.stability.specimen import Specimen, volumes
from benchmarks.stability.stage import frame_of, scenes_of, view_of

GROUP = "white furnace"

CLOSED = "solid up to the box"
"""The specimen that is a cave without a way in: it is black, and no light of its is to be judged."""

SPECKS = "-9999 in 30 %"
"""The specimen whose surface is all specks, smaller than what lies between texels."""

MOST = 0.005

WHITE = {"albedo": 1.0, "bounces": 1000, "target_error": 0.1}
"""Settings under which no light is lost."""


def lights(specimens: Sequence[Specimen], size: Size, shading: str) -> list[np.ndarray]:
    """Luminance of the surface pixels of specimens' frames, those without a surface left out."""
    found = []
    for scene in (scene for each in specimens for scene in scenes_of(each, **WHITE)):
        view = view_of(scene, size.pick(12, 48), shading=shading, samples=size.pick(16, 64))
        frame = frame_of(scene, view, size.pick(64, 256))
        found += [surface_light(frame)] if frame.surface else []
    return found


def off_by(lights: Sequence[np.ndarray]) -> Outcome:
    """The mean that is farthest from 1, and the pixel; beyond all where there is none."""
    mean = max((abs(float(light.mean()) - 1.0) for light in lights), default=np.inf)
    pixel = max((float(abs(light - 1.0).max()) for light in lights), default=np.inf)
    return Outcome(mean, f"of {len(lights)} frames; a single pixel up to {pixel:.1%} off")


def open_to_light() -> list[Specimen]:
    """All specimens that light can get at."""
    return [each for each in volumes() if each.name != CLOSED]


@case(
    GROUP,
    "by paths",
    "in light of 1 a white surface is 1: the mean of each specimen's frame, but of a closed cave's",
    MOST,
    "relative",
)
def by_paths(size: Size) -> Outcome:
    """Path-traced: nothing is lost where rays start on surfaces, however stiff."""
    return off_by(lights(open_to_light(), size, "path_traced"))


@case(GROUP, "by texels", "the same where light is baked, but of the specimen that is all specks", MOST, "relative")
def by_texels(size: Size) -> Outcome:
    """Baked."""
    return off_by(lights([each for each in open_to_light() if each.name != SPECKS], size, "gi"))


UNTOLD = """\
Each texel is lit on the isosurface through its own voxel. Among marks of -9999 that nobody said are missing these \
surfaces are specks, smaller than what lies between texels, and many paths from them start within the solid and never \
leave it. With `missing = -9999` in the scene the marks are holes. Paths from pixels lose nothing."""


@case(
    GROUP,
    "specks",
    "the same of that one: 30 % of its voxels, taken by chance, are marks of -9999",
    0.9,
    "relative",
    UNTOLD,
)
def specks(size: Size) -> Outcome:
    """The specimen that the baked ones leave out."""
    return off_by(lights([each for each in volumes() if each.name == SPECKS], size, "gi"))
