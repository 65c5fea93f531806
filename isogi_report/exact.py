"""Exact counterparts of what a frame reads: texels with hardly any noise, and light at the pixels'
own points.
"""

from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.refine import Place, sample_glow, sample_transfer
from isogi_core.bake.texel_light import Light
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import variance_of_mean
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.scene_plan import GLOW_KIND, GlowLayer, Layer
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference
from isogi_report.bench import Bake, Bench, ViewBake
from isogi_report.metrics import luminance_of

OUTSIDE_LATTICE = -1
"""Where points stand in the lattice, for their random numbers' sake: outside it."""

POINTS_A_PIECE = 64
"""Points that one thread lights in one go."""

TRANSFER_PATHS = 1024
"""Paths from each pixel that transfer of its own is made of."""


CONVERGED_SAMPLE_FACTOR = 4
"""How many times the samples that a texel of the frame has make converged light of it, at most."""

MIN_EXACT_SAMPLES = 256
MAX_EXACT_SAMPLES = 16384
"""Bounds of these samples."""


@dataclass(frozen=True, eq=False)
class Lit:
    """``light`` (m,) float64, the luminance of surface pixels, and the ``noise`` (m,), its
    variance.
    """

    light: np.ndarray
    noise: np.ndarray


def lit_by_frame(frame: Frame) -> Lit:
    """A frame's surface pixels, with the noise that their texels tell."""
    on = frame.state > 0
    light = luminance_of(frame.leaving[on])
    return Lit(light, (frame.error[on] * light) ** 2)


def lit_by_paths(best: Reference) -> Lit:
    """The surface pixels of a reference."""
    return Lit(luminance_of(best.mean[best.on]), best.variance[best.on].astype(np.float64))


def reference_difference(one: Reference, other: Reference) -> Lit:
    """What one reference's surface pixels have more of than the other's, and the variance of that.

    Both are of the same random numbers, so that most of their noise may cancel: it is estimated
    from the differences of their replicas.
    """
    differences = replicas(one) - replicas(other)
    return Lit(luminance_of(differences.mean(axis=1)), variance_of_mean(differences))


def replicas(best: Reference) -> np.ndarray:
    """The mean of each replica of a reference, (m, replicas, 3)."""
    return best.sums * (best.sums.shape[1] / best.samples)


def short_paths(bench: Bench) -> Reference:
    """The reference under the lights themselves, with the plan's bounces."""
    return bench.reference(bench.best.samples, bounces=bench.scene.bounces)


def own_light(bench: Bench) -> Lit:
    """The surface pixels lit as texels of their own would be: the light that interpolation is to
    come to.
    """
    if not cuts_harmonics(bench.scene):
        return lit_by_paths(short_paths(bench))
    return bench.once("own light", lambda: lit_by_transfer(bench, TRANSFER_PATHS))


def cuts_harmonics(scene: Scene) -> bool:
    """Whether the plan's texels keep harmonics that are fewer than the light's."""
    return scene.plan.representation != "irradiance" and not scene.inputs.constant


def lit_by_transfer(bench: Bench, samples: int) -> Lit:
    """Surface pixels lit by transfer of their own, of the plan's orders, from ``samples`` paths
    each, unrounded.

    What comes straight from lobes is the frame's. Raises Cancelled.
    """
    renderer = bench.renderer(bench.scene)
    view = bench.view
    spec = renderer.caches.spec(view.shading)
    gbuffer = renderer.gbuffer(view)
    normals = gbuffer.normals(bench.tiles)
    turned = RotatedLight(spec, view)
    halves = np.zeros((len(gbuffer.points), 2, 3))

    def piece(a: int, b: int) -> None:
        place = bake_place(gbuffer.pixels[a:b], gbuffer.points[a:b], normals[a:b], gbuffer.isovalue)
        halves[a:b] = light_of_halves(turned, place, samples)

    bench.tiles.run(piece, len(halves), POINTS_A_PIECE)
    if turned.coloured:
        halves *= turned.tints(gbuffer, bench.tiles)[:, None]
    half = (halves[:, 0] - halves[:, 1]) @ LUMINANCE_WEIGHTS / 2.0
    return Lit(
        np.maximum(halves.mean(axis=1), 0.0) @ LUMINANCE_WEIGHTS + straight_light(bench), half**2
    )


