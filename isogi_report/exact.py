"""Exact counterparts of the light that a frame reads:
texels with hardly any noise, and light at the pixels' points.
"""

from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.refine import Place, sample_glow, sample_transfer
from isogi_core.bake.texel_light import Light
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import variance_of_mean
from isogi_core.frame.rays.point_transfer import place_of, times_light
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.scene_plan import GLOW_KIND, GlowLayer, Layer
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference
from isogi_report.bench import Bake, Bench, ViewBake
from isogi_report.metrics import luminance_of

OUTSIDE_LATTICE = -1
"""Lattice index along z and y of points that are not texels: no texel has it."""

POINTS_A_PIECE = 64
"""Points that one thread lights in one call."""

TRANSFER_PATHS = 1024
"""Paths from each pixel for its transfer."""


CONVERGED_SAMPLE_FACTOR = 4
"""Samples of converged light, at most, relative to those that a texel has in the frame."""

MIN_EXACT_SAMPLES = 256
MAX_EXACT_SAMPLES = 16384
"""Bounds of these samples."""


@dataclass(frozen=True, eq=False)
class Lit:
    """Light of surface pixels: their luminance,
    ``light`` (m,) float64, and its variance, ``noise`` (m,).
    """

    light: np.ndarray
    noise: np.ndarray


def lit_by_frame(frame: Frame) -> Lit:
    """Return the light of a frame's surface pixels, with the noise that their texels report."""
    on = frame.state > 0
    light = luminance_of(frame.leaving[on])
    return Lit(light, (frame.error[on] * light) ** 2)


def lit_by_paths(best: Reference) -> Lit:
    """Return the light of the surface pixels of a reference."""
    return Lit(luminance_of(best.mean[best.on]), best.variance[best.on].astype(np.float64))


def reference_difference(one: Reference, other: Reference) -> Lit:
    """Return the light of one reference minus that of another, and the variance of the difference.

    Both use the same random numbers, so most of their noise cancels. So the variance is estimated
    from the differences of their replicas.
    """
    differences = replicas(one) - replicas(other)
    return Lit(luminance_of(differences.mean(axis=1)), variance_of_mean(differences))


def replicas(best: Reference) -> np.ndarray:
    """Return the mean of each replica of a reference, (m, replicas, 3)."""
    return best.sums * (best.sums.shape[1] / best.samples)


def short_paths(bench: Bench) -> Reference:
    """Return the reference under the lights themselves, with the plan's bounces."""
    return bench.reference(bench.best.samples, bounces=bench.scene.bounces)


def own_light(bench: Bench) -> Lit:
    """Return the light that surface pixels would have if each were a texel:
    interpolation is exact if it gives this light.
    """
    if not cuts_harmonics(bench.scene):
        return lit_by_paths(short_paths(bench))
    return bench.once("own light", lambda: lit_by_transfer(bench, TRANSFER_PATHS))


def cuts_harmonics(scene: Scene) -> bool:
    """Return True if the plan's texels keep fewer harmonics than the light has."""
    return scene.plan.representation != "irradiance" and not scene.inputs.constant


