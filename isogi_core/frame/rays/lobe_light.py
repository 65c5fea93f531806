"""Light that comes straight from lobes to the points of a view, along shadow rays."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.lobes import (
    LOBE_HALF_SEEN,
    PENUMBRA_RAYS,
    STRATIFIED_VARIANCE,
    add_halves,
    find_sides,
    light_points,
    mark_edges,
    see_discs,
    see_middles,
    see_rims,
    share_rays,
    spread_edges,
)
from isogi_core.kernels.shading.shadow_points import (
    ANY_TURN,
    FIRST_TURN_STRIDE,
    SAMPLING_TURNS,
    ShadowPoints,
    prepare_points,
    sort_by_turn,
)
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.lights import LampArrays
from isogi_core.model.environment import LUMINANCE_WEIGHTS

LOBE_POINTS = 4096
RIM_PAIRS = 1024
HALF_SEEN_PAIRS = 256
"""Surface points, pairs of points and lobes at edges of shadows, and such pairs in half-shadow, of
a tile.
"""


@dataclass(frozen=True, eq=False)
class LobeLight:
    """Light of lobes at a view's surface points: ``lit`` (m, 4) float32, in ``BakeSpec.unit``, see
    ``light_points``.

    It leaves a surface of the bake spec's own albedo.
    """

    lit: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.lit.nbytes

    def tinted(self, tint: np.ndarray) -> "LobeLight":
        """The light from a surface that reflects ``tint`` (3,) times as much of each colour."""
        if (tint == 1.0).all():
            return self
        if (tint == tint[0]).all():
            return LobeLight(self.lit * np.array([*tint, tint[0] ** 2], np.float32))
        colours = (self.lit[:, :3] * tint).astype(np.float32)
        grown = (colours @ LUMINANCE_WEIGHTS) / np.maximum(
            self.lit[:, :3] @ LUMINANCE_WEIGHTS, MIN_LIGHT
        )
        return LobeLight(np.column_stack([colours, self.lit[:, 3] * grown**2]).astype(np.float32))


@dataclass(frozen=True, eq=False)
class ShadowStarts:
    """What shadow rays of one view have in common, however the light turns.

    ``picture`` has its surface points, and ``ends`` (SAMPLING_TURNS + 1,) int64 where turns begin
    and end in their order.
    """

    picture: ShadowPoints
    ends: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes besides the G-buffer."""
        return sum(part.nbytes for part in self.picture[1:])


def find_starts(gbuffer: GBuffer, tiles: Tiles) -> ShadowStarts:
    """What shadow rays from the points of a G-buffer begin with. Raises Cancelled."""
    points = gbuffer.shown(tiles)
    m = len(gbuffer.points)
    ends = np.empty(SAMPLING_TURNS + 1, np.int64)
    places = (
        np.empty((m, 3)),
        np.empty((m, 4), np.int32),
        np.empty(m, np.bool_),
        np.empty(m, np.int32),
    )
    picture = ShadowPoints(points, gbuffer.rows, *places)
    traced = gbuffer.surface.traced(tiles.run)
    tiles.run(lambda a, b: prepare_points(traced, picture, (a, b)), m, LOBE_POINTS)
    sort_by_turn(gbuffer.pixels, gbuffer.shape[1], picture.order, ends)
    return ShadowStarts(picture, ends)


def find_lobes(
    light: RotatedLight, starts: ShadowStarts, traced: TracedSurface, tiles: Tiles
) -> LobeLight:
    """Find what comes straight from the lobes of a ``light``; of a view that moves by fewer rays.
    Raises Cancelled.
    """
    lamps = light.lobes
    moving = light.view.moving
    shadows = Shadows(traced, starts, lamps, tiles)
    seen = shadows.middles()
    if moving:
        halves = np.empty(0, np.int64)
    else:
        halves = shadows.edges(seen)
    lit = np.empty((shadows.points, 4), np.float32)
    tiles.run(
        lambda a, b: light_points(starts.picture, lamps, (a, b), moving, seen, lit),
        len(lit),
        LOBE_POINTS,
    )
    add_halves(lamps, halves, shadows.halves(halves, seen), lit)
    return LobeLight(lit)


