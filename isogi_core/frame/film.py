"""Develop a frame: from linear light to a picture of eight bits, with marks or errors over it."""

from functools import cache

import numpy as np

from isogi_core.frame.frame import EdgeSamples, Frame
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, develop_rows, fill_curve
from isogi_core.model.colours import linear_of

SCALE = (0.001, 1.0)
"""Relative errors at the ends of the scale; what lies beyond has the colour of the end."""


COLOURS = (
    *("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c"),
    *("#28ae80", "#5ec962", "#addc30", "#fde725"),
)
"""sRGB at equal steps of the logarithm, from little error to much: viridis (Smith and van der Walt
2015), of even steps to the eye, at nine places."""


ERROR_LEVELS = 256


@cache
def colour_table() -> np.ndarray:
    """COLOURS and what is between them, (LEVELS, 3) uint8 sRGB."""
    anchors = np.array([list(bytes.fromhex(colour[1:])) for colour in COLOURS], float)
    place = np.linspace(0.0, 1.0, ERROR_LEVELS)
    at = np.linspace(0.0, 1.0, len(COLOURS))
    return (
        np.stack([np.interp(place, at, channel) for channel in anchors.T], axis=1)
        .round()
        .astype(np.uint8)
    )


def error_colours(error: np.ndarray) -> np.ndarray:
    """The colours of relative errors (n,): (n, 3) uint8 sRGB."""
    low, high = SCALE
    share = np.log(np.clip(error, low, high) / low) / np.log(high / low)
    return colour_table()[(share * (ERROR_LEVELS - 1) + 0.5).astype(np.intp)]


BACKGROUND = (0.0103, 0.0123, 0.0160)
"""Linear RGB behind the surface: a quiet, almost black blue."""


LIGHT = "cbced1"
"""sRGB behind the surface of pictures on a light ground: a grey as of a studio, some 20 levels
darker than what is lit, so that pale surfaces keep their outlines.
"""


HATCHING_COLOUR = (0.95, 0.42, 0.05)
"""Linear RGB of the overlay's hatching: amber, which no grey surface has."""


LEVELS = 4096


MIN_PIXEL_COVER = 1e-6
"""What the samples of a pixel cover together at least, where that divides their light."""


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
    frame: Frame, exposure: float, overlay: str = "none", background: str = "dark"
) -> np.ndarray:
    """The picture of a frame, (h, w, 3) uint8 sRGB. ``exposure`` multiplies the light.

    ``background`` is behind the surface: dark, light, ``#rrggbb``, or transparent: then the picture
    is (h, w, 4), its last channel how much of a pixel the surface covers. ``overlay`` is one of the
    view's OVERLAYS: ``provisional`` hatches what is not final, broad where provisional, fine where
    converging; ``error`` colours what has light by its estimated relative error, and hatches the
    rest. Pixels at edges are the mean of their samples, under no overlay.
    """
    clear = background == "transparent"
    if frame.left is None:
        left = None
    else:
        left = np.where(frame.state > 0, frame.left, np.float32(1.0))
    ground = BACKGROUND if clear else ground_of(background)
    if overlay == "error":
        picture = with_errors(frame, exposure, ground)
    else:
        radiance = before_ground(frame.radiance, frame.airy, exposure, ground)
        picture = lit(radiance, frame.state, exposure, overlay == "provisional", ground)
    if left is not None and not clear:
        picture = seen_through(picture, left, ground)
    if clear:
        if left is None:
            cover = np.where(frame.state > 0, np.float32(1.0), np.float32(0.0))
        else:
            cover = 1.0 - left
        picture = np.dstack([bared(picture, cover), (255.0 * cover + 0.5).astype(np.uint8)])
    if frame.edges and overlay == "none":
        picture.reshape(-1, picture.shape[2])[frame.edges.pixels] = averaged(
            frame.edges, exposure, ground, clear
        )
    return picture


