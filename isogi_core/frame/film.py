"""Develop a frame: from linear light to a picture of eight bits, with marks or errors over it."""

from functools import cache

import numpy as np

from isogi_core.frame.frame import EdgeSamples, Frame
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, develop_rows, fill_curve
from isogi_core.model.colours import linear_of

SCALE = (0.001, 1.0)
"""Relative errors at the ends of the colour scale; errors beyond have the colour of the end."""


COLOURS = (
    *("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c"),
    *("#28ae80", "#5ec962", "#addc30", "#fde725"),
)
"""sRGB colours at equal steps of the logarithm, from small error to large: viridis (Smith and
van der Walt 2015), which is perceptually uniform, at nine places.
"""


ERROR_LEVELS = 256


@cache
def colour_table() -> np.ndarray:
    """Return COLOURS and interpolated ones, (ERROR_LEVELS, 3) uint8 sRGB."""
    anchors = np.array([list(bytes.fromhex(colour[1:])) for colour in COLOURS], float)
    place = np.linspace(0.0, 1.0, ERROR_LEVELS)
    at = np.linspace(0.0, 1.0, len(COLOURS))
    return (
        np.stack([np.interp(place, at, channel) for channel in anchors.T], axis=1)
        .round()
        .astype(np.uint8)
    )


def error_colours(error: np.ndarray) -> np.ndarray:
    """Return the colours of relative errors (n,): (n, 3) uint8 sRGB."""
    low, high = SCALE
    share = np.log(np.clip(error, low, high) / low) / np.log(high / low)
    return colour_table()[(share * (ERROR_LEVELS - 1) + 0.5).astype(np.intp)]


BACKGROUND = (0.0103, 0.0123, 0.0160)
"""Linear RGB behind the surface: a quiet, almost black blue."""


LIGHT = "cbced1"
"""sRGB behind the surface of pictures on a light ground: a studio grey, some 20 levels darker
than lit surfaces, so that pale ones keep their outlines.
"""


HATCHING_COLOUR = (0.95, 0.42, 0.05)
"""Linear RGB of the overlay's hatching: amber, which no grey surface has."""


LEVELS = 4096
"""Number of linear levels in the table of the sRGB curve."""


MIN_PIXEL_COVER = 1e-6
"""Least cover of all samples of a pixel together, as a divisor."""


COVER = 205
"""Opacity of the colours of the error over the picture, of 256: the form below still shows."""


@cache
def tone_table() -> np.ndarray:
    """Return the sRGB curve as a table of LEVELS uint8 codes, for linear light i / (LEVELS - 1)."""
    table = np.empty(LEVELS, np.uint8)
    fill_curve(table)
    return table


def ground_of(background: str) -> tuple[float, ...]:
    """Return the linear RGB of a background: dark, light, or sRGB as ``#rrggbb``."""
    if background == "dark":
        return BACKGROUND
    codes = bytes.fromhex(background[1:] if background.startswith("#") else LIGHT)
    return tuple(linear_of(code / 255.0) for code in codes)


def develop(
    frame: Frame, exposure: float, overlay: str = "none", background: str = "dark"
) -> np.ndarray:
    """Develop the picture of a frame, (h, w, 3) uint8 sRGB. ``exposure`` multiplies the light.

    ``background`` is dark, light, ``#rrggbb``, or transparent: then the picture is (h, w, 4), with
    the share of each pixel that surfaces cover in its last channel, and of glow alone its brightest
    channel.

    ``overlay`` is one of the view's OVERLAYS: ``provisional`` hatches pixels that are not final,
    broadly if they are provisional and finely if they converge; ``error`` colours pixels with light
    by their estimated relative error, and hatches all others. Without an overlay, pixels at edges
    show the mean of their samples.
    """
    clear = background == "transparent"
    ground: tuple[float, ...] = BACKGROUND
    if not clear:
        ground = ground_of(background)
    # The share of the background that shows through each pixel, if surfaces let light pass.
    left = None
    if frame.left is not None:
        left = np.where(frame.state > 0, frame.left, np.float32(1.0))
    # Develop the light of the pixels, with errors or marks over it.
    if overlay == "error":
        picture = with_errors(frame, exposure, ground)
    else:
        # Behind a transparent picture there is no ground.
        behind = None if clear else frame.airy
        radiance = before_ground(frame.radiance, behind, exposure, ground)
        picture = lit(radiance, frame.state, exposure, overlay == "provisional", ground)
    if left is not None and not clear:
        picture = seen_through(picture, left, ground)
    # A transparent picture has the colours of the surfaces alone, and their cover.
    if clear:
        if left is None:
            cover = np.where(frame.state > 0, np.float32(1.0), np.float32(0.0))
        else:
            cover = 1.0 - left
        if frame.airy is not None:
            cover[frame.airy] = 0.0
        cover = with_glow_cover(cover, frame.state > 0, linear_table()[picture])
        picture = np.dstack([bared(picture, cover), (255.0 * cover + 0.5).astype(np.uint8)])
    # Replace pixels at edges by the mean of their samples.
    if frame.edges and overlay == "none":
        picture.reshape(-1, picture.shape[2])[frame.edges.pixels] = averaged(
            frame.edges, exposure, ground, clear
        )
    return picture


