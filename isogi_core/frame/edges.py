"""Smooth edges: pixels at silhouettes, creases and edges of shadows take more samples."""

import math
from dataclasses import replace

import numpy as np

from isogi_core.frame.eye_glow import EyeGlow
from isogi_core.frame.film import lit
from isogi_core.frame.frame import EdgeSamples, Frame
from isogi_core.frame.gbuffer import TILE_RAYS, sight_of, view_pinhole
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.edges import Shown, borrow_light, find_contrasts
from isogi_core.kernels.tracing.camera import trace_places
from isogi_core.kernels.tracing.walls import Walls
from isogi_core.prepared.prepared_scene import PreparedScene

COUNTS = (16, 8, 4)
"""Samples that a pixel at an edge may have: the most that the BUDGET allows for all edges."""


BUDGET = 0.8
MIN_SAMPLE_BUDGET = 1 << 16
"""Samples of a picture, at most, over its pixels: where edges are everywhere, the strongest have
them. MIN_SAMPLE_BUDGET samples are always allowed.
"""


MIN_EDGE_CONTRAST = 12
"""How much neighbours differ, of 255 steps, where a pixel counts as at an edge."""


SILHOUETTE = 255
"""What that is where one of them alone shows the surface."""


def find_edges(picture: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, int]:
    """The pixels at edges of a ``picture`` (h, w, 3) uint8, by ``state`` (h, w); and samples for
    each of them.
    """
    found = np.empty(state.shape, np.uint8)
    most = max(int(BUDGET * state.size), MIN_SAMPLE_BUDGET)
    find_contrasts(picture, state, found)
    contrast = found.ravel()
    edges = np.flatnonzero(contrast >= MIN_EDGE_CONTRAST)
    count = next((each for each in COUNTS if len(edges) * each <= most), COUNTS[-1])
    if len(edges) * count > most:
        strongest = np.argsort(contrast[edges], kind="stable")[::-1][: max(most // count, 1)]
        edges = np.sort(edges[strongest])
    return edges.astype(np.uint32), count


def pattern(count: int) -> np.ndarray:
    """Places of ``count`` samples in a pixel, (count, 2) float32 in [0, 1): each in its own row and
    column.

    Source: Halton 1964 in base 2, Hammersley's set, shifted so that its middle is the pixel's.
    """
    order = np.arange(count)
    reverse = np.zeros(count)
    bits = count.bit_length() - 1
    for bit in range(bits):
        reverse += (order >> bit & 1) / 2.0 ** (bit + 1)
    return np.stack([(order + 0.5) / count, reverse + 0.5 / count], axis=-1).astype(np.float32)


def places_in(pixels: np.ndarray, count: int, width: int) -> np.ndarray:
    """Places (pixels · count, 2; x, y) float32 of so many samples in each of some ``pixels`` (k,)
    of a picture.
    """
    corners = np.stack(np.divmod(pixels, width)[::-1], axis=-1).astype(np.float32)
    return np.asarray((corners[:, None] + pattern(count)).reshape(-1, 2))


def smooth_edges(frame: Frame, prepared: PreparedScene, tiles: Tiles) -> Frame:
    """The ``frame`` of a prepared scene with more samples where it has edges. Raises Cancelled."""
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
    """More samples where a ``frame`` has edges at its ``exposure``; None where it has none. Raises
    Cancelled.

    Walls, where there are ``walls``, have edges as the surface has, and so have the faces of a
    window. Samples beside all of these show what glows, where there is any ``glow``.
    """
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

    def _piece(a: int, b: int) -> None:
        found = np.empty(b - a, np.uint32)
        points = np.empty((b - a, 3), np.float32)
        hits = trace_places(traced, sight, camera, places[a:b], found, points)
        on[a:b][found[:hits]] = True
        borrow_light(shown, places[a:b], found[:hits], points[:hits], light[a:b])

    tiles.run(_piece, len(places), TILE_RAYS)
    airy = np.zeros_like(on)
    if glow is not None:
        beside = np.flatnonzero(~on)
        light[beside] = glow.through(frame, places[beside], tiles)
        on[beside] = airy[beside] = light[beside].any(axis=1)
    each = len(pixels), count
    if glow is not None:
        alone = airy.reshape(each)
    else:
        alone = None
    return EdgeSamples(pixels, light.reshape(*each, 3), on.reshape(each), alone)


def shown_by(frame: Frame) -> Shown:
    """What the pixels of a ``frame`` show, as the kernels take it."""
    view = frame.view
    gbuffer = frame.gbuffer
    rows = gbuffer.rows
    points = gbuffer.points
    for beside in (gbuffer.walls, gbuffer.faces):
        if len(beside.pixels):
            rows.flat[beside.pixels] = np.arange(
                len(points), len(points) + len(beside.pixels), dtype=np.int32
            )
            points = np.concatenate([points, beside.points])
    pixel = 2.0 * math.tan(math.radians(view.camera.fov) / 2.0) / view.whole[1]
    x, y, z = gbuffer.spacing
    scale = np.float32(x), np.float32(y), np.float32(z)
    eye = np.float32(gbuffer.eye[0]), np.float32(gbuffer.eye[1]), np.float32(gbuffer.eye[2])
    return Shown(
        rows, points, frame.radiance.reshape(-1, 3), scale, eye, np.float32(1.0 / pixel**2)
    )