def seen_through(picture: np.ndarray, left: np.ndarray, ground: tuple[float, ...]) -> np.ndarray:
    """A ``picture`` (h, w, 3) uint8 of surfaces that let the share ``left`` (h, w) of a ``ground``
    through.
    """
    some = (left > 0.0) & (left < 1.0)
    found = picture.copy()
    light = linear_table()[picture[some]] + left[some][:, None] * np.array(ground, np.float32)
    found[some] = coded(np.minimum(light, 1.0))
    return found


def bared(picture: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """The colours that a ``picture`` (h, w, 3) uint8 has where it covers a pixel in part, by a
    ``cover`` (h, w).
    """
    some = (cover > 0.0) & (cover < 1.0)
    found = picture.copy()
    found[some] = coded(np.minimum(linear_table()[picture[some]] / cover[some][:, None], 1.0))
    return found


def before_ground(
    radiance: np.ndarray, airy: np.ndarray | None, exposure: float, ground: tuple[float, ...]
) -> np.ndarray:
    """The ``radiance`` (…, 3) of a picture with the ``ground`` behind what is ``airy`` (…), which
    hides none of it.
    """
    if airy is None:
        return radiance
    behind = np.array(ground, np.float32) / np.float32(exposure)
    return np.where(airy[..., None], radiance + behind, radiance).astype(np.float32)


def averaged(
    edges: EdgeSamples, exposure: float, ground: tuple[float, ...], clear: bool
) -> np.ndarray:
    """The pixels at ``edges``, (k, 3) uint8 sRGB, as the mean of what their samples shine on a
    screen.

    Where the picture is ``clear`` that is of samples on the surface, and (k, 4): the last is how
    much these cover.
    """
    light = before_ground(edges.light, edges.airy, exposure, ground)
    shown = linear_table()[lit(light, edges.on.astype(np.uint8), exposure, False, ground)]
    if not clear:
        if edges.left is not None:
            behind = np.where(edges.on, edges.left, np.float32(0.0))[..., None] * np.array(
                ground, np.float32
            )
            shown = np.minimum(shown + behind, np.float32(1.0))
        return coded(shown.mean(axis=1))
    sums = np.where(edges.on[..., None], shown, np.float32(0)).sum(axis=1)
    cover = edges.cover.mean(axis=1)
    light = sums / np.maximum(edges.cover.sum(axis=1), MIN_PIXEL_COVER)[:, None]
    return np.column_stack([coded(np.minimum(light, 1.0)), (255.0 * cover + 0.5).astype(np.uint8)])


def coded(light: np.ndarray) -> np.ndarray:
    """The sRGB codes of linear ``light`` from 0 to 1, uint8."""
    return np.asarray(tone_table()[(light * (LEVELS - 1) + 0.5).astype(np.intp)])


@cache
def linear_table() -> np.ndarray:
    """The linear light of each sRGB code, (256,) float32."""
    return np.array([linear_of(code / 255.0) for code in range(256)], np.float32)


def lit(
    radiance: np.ndarray,
    state: np.ndarray,
    exposure: float,
    marked: bool,
    ground: tuple[float, ...] = BACKGROUND,
) -> np.ndarray:
    """The picture of ``radiance`` (h, w, 3), with the marks of ``state`` (h, w) over it where
    ``marked``.
    """
    picture = np.empty(radiance.shape, np.uint8)
    colours = np.array([ground, HATCHING_COLOUR], np.float32)
    develop_rows(radiance, state, 0, exposure, colours, marked, tone_table(), picture)
    return picture


def with_errors(
    frame: Frame, exposure: float, ground: tuple[float, ...] = BACKGROUND
) -> np.ndarray:
    """The picture under the colours of its errors; what has no light, and so no estimate, is
    hatched.
    """
    known = frame.state >= CONVERGING
    picture = lit(
        frame.radiance, np.where(known, np.uint8(FINAL), frame.state), exposure, True, ground
    )
    below = picture[known].astype(np.uint16)
    above = error_colours(frame.total_error[known])
    picture[known] = (below * (256 - COVER) + above.astype(np.uint16) * COVER) >> 8
    return picture