def seen_through(picture: np.ndarray, left: np.ndarray, ground: tuple[float, ...]) -> np.ndarray:
    """Add the ``ground`` to a ``picture`` (h, w, 3) uint8 of surfaces that let the share
    ``left`` (h, w) of it pass.

    The ground is a colour of the screen, so it is added after exposure and tone curve, to the
    linear light that the screen shows. Pixels without any surface have the ground already.
    """
    some = (left > 0.0) & (left < 1.0)
    found = picture.copy()
    light = linear_table()[picture[some]] + left[some][:, None] * np.array(ground, np.float32)
    found[some] = coded(np.minimum(light, 1.0))
    return found


def with_glow_cover(cover: np.ndarray, on: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the ``cover`` (…) of pixels or samples, with that of glow before nothing: its
    brightest channel, so that it is as bright over black, and hides little where it is dim.

    ``on`` (…) are those that show anything, and ``shown`` (…, 3) is their linear light on a screen.
    """
    return np.where(on & (cover == 0.0), shown.max(axis=-1), cover)


def bared(picture: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Return the colours of surfaces in a ``picture`` (h, w, 3) uint8 in which they cover
    pixels by ``cover`` (h, w): partly covered pixels are divided by it.
    """
    some = (cover > 0.0) & (cover < 1.0)
    found = picture.copy()
    found[some] = coded(np.minimum(linear_table()[picture[some]] / cover[some][:, None], 1.0))
    return found


def before_ground(
    radiance: np.ndarray, airy: np.ndarray | None, exposure: float, ground: tuple[float, ...]
) -> np.ndarray:
    """Add the ``ground`` to the ``radiance`` (…, 3) of pixels that are ``airy`` (…): glow hides
    nothing behind it.
    """
    if airy is None:
        return radiance
    behind = np.array(ground, np.float32) / np.float32(exposure)
    return np.where(airy[..., None], radiance + behind, radiance).astype(np.float32)


def averaged(
    edges: EdgeSamples, exposure: float, ground: tuple[float, ...], clear: bool
) -> np.ndarray:
    """Return the pixels at ``edges`` as the mean of the light that their samples show on a screen;
    (k, 3) uint8 sRGB.

    If the picture is ``clear``, it is (k, 4), and the last channel is the mean cover of the
    samples, from 0 to 255. The colours are then those of the surfaces alone: the sum of the light
    of the samples on them, over the sum of their covers. A sample of glow alone covers as much as
    its brightest channel.
    """
    light = before_ground(edges.light, None if clear else edges.airy, exposure, ground)
    # Average after the tone curve, as a screen shows it: before it, one bright sample would hide
    # all others. All samples are developed as one picture, with those of a pixel in each row.
    shown = linear_table()[lit(light, edges.on.astype(np.uint8), exposure, False, ground)]
    if not clear:
        # Samples on surfaces that let light pass show the background behind.
        if edges.left is not None:
            left = np.where(edges.on, edges.left, np.float32(0.0))
            behind = left[..., None] * np.array(ground, np.float32)
            shown = np.minimum(shown + behind, np.float32(1.0))
        return coded(shown.mean(axis=1))
    # The light of a sample has its cover as a factor already.
    sums = np.where(edges.on[..., None], shown, np.float32(0)).sum(axis=1)
    cover = with_glow_cover(edges.cover, edges.on, shown)
    light = sums / np.maximum(cover.sum(axis=1), MIN_PIXEL_COVER)[:, None]
    opacity = (255.0 * cover.mean(axis=1) + 0.5).astype(np.uint8)
    return np.column_stack([coded(np.minimum(light, 1.0)), opacity])


def coded(light: np.ndarray) -> np.ndarray:
    """Return the sRGB codes of linear ``light`` from 0 to 1, uint8."""
    return np.asarray(tone_table()[(light * (LEVELS - 1) + 0.5).astype(np.intp)])


@cache
def linear_table() -> np.ndarray:
    """Return the linear light of each sRGB code, (256,) float32."""
    return np.array([linear_of(code / 255.0) for code in range(256)], np.float32)


def lit(
    radiance: np.ndarray,
    state: np.ndarray,
    exposure: float,
    marked: bool,
    ground: tuple[float, ...] = BACKGROUND,
) -> np.ndarray:
    """Develop ``radiance`` (rows, columns, 3) to a picture of the same shape, uint8 sRGB; if
    ``marked``, hatch it by the ``state`` (rows, columns) of its pixels. Pixels of the state 0 show
    the ``ground``.
    """
    picture = np.empty(radiance.shape, np.uint8)
    colours = np.array([ground, HATCHING_COLOUR], np.float32)
    develop_rows(radiance, state, 0, exposure, colours, marked, tone_table(), picture)
    return picture


def with_errors(
    frame: Frame, exposure: float, ground: tuple[float, ...] = BACKGROUND
) -> np.ndarray:
    """Develop a picture under the colours of its errors; pixels without light, and thus without
    an estimate, are hatched.
    """
    known = frame.state >= CONVERGING
    picture = lit(
        frame.radiance, np.where(known, np.uint8(FINAL), frame.state), exposure, True, ground
    )
    below = picture[known].astype(np.uint16)
    above = error_colours(frame.total_error[known])
    picture[known] = (below * (256 - COVER) + above.astype(np.uint16) * COVER) >> 8
    return picture
