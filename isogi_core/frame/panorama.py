"""The panorama around a scene: a small picture of its environment and its directional lights."""

import numpy as np

from isogi_core.frame.film import LEVELS, tone_table
from isogi_core.kernels.transport.lights import DIRECTIONAL
from isogi_core.model.environment import (
    LUMINANCE_WEIGHTS,
    Environment,
    Lamps,
    pixel_directions,
    resample,
    solid_angles,
)

PANORAMA_FORMAT = 1
"""Number of the format of panoramas. It counts up when the same light makes another picture."""


MIDDLE_BRIGHTNESS = 0.36
"""Brightness of the middle of the light before the tone curve: twice Reinhard's, for a picture
this small.
"""


DARKEST_SHARE = 1e-4
"""Share of the mean to which darker light is raised before its logarithm is taken."""


GLARE = 0.02
GLARE_REACH = 16
"""Share of the light that strays around bright places, as in an eye; and the reach of it: the
picture's width over GLARE_REACH, in steps of a pixel. A sun is smaller than a pixel, and would
hardly be seen.
"""


MARK_RADIUS = 0.05
"""Radius of the mark of a directional light, in radians."""


def paint_panorama(
    environment: Environment, lamps: Lamps, width: int, turn: np.ndarray | None = None
) -> np.ndarray:
    """Paint the light that comes from infinitely far, unrotated: a picture (width // 2, width, 3)
    uint8 sRGB on the grid of a probe, whose top row is +z and whose column 0 starts at azimuth 0.

    Directional lights are discs in their colour. Lamps inside the scene have no single direction,
    and are left out. If light is given in a volume's box, ``turn`` (3, 3) is the rotation of the
    box in the world, and the picture shows the world.
    """
    if turn is None:
        overview = environment
    else:
        overview = environment.turned(turn.T)
    # Resample, spread glare, and compress the brightness.
    picture = tone(glare(resample(overview.overview, width // 2, width)))
    directions = pixel_directions(*picture.shape[:2]) @ (np.eye(3) if turn is None else turn)
    far = lamps.arrays.kinds == DIRECTIONAL
    # Mark directional lights, at least one pixel each.
    for towards, colour in zip(lamps.arrays.places[far], lamps.arrays.colours[far], strict=True):
        if colour.any():
            away = np.arccos(np.clip(directions @ towards, -1.0, 1.0))
            picture[away <= max(MARK_RADIUS, away.min())] = colour / colour.max()
    return np.asarray(tone_table()[np.rint(picture * (LEVELS - 1)).astype(np.int64)])


def glare(radiance: np.ndarray) -> np.ndarray:
    """Spread some of the light of a lat-long image (h, w, 3) of radiance by binomial steps; see
    GLARE.
    """
    stray = radiance
    for _ in range(radiance.shape[1] // GLARE_REACH):
        across = (np.roll(stray, 1, axis=1) + 2.0 * stray + np.roll(stray, -1, axis=1)) / 4.0
        padded = np.pad(across, ((1, 1), (0, 0), (0, 0)), "edge")
        stray = (padded[:-2] + 2.0 * across + padded[2:]) / 4.0
    return np.asarray(radiance + GLARE * stray)


def tone(radiance: np.ndarray) -> np.ndarray:
    """Compress a lat-long image (h, w, 3) of radiance into [0, 1], float64: its middle becomes
    MIDDLE_BRIGHTNESS, and nothing burns out.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002,
    eqs. 1 to 3, with the mean logarithm over the sphere.
    """
    luminance = radiance @ LUMINANCE_WEIGHTS
    shares = solid_angles(*luminance.shape) / (4.0 * np.pi)
    mean = float((shares * luminance).sum())
    if mean <= 0.0:
        return np.zeros_like(radiance)
    # The geometric mean over the sphere, in which each pixel counts by its solid angle.
    middle = np.exp((shares * np.log(np.maximum(luminance, DARKEST_SHARE * mean))).sum())
    factor = MIDDLE_BRIGHTNESS / (middle + MIDDLE_BRIGHTNESS * luminance)
    return np.asarray(np.minimum(radiance * factor[..., None], 1.0))