def lit_by_transfer(bench: Bench, samples: int) -> Lit:
    """Return the light of surface pixels as if each were a texel: by the transfer at its point, in
    the plan's orders of harmonics, by ``samples`` paths from each.

    The transfer is not rounded as texels keep it. Direct light of lobes is that of the frame.
    Raises Cancelled.
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
    # Surface colours multiply the light of pixels, as in frames.
    if turned.coloured:
        halves *= turned.tints(gbuffer, bench.tiles)[:, None]
    # The two halves are independent: half their difference estimates the standard error of their
    # mean.
    deviation = (halves[:, 0] - halves[:, 1]) @ LUMINANCE_WEIGHTS / 2.0
    light = np.maximum(halves.mean(axis=1), 0.0) @ LUMINANCE_WEIGHTS
    return Lit(light + straight_light(bench), deviation**2)


def straight_light(bench: Bench) -> np.ndarray:
    """Return the luminance that lobes send directly to the surface pixels,
    which no texel keeps; (m,) float64.
    """
    renderer = bench.renderer(bench.scene)
    view = bench.view
    spec = renderer.caches.spec(view.shading)
    gbuffer = renderer.gbuffer(view)
    turned = RotatedLight(spec, view)
    lit = renderer.surface.lobes(turned, gbuffer).lit[:, :3]
    if turned.coloured:
        lit = lit * turned.tints(gbuffer, bench.tiles)
    return spec.unit * luminance_of(lit)


def bake_place(
    pixels: np.ndarray, points: np.ndarray, normals: np.ndarray, isovalue: Isovalue
) -> Place:
    """Return the surface points of ``pixels`` (m,), picture indices, in the form in which a bake
    takes texels, so that its paths start exactly there. Nothing is baked here.

    ``points`` (m, 3) are in index space, ``normals`` (m, 3) are outward unit world vectors; all
    points lie on one surface, at the ``isovalue``.
    """
    # A bake reads the lattice indices (z, y, x) of texels only to seed their random numbers. Give
    # each pixel a seed that no texel has.
    numbers = np.full((len(pixels), 3), OUTSIDE_LATTICE, np.int32)
    numbers[:, 2] = pixels
    return place_of(numbers, points, normals, isovalue)


def light_of_halves(turned: RotatedLight, place: Place, samples: int) -> np.ndarray:
    """Return the linear RGB, (m, 2, 3), that points would show if each were a texel, under rotated
    lights: two independent estimates (axis 1), each by half of ``samples`` paths.

    Light that lobes send directly, and colours of the surface by data, are not in it.
    """
    spec = turned.spec
    # All points lie on the surface, so none is void.
    void = np.zeros(len(place[3]), np.bool_)
    halves = light_of_glow(turned, place, samples)
    layers = tuple(layer for layer in spec.plan.layers if layer.kind != GLOW_KIND)
    found = sample_transfer(layers, place, void, spec, 0, samples)
    sums = tuple(each for each, _ in found)
    # Sums over the paths of a half become means.
    return np.asarray(halves + times_light(sums, layers, turned) / (samples // 2))


def light_of_glow(turned: RotatedLight, place: Place, samples: int) -> np.ndarray:
    """Return the linear RGB, (m, 2, 3), that points would show by the light of glowing parts: two
    independent estimates, each by half of ``samples`` paths. It is 0 if nothing glows.
    """
    spec = turned.spec
    void = np.zeros(len(place[3]), np.bool_)
    halves = np.zeros((len(place[3]), 2, 3))
    for layer in spec.plan.layers:
        if isinstance(layer, GlowLayer):
            ((sums, _),) = sample_glow([layer], place, void, spec, 0, samples)
            lights = np.hstack(layer.lights(spec.prepared.scene.lighting.glowing.radiances))
            # The light of a single glow is scaled by its radiance in each colour; that of several
            # is summed up over all channels.
            if layer.glows == 1:
                arriving = sums[..., 0] * lights[:, 0]
            else:
                arriving = sums[..., 0] @ lights.T
            halves += turned.albedo * arriving / (samples // 2)
    return halves


@dataclass(frozen=True, eq=False)
class Converged:
    """Two frames of a view's converged light: ``kept`` is rounded as the plan keeps it, ``exact``
    is in single floats.

    ``samples`` is the mean over the texels.
    """

    kept: Frame
    exact: Frame
    samples: float


def converged(bench: Bench) -> Converged:
    """Return the view's converged light by the scene's plan.

    Rounded and exact light are of the same paths.
    """
    return bench.once("converged", lambda: converge(bench))


def converge(bench: Bench) -> Converged:
    """Bake the converged light, and render both frames. Raises Cancelled."""
    layers = bench.scene.plan.layers
    # Bake all layers twice in one go, once as the plan rounds them and once in single floats.
    twins = tuple(map(unrounded, layers))
    if twins == layers:
        twins = ()
    both = ViewBake(bench.renderer(bench.scene), bench.view, layers + twins)
    # Each texel takes a multiple of the samples that it has in the plan's frame.
    taken = np.max([part.samples for part in bench.planned.light.parts], axis=0)
    for samples in np.unique(taken).tolist():
        rows = np.flatnonzero(taken == samples)
        grow_some(both, rows, rung_below(CONVERGED_SAMPLE_FACTOR * samples))
    kept = both.frame(Light(both.light.parts[: len(layers)]))
    exact = both.frame(Light(both.light.parts[-len(layers) :]))
    return Converged(kept, exact, both.samples)


def grow_some(whole: Bake, rows: np.ndarray, samples: int) -> None:
    """Bring some texels of a bake to ``samples`` samples."""
    some = Bake(whole.tiles, whole.spec, whole.layers, whole.texels[rows], whole.levels[rows])
    some.grow(samples)
    whole.light.put(rows, some.light)


def unrounded(layer: Layer) -> Layer:
    """Return the layer in single floats."""
    return replace(layer, half=False, coarse=None)


def rung_below(samples: float) -> int:
    """Return the highest level of samples up to ``samples``,
    within the bounds of converged light.
    """
    rung = MIN_EXACT_SAMPLES
    while 2 * rung <= min(samples, MAX_EXACT_SAMPLES):
        rung *= 2
    return rung