@dataclass(frozen=True, eq=False)
class Shadows:
    """What the points of a picture see of directional ``lamps`` past the ``traced`` surface, by
    rays from ``starts``.

    It is the same however the work is cut into ``tiles``.
    """

    traced: TracedSurface
    starts: ShadowStarts
    lamps: LampArrays
    tiles: Tiles

    @property
    def picture(self) -> ShadowPoints:
        """The points."""
        return self.starts.picture

    @property
    def points(self) -> int:
        """How many points there are."""
        return len(self.picture.order)

    def middles(self) -> np.ndarray:
        """What all points see of lobes' middles, (lobes, m) uint8."""
        seen = np.empty((len(self.lamps.kinds), self.points), np.uint8)
        for first, last in pairwise(self.starts.ends.tolist()):

            def _piece(a: int, b: int, first: int = first) -> None:
                see_middles(self.traced, self.picture, self.lamps, (first + a, first + b), seen)

            self.tiles.run(_piece, last - first, tile_of(last - first, LOBE_POINTS, self.tiles))
        return seen

    def edges(self, seen: np.ndarray) -> np.ndarray:
        """Put into ``seen`` what points at the edges of shadows see of lobes' rims; the pairs in
        half-shadow, int64.

        Those that are wide are followed by points FIRST_TURN_STRIDE apart, and filled turn by turn;
        their ends are sought as far.
        """
        asked = np.empty_like(seen)

        def _piece(a: int, b: int) -> None:
            mark_edges(self.picture, self.lamps, (a, b), seen, asked)

        self.tiles.run(_piece, self.points, LOBE_POINTS)
        halves = self._ask(np.flatnonzero(asked), seen)
        found = [halves]
        while len(halves):
            found.append(halves := self._ask_about(halves, 0, seen, asked))
        for turn in range(1, SAMPLING_TURNS):
            found.append(self._ask_about(np.concatenate(found), turn, seen, asked))
        halves = np.concatenate(found)
        for _ in range(FIRST_TURN_STRIDE):
            found.append(halves := self._ask_about(halves, ANY_TURN, seen, asked))
        return np.sort(np.concatenate(found))

    def _ask(self, pairs: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Put into ``seen`` what ``pairs`` see of each other by their rims; those of them in
        half-shadow.
        """
        seen.reshape(-1)[pairs] = sees = self._rims(pairs)
        return pairs[sees == LOBE_HALF_SEEN]

    def _ask_about(
        self, halves: np.ndarray, turn: int, seen: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """The pairs about ``halves`` that are in half-shadow, too, and not ``asked`` yet: see
        ``spread_edges``.
        """
        more = np.empty(8 * len(halves), np.int64)
        count, last = spread_edges(self.picture, self.lamps, halves, turn, seen, asked, more)
        return np.concatenate([more[last:], self._ask(more[:count], seen)])

    def _rims(self, pairs: np.ndarray) -> np.ndarray:
        """What the points and lobes in ``pairs`` see of each other by their rims; (pairs,)
        uint8.
        """
        sees = np.empty(len(pairs), np.uint8)

        def _piece(a: int, b: int) -> None:
            see_rims(self.traced, self.picture, self.lamps, pairs[a:b], sees[a:b])

        self.tiles.run(_piece, len(pairs), tile_of(len(pairs), RIM_PAIRS, self.tiles))
        return sees

    def halves(self, pairs: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Shares of lobes that points see in part, and their variance; (pairs, 2)."""
        sides = np.empty(len(pairs), np.uint8)
        places = np.empty(self.points, np.int32)
        find_sides(self.picture, pairs, seen, sides)
        rays, own, shares = (
            np.array(PENUMBRA_RAYS)[np.bitwise_count(sides)],
            *np.empty((2, len(pairs), 2)),
        )
        for count in np.unique(rays).tolist():
            own[rays == count] = self._shares(pairs[rays == count], count)

        for first, last in pairwise(
            np.searchsorted(pairs, self.points * np.arange(len(seen) + 1)).tolist()
        ):
            places[pairs[first:last] % self.points] = np.arange(first, last)

            def _piece(a: int, b: int, first: int = first) -> None:
                share_rays(
                    self.picture,
                    self.lamps,
                    pairs,
                    sides,
                    places,
                    own,
                    (first + a, first + b),
                    shares,
                )

            self.tiles.run(_piece, last - first, LOBE_POINTS)
        return shares

    def _shares(self, pairs: np.ndarray, rays: int) -> np.ndarray:
        """The shares of lobes that points see, by ``rays`` of each pair."""
        shares = np.empty((len(pairs), 2))

        def _piece(a: int, b: int) -> None:
            see_discs(
                self.traced,
                self.picture,
                self.lamps,
                pairs[a:b],
                rays,
                STRATIFIED_VARIANCE[rays],
                shares[a:b],
            )

        self.tiles.run(_piece, len(pairs), HALF_SEEN_PAIRS * PENUMBRA_RAYS[0] // rays)
        return shares


def tile_of(total: int, most: int, tiles: Tiles) -> int:
    """The size of tiles that are even, but of a quarter of the ``most`` at least: for less no
    thread is woken.
    """
    return min(max(tiles.even(total), most // 4), most)
