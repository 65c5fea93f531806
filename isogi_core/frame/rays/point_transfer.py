"""Transfer of the points of a view: light that turns over a view at rest costs hardly any paths.

Paths that light a picture alone tell nothing about another rotation of its light. Once the light
turns, paths from the same points are projected to harmonics, as those of texels are, and kept. Any
rotation of the light then lights all points by a product (S1, eq. 9), without interpolation. Lobes
come by shadow rays, as over texels. Control pixels measure the picture, and the points with the
largest errors get light from paths of their own: see ``PictureCheck``.
"""

import math
import threading
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from isogi_core.bake.refine import Place, sample_transfer
from isogi_core.bake.texel_light import next_level
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import paths_of_truth
from isogi_core.frame.rays.own_light import REPLICAS, PixelLight, settle
from isogi_core.frame.rays.pixel_rays import PATH_POINTS, passes
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.shot import Shot
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import Quaternion, View
from isogi_core.model.volume import Isovalue

FIRST_SAMPLES = 64
"""Paths of each point before a picture is measured for the first time. Fewer leave too much noise
for any target below 5 %, and cost no more than a few times the paths of the controls.
"""

FIRST_SHOWN_SAMPLES = 16
"""Paths of each point in the first step, which is shown."""

OUTSIDE_LATTICE = -1
"""Lattice index along x of points that are no texels: it gives them random numbers of their own."""


