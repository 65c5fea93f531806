"""Developing a frame: from linear light to a picture of eight bits, with marks or errors over it if asked."""

from functools import cache

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, develop_rows, fill_curve

SCALE = (0.001, 1.0)
"""Relative errors at the ends of the scale; what lies beyond has the colour of the end."""

COLOURS = (
    *("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c"),
    *("#28ae80", "#5ec962", "#addc30", "#fde725"),
)
"""sRGB at equal steps of the logarithm, from little error to much: viridis (Smith and van der Walt 2015), of even
steps to the eye, at nine places."""

ERROR_LEVELS = 256


@cache
def colour_table() -> np.ndarray:
    """COLOURS and what is between them, (LEVELS, 3) uint8 sRGB."""
    anchors = np.array([list(bytes.fromhex(colour[1:])) for colour in COLOURS], float)
    place, at = np.linspace(0.0, 1.0, ERROR_LEVELS), np.linspace(0.0, 1.0, len(COLOURS))
    return np.stack([np.interp(place, at, channel) for channel in anchors.T], axis=1).round().astype(np.uint8)


def colours_of(error: np.ndarray) -> np.ndarray:
    """The colours of relative errors (n,): (n, 3) uint8 sRGB."""
    low, high = SCALE
    share = np.log(np.clip(error, low, high) / low) / np.log(high / low)
    return colour_table()[(share * (ERROR_LEVELS - 1) + 0.5).astype(np.intp)]


BACKGROUND = (0.0103, 0.0123, 0.0160)
"""Linear RGB behind the surface: a quiet, almost black blue."""

LIGHT = "f4f4f2"
"""sRGB behind the surface of pictures on a light ground: paper."""

MARK = (0.95, 0.42, 0.05)
"""Linear RGB of the overlay's hatching: amber, which no grey surface has."""

LEVELS = 4096

COVER = 205
"""How much of the picture, of 256 parts, the colours of the error hide: its form still shows."""


@cache
def tone_table() -> np.ndarray:
    """The sRGB curve as a table of LEVELS uint8 codes, linear level i / (LEVELS - 1)."""
    table = np.empty(LEVELS, np.uint8)
    fill_curve(table)
    return table


def ground_of(background: str) -> tuple[float, ...]:
    """Linear RGB of a background: dark, light, or sRGB as ``#rrggbb``."""
    if background == "dark":
        return BACKGROUND
    codes = bytes.fromhex(background[1:] if background.startswith("#") else LIGHT)
    return tuple(linear_of(code / 255.0) for code in codes)


def develop(
    frame: Frame, exposure: float, overlay: str = "none", background: str = "dark", antialias: int = 1
) -> np.ndarray:
    """The picture of a frame, (h, w, 3) uint8 sRGB. ``exposure`` multiplies the light.

    ``background`` is behind the surface: dark, light, ``#rrggbb``, or transparent: then the picture is (h, w, 4), its
    last channel 0 where there is no surface. ``overlay`` is one of the view's OVERLAYS: ``provisional`` hatches what
    is not final, broad where provisional, fine where converging; ``error`` colours what has light by its estimated
    relative error, and hatches the rest. A pixel is the mean of ``antialias`` ones of the frame along each side.
    """
    clear = background == "transparent"
    ground = BACKGROUND if clear else ground_of(background)
    if overlay == "error":
        picture = with_errors(frame, exposure, ground)
    else:
        picture = lit(frame, frame.state, exposure, overlay == "provisional", ground)
    if clear:
        picture = np.dstack([picture, np.where(frame.state > 0, np.uint8(255), np.uint8(0))])
    return averaged(picture, antialias) if antialias > 1 else picture


def averaged(picture: np.ndarray, side: int) -> np.ndarray:
    """The picture (h, w, channels) uint8 sRGB with ``side`` × ``side`` pixels to one: the mean of their linear light.

    Pixels count by their last channel where there are four, and that is the mean of theirs.
    """
    high, wide = (length // side for length in picture.shape[:2])
    blocks = picture[: high * side, : wide * side].reshape(high, side, wide, side, -1)
    whole = np.zeros((high, wide, picture.shape[2]), np.float32)
    weights = np.zeros((high, wide, 1), np.float32)
    for row in range(side):
        for column in range(side):
            part = blocks[:, row, :, column]
            weight = part[..., 3:] / np.float32(255) if part.shape[-1] == 4 else np.ones((1, 1, 1), np.float32)
            whole[..., :3] += weight * linear_table()[part[..., :3]]
            weights += weight
    light = whole[..., :3] / np.maximum(weights, 1e-6)
    codes = tone_table()[(light * (LEVELS - 1) + 0.5).astype(np.intp)]
    if picture.shape[2] == 3:
        return codes
    return np.dstack([codes, (255.0 / side**2 * weights + 0.5).astype(np.uint8)])


@cache
def linear_table() -> np.ndarray:
    """The linear light of each sRGB code, (256,) float32."""
    return np.array([linear_of(code / 255.0) for code in range(256)], np.float32)


def linear_of(code: float) -> float:
    """Linear light of an sRGB code from 0 to 1 (IEC 61966-2-1)."""
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


def lit(
    frame: Frame, state: np.ndarray, exposure: float, marked: bool, ground: tuple[float, ...] = BACKGROUND
) -> np.ndarray:
    """The picture of a frame, with the marks of ``state`` (h, w) over it where ``marked``."""
    picture = np.empty(frame.radiance.shape, np.uint8)
    colours = np.array([ground, MARK], np.float32)
    develop_rows(frame.radiance, state, 0, exposure, colours, marked, tone_table(), picture)
    return picture


def with_errors(frame: Frame, exposure: float, ground: tuple[float, ...] = BACKGROUND) -> np.ndarray:
    """The picture under the colours of its errors; what has no light, and so no estimate, is hatched."""
    known = frame.state >= CONVERGING
    picture = lit(frame, np.where(known, np.uint8(FINAL), frame.state), exposure, True, ground)
    below, above = picture[known].astype(np.uint16), colours_of(frame.total_error[known])
    picture[known] = (below * (256 - COVER) + above.astype(np.uint16) * COVER) >> 8
    return picture
