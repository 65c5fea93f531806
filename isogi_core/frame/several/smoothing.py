"""Smooth the edges in pictures of several surfaces: samples are peeled as pixels are, and each
layer borrows light of the same layer nearby.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from isogi_core.frame.edges import find_edges, places_in, shown_by
from isogi_core.frame.eye_glow import EyeGlow, rays_through
from isogi_core.frame.film import lit
from isogi_core.frame.frame import EdgeSamples, Frame
from isogi_core.frame.gbuffer import TILE_RAYS
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.frame.several.peels import Hits, Peeler
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.edges import Shown, borrow_light
from isogi_core.kernels.tracing.camera import WINDOW_FACE
from isogi_core.kernels.tracing.peels import FIRST_WALL_SIDE
from isogi_core.kernels.tracing.walls import NO_WALL


def smooth_surfaces(
    frame: Frame, peeler: Peeler, exposure: float, tiles: Tiles, glow: EyeGlow | None = None
) -> Frame:
    """Return the ``frame`` with more samples at the edges that it has at its ``exposure``, and
    with the ``glow``. Raises Cancelled.
    """
    pixels, count = find_edges(
        lit(frame.radiance, frame.state, exposure, marked=False), frame.state
    )
    if not len(pixels):
        return frame
    places = places_in(pixels, count, frame.view.width)
    pictures = pictures_of(frame)
    light = np.zeros((len(places), 3), np.float32)
    left = np.empty(len(places), np.float32)
    on = np.zeros(len(places), np.bool_)
    found = dict[int, Hits]()

    # Peel the rays of samples, and add up the light of all layers that they meet.
    def _piece(a: int, b: int) -> None:
        hits, left[a:b] = peeler.through(*places[a:b].T)
        on[a:b][hits.pixels] = True
        for side, picture in pictures.items():
            add_light(hits, side, picture, frame.view.height, places[a:b], light[a:b])
        hits.pixels[:] += np.uint32(a)
        found[a] = hits

    tiles.run(_piece, len(places), TILE_RAYS)
    # Glow in front of each layer, and behind all, adds to the samples.
    if glow is not None:
        layers = by_layer(Hits.joined(list(found.values())))
        light += glow.lit(glow.before_layers(*rays_through(frame, places), layers, tiles))
        on |= light.any(axis=1)
    each = len(pixels), count
    edges = EdgeSamples(pixels, light.reshape(*each, 3), on.reshape(each), left=left.reshape(each))
    return replace(frame, edges=edges)


def pictures_of(frame: Frame) -> dict[int, Shown]:
    """Return the tall picture of each side in a ``frame``, by the number of the side in
    ``Peeled``; and the picture with the faces of its window.
    """
    whole = shown_by(frame)
    tall = {part.side.peeled: shown_by(part.frame) for part in parts_of(frame)}
    return {int(WINDOW_FACE): whole} | {
        side: picture._replace(fine=whole.fine) for side, picture in tall.items()
    }


def by_layer(hits: Hits) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the ``hits`` of rays, layer behind layer: rays, each once, points, and weights."""
    order = np.argsort(hits.pixels, kind="stable")
    rays = hits.pixels[order]
    first = np.searchsorted(rays, rays)
    # A stable sort keeps the hits of each ray in their order; the place of a hit after its ray's
    # first is its layer.
    depth = np.arange(len(rays)) - first
    for layer in range(int(depth.max(initial=-1)) + 1):
        rows = order[depth == layer]
        yield hits.pixels[rows], hits.points[rows], hits.weights[rows]


def add_light(
    hits: Hits, side: int, picture: Shown, height: int, places: np.ndarray, light: np.ndarray
) -> None:
    """Add the light of all ``hits`` on a ``side`` to the ``light`` (n, 3) of rays through
    ``places`` (n, 2; x, y).

    It is borrowed from pixels around in the same layer of the side's tall ``picture``, and counts
    by the weight of the hit.
    """
    # All walls are one side, and have one picture. The face of a window has a negative number.
    some = np.flatnonzero(np.minimum(hits.sides, FIRST_WALL_SIDE) == side)
    rays = hits.pixels[some]
    down = np.array([0.0, height], np.float32)
    # Layer k of a tall picture lies k heights below.
    there = places[rays] + hits.ranks[some][:, None] * down
    found = np.zeros((len(some), 3), np.float32)
    each = np.arange(len(some), dtype=np.uint32)
    borrow_light(picture, there, each, hits.points[some], wall_numbers(hits.sides[some]), found)
    np.add.at(light, rays, hits.weights[some][:, None] * found)


def wall_numbers(sides: np.ndarray) -> np.ndarray:
    """Return the walls that hits on these ``sides`` (k,) are on: NO_WALL on a surface, WINDOW_FACE
    on a face; (k,) int8.
    """
    walls = np.where(sides < FIRST_WALL_SIDE, np.minimum(sides, NO_WALL), sides - FIRST_WALL_SIDE)
    return walls.astype(np.int8)