@dataclass(frozen=True, eq=False)
class PointTransfer:
    """Transfer of m points after ``samples`` paths of each.

    ``sums`` has an array (m, REPLICAS, channels, n²) float32 for each layer of the plan: sums of
    harmonics over the paths of each replica.
    """

    sums: tuple[np.ndarray, ...] = ()
    samples: int = 0

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return sum(each.nbytes for each in self.sums)

    def grown(self, shot: Shot, until: int) -> Self:
        """Return the transfer with ``until`` paths of each point of a ``shot``: a level of samples.
        Raises Cancelled.
        """
        # Add level after level, so that rounding does not depend on the steps that were taken.
        found = self
        while found.samples < until:
            found = found._on_next_level(shot)
        return found

    def _on_next_level(self, shot: Shot) -> Self:
        """Return the transfer with twice as many paths, or the first ones."""
        layers = layers_of(shot.light)
        gbuffer = shot.gbuffer
        isovalue = gbuffer.isovalue
        points = gbuffer.shown(shot.tiles)
        samples = next_level(self.samples)
        more = samples - self.samples
        # Paths do not branch: branches pay off for texels, whose first samples are few and dear.
        spec = shot.light.spec
        spec = replace(spec, plan=replace(spec.plan, branches=1))
        # Copy the sums, as another thread may read them.
        if self.samples:
            sums = [each.copy() for each in self.sums]
        else:
            sums = [np.zeros(shape, np.float32) for shape in shapes_of(gbuffer, layers)]

        # Trace the paths of some points together, and add their harmonics to those of each layer.
        def _piece(a: int, b: int) -> None:
            names = names_of(points.pixels[a:b])
            place = place_of(names, points.points[a:b], points.normals[a:b], isovalue)
            none_void = np.zeros(b - a, bool)
            found = sample_transfer(layers, place, none_void, spec, self.samples, more)
            for kept, layer, (replicas, _) in zip(sums, layers, found, strict=True):
                kept[a:b] += replicas[..., : layer.order**2]

        # Other work may go first between two passes.
        for some in passes(len(gbuffer.points), more, shot.tiles):
            first = some.start
            shot.tiles.run(
                lambda a, b: _piece(first + a, first + b),  # noqa: B023
                some.stop - some.start,
                PATH_POINTS,
            )
        return replace(self, sums=tuple(sums), samples=samples)

    def lit(self, shot: Shot) -> "TransferredLight":
        """Return the light of all points of a ``shot``. Raises Cancelled."""
        m = len(shot.gbuffer.points)
        light = np.empty((m, REPLICAS, 3))

        def _piece(a: int, b: int) -> None:
            some = tuple(each[a:b] for each in self.sums)
            light[a:b] = times_light(some, layers_of(shot.light), shot.light)

        shot.tiles.run(_piece, m, shot.tiles.even(m))
        # Filter it as if paths had gathered it.
        places = np.arange(m)
        estimate = Estimate(light, np.full(m, self.samples // REPLICAS))
        paths = paths_of_truth(shot.light, shot.gbuffer, places, shot.tiles)
        filtered = PixelLight.of(places, estimate, paths, np.zeros(m))
        return TransferredLight(filtered.light.astype(np.float32), filtered.variance, self.samples)


@dataclass(frozen=True, eq=False)
class TransferredLight:
    """Light of the m points of a view by their transfer after ``samples`` paths of each, without
    that of lobes: filtered ``light`` (m, 3), linear RGB, and the ``variance`` (m,) of its
    luminance.
    """

    light: np.ndarray
    variance: np.ndarray
    samples: int = 0

    @classmethod
    def none(cls) -> Self:
        """Return light of no points."""
        return cls(np.empty((0, 3), np.float32), np.empty(0))

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.light.nbytes + self.variance.nbytes

    def show(self, framebuffer: Framebuffer, gbuffer: GBuffer, light: RotatedLight) -> None:
        """Write the light into a picture of a G-buffer. Its pixels become final."""
        framebuffer.radiance[gbuffer.pixels] = np.clip(self.light, 0.0, np.finfo(np.float32).max)
        settle(framebuffer, gbuffer.pixels, self.variance, light)


@dataclass(eq=False)
class ViewTransfer:
    """The transfer of the points of one view, which all rotations of its light share. Safe to use
    from many threads.

    - ``before``: rotation of the light when paths lit the view.
    - ``first``: rotation for which the first paths of the transfer were traced; None if none were.
    - ``newest``: the transfer with the most paths.
    - ``vain``: the largest target error at which all points took light of their own under the first
      rotation, so that their transfer spared nothing.
    """

    before: Quaternion
    first: Quaternion | None = None
    newest: PointTransfer = field(default_factory=PointTransfer)
    vain: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.newest.nbytes

    def serves(self, shot: Shot) -> bool:
        """Return True if it is to light the picture of a ``shot``."""
        turned = self.first is not None or shot.view.light != self.before
        return turned and not self.is_vain(shot)

    def is_vain(self, shot: Shot) -> bool:
        """Return True if it was given up for pictures with the target of a ``shot``."""
        return shot.goal.error <= self.vain

    def grow(self, shot: Shot, until: int) -> PointTransfer:
        """Trace paths until each point of a ``shot`` has ``until``, unless it has; return the
        transfer. A thread that asks meanwhile waits. Raises Cancelled.
        """
        with self._lock:
            if self.newest.samples < until:
                if self.first is None:
                    self.first = shot.view.light
                self.newest = self.newest.grown(shot, until)
            return self.newest

    def give_up(self, shot: Shot) -> None:
        """Note that all points of a ``shot`` took light of their own. If it has the first rotation
        that the transfer lit, pictures with its target error or a smaller one will not use the
        transfer, and its sums are dropped.

        The picture of a later rotation may be so dark that the transfer spares it no paths. That
        is no reason to give it up: its paths were traced before.
        """
        with self._lock:
            if shot.view.light == self.first:
                self.vain = max(self.vain, shot.goal.error)
                self.newest = PointTransfer()


def next_shown(samples: int) -> int:
    """Return the number of paths of each point at which a transfer of so many ``samples`` is shown
    next.
    """
    if samples < FIRST_SHOWN_SAMPLES:
        return FIRST_SHOWN_SAMPLES
    return max(next_level(samples), FIRST_SAMPLES)


def times_light(
    sums: tuple[np.ndarray, ...], layers: tuple[Layer, ...], light: RotatedLight
) -> np.ndarray:
    """Multiply the ``sums`` of transfer of some ``layers``, (m, replicas, channels, n² or more)
    each, by a rotated ``light``; return the radiance that leaves the surface, linear RGB (m,
    replicas, 3).
    """
    found = np.zeros((*sums[0].shape[:2], 3))
    for each, layer in zip(sums, layers, strict=True):
        reflected = light.albedo[:, None] * light.light_of(layer)
        n = min(layer.order**2, reflected.shape[1])
        # Layers of one channel reflect all colours alike. Others are brought to the three colours.
        if layer.channels == 1:
            found += each[:, :, 0, :n] @ reflected[:, :n].T.astype(each.dtype)
        else:
            colours = light.colours_of(layer, each)
            found += np.einsum("mrcn,cn->mrc", colours[..., :n], reflected[:, :n])
    return found


def names_of(pixels: np.ndarray) -> np.ndarray:
    """Return indices in place of those of texels, (m, 3; z, y, x) int32, for the points that the
    ``pixels`` (m,), picture indices, show.
    """
    names = np.zeros((len(pixels), 3), np.int32)
    names[:, 0] = pixels
    names[:, 2] = OUTSIDE_LATTICE
    return names


def place_of(
    names: np.ndarray, points: np.ndarray, normals: np.ndarray, isovalue: Isovalue
) -> Place:
    """Return surface points in the form in which a bake takes texels, so that its paths start
    exactly there.

    ``names`` (m, 3; z, y, x) int32 take the place of texels' indices, which a bake reads only to
    seed random numbers. ``points`` (m, 3) are in index space, ``normals`` (m, 3) are outward unit
    world vectors; all points lie on one surface, at the ``isovalue``.
    """
    here, outward = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    return names, here, outward, np.full(len(names), isovalue, np.float64)


def layers_of(light: RotatedLight) -> tuple[Layer, ...]:
    """Return the layers of the plan, of which a transfer has sums."""
    return light.spec.plan.layers


def shapes_of(gbuffer: GBuffer, layers: tuple[Layer, ...]) -> list[tuple[int, int, int, int]]:
    """Return the shapes of the sums of a transfer."""
    m = len(gbuffer.points)
    return [(m, REPLICAS, layer.channels, layer.order**2) for layer in layers]


def may_keep_transfer(shot: Shot, most: int) -> bool:
    """Return True if a transfer can light the picture of a ``shot`` under all rotations: its light
    is kept as harmonics, its surface has one colour, and the transfer takes at most ``most`` bytes.
    """
    light = shot.light
    if light.spec.plan.representation != "transfer" or light.coloured:
        return False
    numbers = sum(math.prod(shape) for shape in shapes_of(shot.gbuffer, layers_of(light)))
    return numbers * np.dtype(np.float32).itemsize <= most


def transfer_key(view: View) -> tuple[Any, ...]:
    """Return the cache key of the transfer of a view's points."""
    return ViewTransfer, surface_key(view)
