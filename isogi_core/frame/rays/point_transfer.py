"""Transfer of the points of a view: light that turns over a view at rest costs hardly any paths.

Paths that light a picture alone tell nothing about another rotation of its light. Once the light
turns, paths from the same points are projected to harmonics, as those of texels are, and kept. Any
rotation of the light then lights all points by a product (S1, eq. 9), without interpolation. Lobes
come by shadow rays, as over texels. Control pixels measure the picture, and the points with the
largest errors get light from paths of their own: see ``PictureCheck``.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from isogi_core.bake.refine import Place, sample_transfer
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import paths_of_truth
from isogi_core.frame.rays.own_light import REPLICAS, PixelLight
from isogi_core.frame.rays.pixel_rays import PATH_POINTS, passes
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.shot import Shot
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import Quaternion, View

FIRST_SAMPLES = 64
"""Paths of each point after which a picture is measured for the first time. Fewer leave too much
noise for any target below 5 %; they also cost no more than a few times the paths of the controls.
"""

FIRST_SHOWN_SAMPLES = 16
SHOWN_FACTOR = 4
"""Paths of each point in the first step, which is shown, and the factor on them in each further
one.
"""

MOST_BYTES = 64 << 20
"""Size of a transfer above which none is kept: that of a view with a third of 512 × 512 pixels on
the surface is 20 to 60 MB.
"""

NO_TEXEL = -1
"""Column of the lattice by which random numbers of points differ from those of all texels."""


@dataclass(frozen=True, eq=False)
class PointTransfer:
    """Transfer of the m points of a view, which was first lit under the rotation ``began``.

    ``sums`` has an array (m, REPLICAS, channels, n²) float32 for each layer of the plan: sums of
    harmonics over ``samples`` / REPLICAS paths of each replica. It is ``vain`` if all points took
    light of their own nevertheless.
    """

    began: Quaternion
    sums: tuple[np.ndarray, ...]
    samples: int = 0
    vain: bool = False

    @classmethod
    def begun(cls, shot: Shot) -> Self:
        """Return the transfer of a ``shot`` before any path was traced."""
        return cls(shot.view.light, ())

    @property
    def given_up(self) -> Self:
        """The transfer without its sums, marked as vain."""
        return replace(self, sums=(), samples=0, vain=True)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return sum(each.nbytes for each in self.sums)

    def grown(self, shot: Shot, until: int) -> Self:
        """Return the transfer with ``until`` paths of each point of a ``shot``. Raises
        Cancelled.
        """
        layers = layers_of(shot.light)
        gbuffer = shot.gbuffer
        # Paths do not branch: branches pay for texels, whose first samples are few and dear.
        spec = shot.light.spec
        spec = replace(spec, plan=replace(spec.plan, branches=1))
        traced = gbuffer.surface.traced(shot.tiles.run)
        points = gbuffer.shown(shot.tiles)
        more = until - self.samples
        # Copy the sums, as another thread may read them.
        if self.samples:
            sums = [each.copy() for each in self.sums]
        else:
            sums = [np.zeros(shape, np.float32) for shape in shapes_of(gbuffer, layers)]

        # Trace the paths of some points together, and add their harmonics to those of each layer.
        def _piece(a: int, b: int) -> None:
            place = place_of(points.part(slice(a, b)), traced)
            void = np.zeros(b - a, bool)
            found = sample_transfer(layers, place, void, spec, self.samples, more)
            for kept, layer, (halves, _) in zip(sums, layers, found, strict=True):
                kept[a:b] += halves[..., : layer.order**2]

        # Other work may go first between two passes.
        for some in passes(len(gbuffer.points), more, shot.tiles):
            first = some.start
            shot.tiles.run(
                lambda a, b: _piece(first + a, first + b),  # noqa: B023
                some.stop - some.start,
                PATH_POINTS,
            )
        return replace(self, sums=tuple(sums), samples=until)

    def lit(self, shot: Shot) -> PixelLight:
        """Return the light of all points of a ``shot`` without that of lobes, filtered. Raises
        Cancelled.
        """
        m = len(shot.gbuffer.points)
        light = np.zeros((m, REPLICAS, 3))
        for layer, sums in zip(layers_of(shot.light), self.sums, strict=True):
            light += times_light(sums, layer, shot.light)
        light *= shot.light.albedo
        # The sums of replicas stand for those of light that paths gathered.
        counts = np.full(m, self.samples // REPLICAS)
        places = np.arange(m)
        paths = paths_of_truth(shot.light, shot.gbuffer, places, shot.tiles)
        return PixelLight.of(places, Estimate(light, counts), paths, np.zeros(m))


def times_light(sums: np.ndarray, layer: Layer, light: RotatedLight) -> np.ndarray:
    """Multiply the ``sums`` (m, replicas, channels, n²) of a ``layer`` by a rotated ``light``;
    return linear RGB (m, replicas, 3).
    """
    met = light.light_of(layer)
    # A layer of one channel reflects all colours alike.
    if layer.channels == 1:
        return np.asarray(sums[:, :, 0] @ met.T.astype(np.float32), np.float64)
    return np.asarray(np.einsum("mrcn,cn->mrc", light.colours_of(layer, sums), met))


def place_of(points: SurfacePoints, traced: TracedSurface) -> Place:
    """Return ``points`` of a picture as places of texels, whose random numbers are their own."""
    m = len(points.pixels)
    names = np.zeros((m, 3), np.int32)
    names[:, 0] = points.pixels
    names[:, 2] = NO_TEXEL
    return (
        names,
        np.ascontiguousarray(points.points.T, np.float64),
        np.ascontiguousarray(points.normals.T, np.float64),
        np.full(m, traced.isovalue, np.float64),
    )


def layers_of(light: RotatedLight) -> tuple[Layer, ...]:
    """Return the layers of the plan, of which a transfer has sums."""
    return light.spec.plan.layers


def shapes_of(gbuffer: GBuffer, layers: tuple[Layer, ...]) -> list[tuple[int, int, int, int]]:
    """Return the shapes of the sums of a transfer."""
    m = len(gbuffer.points)
    return [(m, REPLICAS, layer.channels, layer.order**2) for layer in layers]


def may_keep_transfer(shot: Shot) -> bool:
    """Return True if a transfer can light the picture of a ``shot`` under all rotations: its light
    is kept as harmonics, its surface has one colour, and the transfer is not too large.
    """
    light = shot.light
    if light.spec.plan.representation != "transfer" or light.coloured:
        return False
    numbers = sum(math.prod(shape) for shape in shapes_of(shot.gbuffer, layers_of(light)))
    return numbers * np.dtype(np.float32).itemsize <= MOST_BYTES


def transfer_key(view: View) -> tuple[Any, ...]:
    """Return the cache key of the transfer of a view's points."""
    return PointTransfer, surface_key(view)