def straight_light(bench: Bench) -> np.ndarray:
    """Luminance that comes straight from lobes, which no texel keeps, to the surface pixels; (m,)
    float64.
    """
    renderer = bench.renderer(bench.scene)
    view = bench.view
    spec = renderer.caches.spec(view.shading)
    gbuffer = renderer.gbuffer(view)
    light = RotatedLight(spec, view)
    lit = renderer.lobes(light, gbuffer).lit[:, :3]
    return spec.unit * luminance_of(
        lit * light.tints(gbuffer, bench.tiles) if light.coloured else lit
    )


def bake_place(
    pixels: np.ndarray, points: np.ndarray, normals: np.ndarray, isovalue: Isovalue
) -> Place:
    """Points (m, 3) of a picture's ``pixels`` as a bake takes texels."""
    numbers = np.full((len(pixels), 3), OUTSIDE_LATTICE, np.int32)
    numbers[:, 2] = pixels
    here, outward = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    return numbers, here, outward, np.full(len(pixels), isovalue)


def light_of_halves(turned: RotatedLight, place: Place, samples: int) -> np.ndarray:
    """Linear RGB (m, 2, 3) of each half of ``samples`` paths, under ``turned`` lights."""
    spec = turned.spec
    void = np.zeros(len(place[3]), np.bool_)
    halves = light_of_glow(turned, place, samples)
    layers = tuple(layer for layer in spec.plan.layers if layer.kind != GLOW_KIND)
    for layer, (sums, _) in zip(
        layers, sample_transfer(layers, place, void, spec, 0, samples), strict=True
    ):
        light = turned.albedo[:, None] * turned.light_of(layer)
        n = min(layer.order**2, light.shape[1])
        colours = turned.colours_of(layer, sums)
        halves += np.einsum("mhcn,cn->mhc", colours[..., :n], light[:, :n]) / (samples // 2)
    return halves


def light_of_glow(turned: RotatedLight, place: Place, samples: int) -> np.ndarray:
    """Linear RGB (m, 2, 3) of each half of ``samples`` paths, of what glows; zero where nothing
    does.
    """
    spec = turned.spec
    void = np.zeros(len(place[3]), np.bool_)
    halves = np.zeros((len(place[3]), 2, 3))
    for layer in spec.plan.layers:
        if isinstance(layer, GlowLayer):
            ((sums, _),) = sample_glow([layer], place, void, spec, 0, samples)
            lights = np.hstack(layer.lights(spec.prepared.scene.lighting.glowing.radiances))
            if layer.glows == 1:
                arriving = sums[..., 0] * lights[:, 0]
            else:
                arriving = sums[..., 0] @ lights.T
            halves += turned.albedo * arriving / (samples // 2)
    return halves


@dataclass(frozen=True, eq=False)
class Converged:
    """The frames of a view's converged light, rounded as the plan keeps it, and in single floats.

    ``samples`` is the mean of what its texels have.
    """

    kept: Frame
    exact: Frame
    samples: float


def converged(bench: Bench) -> Converged:
    """The view's converged light by the scene's plan; rounded and not, it is of the same paths."""
    return bench.once("converged", lambda: converge(bench))


def converge(bench: Bench) -> Converged:
    """Bake it. Raises Cancelled."""
    layers = bench.scene.plan.layers
    twins = tuple(map(unrounded, layers))
    both = ViewBake(
        bench.renderer(bench.scene), bench.view, layers + (() if twins == layers else twins)
    )
    taken = np.max([part.samples for part in bench.planned.light.parts], axis=0)
    for samples in np.unique(taken).tolist():
        grow_some(
            both,
            np.flatnonzero(taken == samples),
            rung_below(CONVERGED_SAMPLE_FACTOR * samples),
            bench,
        )
    kept, exact = (
        both.frame(Light(both.light.parts[a:][: len(layers)])) for a in (0, -len(layers))
    )
    return Converged(kept, exact, both.samples)


def grow_some(whole: Bake, rows: np.ndarray, samples: int, bench: Bench) -> None:
    """Bring some texels of a bake to so many samples."""
    some = Bake(whole.tiles, whole.spec, whole.layers, whole.texels[rows], whole.levels[rows])
    some.grow(samples)
    whole.light.put(rows, some.light)


def unrounded(layer: Layer) -> Layer:
    """The layer in single floats."""
    return replace(layer, half=False, coarse=None)


def rung_below(samples: float) -> int:
    """The last rung of the ladder of samples, of those that count as converged, that is not above
    ``samples``.
    """
    rung = MIN_EXACT_SAMPLES
    while 2 * rung <= min(samples, MAX_EXACT_SAMPLES):
        rung *= 2
    return rung
