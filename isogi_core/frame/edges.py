"""Smooth edges: pixels at silhouettes, creases and edges of shadows take more samples.

Each sample casts a ray, and borrows its light from the pixels around that show the surface, or the
same wall, next to its hit: no sample is shaded by itself.
"""

from dataclasses import replace

import numpy as np

from isogi_core.frame.eye_glow import EyeGlow
from isogi_core.frame.film import lit
from isogi_core.frame.frame import EdgeSamples, Frame
from isogi_core.frame.gbuffer import TILE_RAYS, sight_of, view_pinhole
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.edges import Shown, borrow_light, find_contrasts
from isogi_core.kernels.tracing.camera import trace_places
from isogi_core.kernels.tracing.walls import NO_WALL, Walls
from isogi_core.prepared.prepared_scene import PreparedScene

COUNTS = (16, 8, 4)
"""Samples that a pixel at an edge may have: the largest number that BUDGET allows for all edges."""


BUDGET = 0.8
MIN_SAMPLE_BUDGET = 1 << 16
"""Largest number of samples of a picture, over its pixels: if edges are everywhere, the
strongest have them. MIN_SAMPLE_BUDGET samples are always allowed.
"""


MIN_EDGE_CONTRAST = 12
"""Difference between neighbours, of 255 steps, from which a pixel counts as at an edge."""


SILHOUETTE = 255
"""Contrast of neighbours of which one alone shows the surface."""


def find_edges(picture: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, int]:
    """Find the pixels at edges of a ``picture`` (h, w, 3) uint8, by their ``state`` (h, w);
    return them, and the number of samples for each.
    """
    found = np.empty(state.shape, np.uint8)
    most = max(int(BUDGET * state.size), MIN_SAMPLE_BUDGET)
    find_contrasts(picture, state, found)
    contrast = found.ravel()
    edges = np.flatnonzero(contrast >= MIN_EDGE_CONTRAST)
    # All edges have the same number of samples; if even the fewest are too many, the strongest
    # edges alone have some.
    count = next((each for each in COUNTS if len(edges) * each <= most), COUNTS[-1])
    if len(edges) * count > most:
        strongest = np.argsort(contrast[edges], kind="stable")[::-1][: max(most // count, 1)]
        edges = np.sort(edges[strongest])
    return edges.astype(np.uint32), count


def pattern(count: int) -> np.ndarray:
    """Return the places of ``count`` samples in a pixel, (count, 2) float32 in [0, 1): each in a
    row and a column of its own.

    Source: Halton 1964 in base 2, Hammersley's set, shifted so that its middle is the pixel's.
    """
    order = np.arange(count)
    reverse = np.zeros(count)
    bits = count.bit_length() - 1
    for bit in range(bits):
        reverse += (order >> bit & 1) / 2.0 ** (bit + 1)
    return np.stack([(order + 0.5) / count, reverse + 0.5 / count], axis=-1).astype(np.float32)


def places_in(pixels: np.ndarray, count: int, width: int) -> np.ndarray:
    """Return the places (pixels · count, 2; x, y) float32 of ``count`` samples in each of some
    ``pixels`` (k,) of a picture.
    """
    corners = np.stack(np.divmod(pixels, width)[::-1], axis=-1).astype(np.float32)
    return np.asarray((corners[:, None] + pattern(count)).reshape(-1, 2))


def smooth_edges(frame: Frame, prepared: PreparedScene, tiles: Tiles) -> Frame:
    """Return the ``frame`` of a scene with more samples at its edges. Raises Cancelled."""
    exposure = prepared.scene.default_exposure
    glow = EyeGlow.of(prepared, frame.view.glow)
    return replace(frame, edges=sample_edges(frame, exposure, tiles, prepared.walls_in_view, glow))


def sample_edges(
    frame: Frame,
    exposure: float,
    tiles: Tiles,
    walls: Walls | None = None,
    glow: EyeGlow | None = None,
) -> EdgeSamples | None:
    """Sample the edges that a ``frame`` has at its ``exposure``; return None if it has none. Raises
    Cancelled.

    ``walls`` and the faces of a window have edges as the surface has. Samples that miss all of
    these show the ``glow``, if there is any.
    """
    # Find edges in the developed picture, as a screen shows it: contrasts there are those that one
    # sees.
    pixels, count = find_edges(
        lit(frame.radiance, frame.state, exposure, marked=False), frame.state
    )
    if not len(pixels):
        return None
    places = places_in(pixels, count, frame.view.width)
    light = np.zeros((len(places), 3), np.float32)
    on = np.zeros(len(places), np.bool_)
    view = frame.view
    gbuffer = frame.gbuffer
    camera = view_pinhole(view, gbuffer.spacing)
    traced = gbuffer.surface.traced(tiles.run)
    shown = shown_by(frame)
    sight = sight_of(view, gbuffer.spacing, walls)

    # Cast the rays of samples, and borrow the light of pixels near their hits.
    def _piece(a: int, b: int) -> None:
        found = np.empty(b - a, np.uint32)
        points = np.empty((b - a, 3), np.float32)
        numbers = np.empty(b - a, np.int8)
        hits = trace_places(traced, sight, camera, places[a:b], found, points, numbers)
        on[a:b][found[:hits]] = True
        borrow_light(shown, places[a:b], found[:hits], points[:hits], numbers[:hits], light[a:b])

    tiles.run(_piece, len(places), TILE_RAYS)
    # Samples that meet nothing may show glow in front of the background.
    airy = np.zeros_like(on)
    if glow is not None:
        misses = np.flatnonzero(~on)
        light[misses] = glow.through(frame, places[misses], tiles)
        airy[misses] = light[misses].any(axis=1)
        on |= airy
    shape = len(pixels), count
    return EdgeSamples(
        pixels,
        light.reshape(*shape, 3),
        on.reshape(shape),
        None if glow is None else airy.reshape(shape),
    )


def shown_by(frame: Frame) -> Shown:
    """Return the pixels of a ``frame`` as the kernels take them: the points that they show, and
    their light.
    """
    view = frame.view
    gbuffer = frame.gbuffer
    rows = gbuffer.rows
    points = gbuffer.points
    numbers = np.full(len(points), NO_WALL, np.int8)
    # Number the points of walls and faces after those of the surface.
    for others in (gbuffer.walls, gbuffer.faces):
        count = len(others.pixels)
        if count:
            rows.flat[others.pixels] = np.arange(len(points), len(points) + count, dtype=np.int32)
            points = np.concatenate([points, others.points])
            numbers = np.concatenate([numbers, others.numbers])
    pixel = view.camera.pixel_size(view.whole[1])
    x, y, z = gbuffer.spacing
    scale = np.float32(x), np.float32(y), np.float32(z)
    eye = np.float32(gbuffer.eye[0]), np.float32(gbuffer.eye[1]), np.float32(gbuffer.eye[2])
    light = frame.radiance.reshape(-1, 3)
    return Shown(rows, points, numbers, light, scale, eye, np.float32(1.0 / pixel**2))
