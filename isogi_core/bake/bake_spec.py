"""What is baked for a scene, by which plan, and the light that it is put under."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from isogi_core.kernels.transport.transfer import ColouredRules
from isogi_core.model.environment import LUMINANCE_WEIGHTS, Lobe
from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import GLOW_KIND, GlowLayer, Layer, ScenePlan
from isogi_core.model.volume import Isovalue
from isogi_core.plan.albedo_nodes import mixing_weights
from isogi_core.plan.bands import evaluate_harmonics, project_environment, sphere_nodes
from isogi_core.plan.lobe_choice import FEW_LOBES_SEARCHED, project_lobes
from isogi_core.plan.planner import vicinity_plan
from isogi_core.plan.scene import COLOURED_KIND
from isogi_core.prepared.prepared_scene import PreparedScene


@dataclass(frozen=True, eq=False)
class Term:
    """The sum of some ``layers`` of a plan, by their numbers, under one unturned ``light`` (3, n²),
    linear RGB.

    Of a layer that is kept for several albedos, or of several glows, it is the channel ``node``
    alone. It may be of what ``glows``. ``order`` is that of the light; ``luminance`` (channels, n²)
    is what is reflected of it, see ``to_luminance``, and ``square`` (n²,) the square of that
    luminance in the unit of a bake spec, see ``bake.noise``.
    """

    layers: tuple[int, ...]
    order: int
    light: np.ndarray
    luminance: np.ndarray
    square: np.ndarray
    node: int | None = None
    glows: bool = False


SPECS = ("gi", "vicinity")
"""Names of the bake specs of a scene."""


@dataclass(frozen=True, eq=False)
class BakeSpec:
    """A scene's ``prepared``, and the ``plan`` by which it is lit: the scene's own, or that of
    vicinity shading.

    Surface-projected texels lie on the isosurface that is ``shown``; see ``locate``. Surfaces have
    the albedo that is ``seen``, by default the one that texels' errors are held against: the
    scene's own, or the highest where views may ask for others.
    """

    prepared: PreparedScene
    plan: ScenePlan
    shown: Isovalue | None = None
    seen: Colour | None = None

    @property
    def albedo(self) -> Colour:
        """The albedo that light leaves surfaces with, linear RGB."""
        return self.seen or self.prepared.scene.inputs.albedo

    def of_albedo(self, albedo: Colour) -> "BakeSpec":
        """The spec of this light in the store, as surfaces of an ``albedo`` reflect it."""
        if albedo == self.albedo:
            return self
        if albedo == self.prepared.scene.surfaces.albedo:
            return self._own
        return self._seen(albedo)

    @cached_property
    def _own(self) -> "BakeSpec":
        """The spec of the scene's own albedo, which most views have."""
        return self._seen(self.prepared.scene.surfaces.albedo)

    def _seen(self, albedo: Colour) -> "BakeSpec":
        seen = replace(self, seen=albedo)
        vars(seen).update(
            light=self.light, beside=self.beside, _lights=self._lights
        )  # as no albedo changes them
        return seen

    @cached_property
    def moving(self) -> "BakeSpec":
        """The spec of this light in the store with few lobes in addition: for views that move."""
        if self.plan.lobes <= FEW_LOBES_SEARCHED:
            return self
        return replace(self, plan=replace(self.plan, lobes=FEW_LOBES_SEARCHED))

    @cached_property
    def digest(self) -> str:
        """Hex name of everything that its light in the store depends on."""
        return self.prepared.scene.plan_digest(self.plan, self.shown)

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of layers that are baked; see ``Scene.kind_of``."""
        return frozenset(
            self.prepared.scene.kind_of(layer, self.plan) for layer in self.plan.layers
        )

    @cached_property
    def coloured(self) -> bool:
        """Whether paths carry the colours of what they hit to harmonics."""
        return COLOURED_KIND in self.kinds

    @property
    def order(self) -> int:
        """The order of the light, and so of the coefficients that frames read; 1 where no harmonics
        are kept.
        """
        return self.plan.order

    @property
    def channels(self) -> int:
        """The channels that light is kept in."""
        return self.plan.channels

    @cached_property
    def light(self) -> np.ndarray:
        """What coefficients are multiplied by, linear RGB, (3, n²) float64: ℓ of the unturned
        light.

        Irradiance has met its light already, so that this is 1. Source: S1, eq. 7. Vicinity shading
        is of light that is the same from all sides: the mean of all, lamps among it.
        """
        if self.plan.representation == "irradiance":
            return np.ones((3, 1))
        if self.plan.representation == "vicinity":
            return self.prepared.around[:, :1]
        return project_environment(self.prepared.scene.lighting.environment, self.order)

    @cached_property
    def luminance_light(self) -> np.ndarray:
        """Luminance of ``light`` times the albedo, split over the channels; (channels, n²)
        float64.
        """
        return to_luminance(self.light, self.albedo, self.channels)

    @cached_property
    def unoccluded(self) -> float:
        """Luminance that leaves a surface which sees all of the light, a mean over its turns;
        whatever is ``seen``.
        """
        mean = self.prepared.around[:, 0] / np.sqrt(4.0 * np.pi)
        if self.prepared.scene.lighting.glowing.any:
            mean = mean + self.prepared.scene.glow_around
        return float(mean * self.prepared.scene.inputs.albedo @ LUMINANCE_WEIGHTS)

    @cached_property
    def unit(self) -> float:
        """The radiance that light is counted in where it is squared, a power of two near
        ``unoccluded``.

        Single floats hold the squares of no light below 1e-19 or above 1e19.
        """
        return math.ldexp(1.0, math.frexp(self.unoccluded)[1])

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The light by what it meets, direct light first: it is without lobes, and all other layers
        meet the same.

        Irradiance is taken for the transfer, times ``unit``, of a light of this radiance. What is
        kept for several albedos meets as much of the light as it counts at the spec's own.
        """
        lit = (
            part
            for layers, light in self._lights
            for part in self._by_node(self._term(layers, light))
        )
        return (*lit, *self._glow_terms())

    def _glow_terms(self) -> Iterator[Term]:
        """The terms of what glows, each under its own radiance: of single channels where there are
        several.
        """
        for number, layer in enumerate(self.plan.layers):
            if isinstance(layer, GlowLayer):
                for node, light in enumerate(
                    layer.lights(self.prepared.scene.lighting.glowing.radiances)
                ):
                    luminance = to_luminance(light, self.albedo, self.channels)
                    square = MOST_GATHERED * (luminance.sum(axis=0) / self.unit) ** 2
                    yield Term(
                        (number,),
                        1,
                        light,
                        luminance,
                        square,
                        None if layer.glows == 1 else node,
                        True,
                    )

    def glow_weights(self, layer: GlowLayer) -> np.ndarray:
        """Luminance that leaves a texel for each channel of what glows; (channels,) float64."""
        each = [term.luminance[:, 0] for term in self._glow_terms()]
        if layer.glows == 1:
            if len(each[0]) == layer.channels:
                return each[0]
            return each[0].sum(keepdims=True)
        return np.array([weights.sum() for weights in each])

    @cached_property
    def _lights(self) -> tuple[tuple[tuple[int, ...], np.ndarray], ...]:
        """Layers that meet the same light, by their numbers, and that light, (3, n²)."""
        numbers = [
            number for number, layer in enumerate(self.plan.layers) if layer.kind != GLOW_KIND
        ]
        straight = tuple(i for i in numbers if self.plan.layers[i].kind == "direct")
        groups = [
            group for group in (straight, tuple(i for i in numbers if i not in straight)) if group
        ]
        return tuple(
            (group, self._beside(group, self.lobes if group == straight else ()))
            for group in groups
        )

    def _beside(self, layers: tuple[int, ...], lobes: tuple[Lobe, ...]) -> np.ndarray:
        order = min(max(self.plan.layers[i].order for i in layers), self.order)
        return np.asarray(self.light[:, : order**2] - project_lobes(lobes, order))

    def _term(self, layers: tuple[int, ...], light: np.ndarray) -> Term:
        luminance = to_luminance(light, self.albedo, self.channels)
        square = square_light(luminance.sum(axis=0) / self.unit)
        if self.plan.representation == "irradiance":
            square = square * self.unit
        return Term(layers, math.isqrt(light.shape[1]), light, luminance, square)

    def _by_node(self, term: Term) -> Iterator[Term]:
        """The term itself, or those of the albedos that its light is kept for, each with what it
        counts.
        """
        if not self.plan.layers[term.layers[0]].nodes:
            yield term
            return
        mix = LUMINANCE_WEIGHTS * np.array(self.albedo)
        mix = mix / max(float(mix.sum()), 1e-30)
        for node, counts in enumerate(self.mixing.T):
            light = counts[:, None] * term.light
            share = float(mix @ counts)
            luminance = to_luminance(light, self.albedo, self.channels)
            yield replace(
                term, light=light, luminance=luminance, square=share * term.square, node=node
            )

    @cached_property
    def mixing(self) -> np.ndarray:
        """What light that is kept for each of some albedos counts in that of the spec's own; (3,
        nodes) float64.
        """
        return mixing_of(self.albedo, self.plan)

    def term_of(self, layer: Layer) -> Term:
        """The term that a ``layer`` is of, or its last one; of layers beside the plan's, those of
        its kind decide.
        """
        kinds = [{self.plan.layers[i].kind for i in term.layers} for term in self.terms]
        found = [term for term, own in zip(self.terms, kinds, strict=True) if layer.kind in own]
        return found[-1] if found else self.terms[0]

    @property
    def columns(self) -> int:
        """Coefficients of a channel that frames read: those of all terms, side by side."""
        return sum(term.order**2 for term in self.terms)

    @property
    def firsts(self) -> np.ndarray:
        """The first column of each term; (terms,) int64."""
        return np.cumsum([0, *(term.order**2 for term in self.terms[:-1])])

    @property
    def straight(self) -> int:
        """How many of the columns, the first ones, are not of reflected light alone."""
        if len(self.terms) > 1:
            return int(self.firsts[1])
        return self.columns

    @property
    def lobes(self) -> tuple[Lobe, ...]:
        """The lobes that direct light in texels is without, as pixels see them themselves."""
        return self.prepared.scene.inputs.lobes[: self.plan.lobes]

    @cached_property
    def beside(self) -> np.ndarray:
        """ℓ of the unturned lights but lobes as a surface without shadows has them; as
        ``PreparedScene.around``.
        """
        around = self.prepared.around
        return np.asarray(around - project_lobes(self.lobes, math.isqrt(around.shape[1])))

    def gains(self, layer: Layer) -> np.ndarray:
        """What the squared noises of a ``layer`` count in the variance of a texel's luminance;
        (noises,) float64.

        A mean over turns of the light: E[(s·Dℓ)²] = Σ_l |s_l|² |ℓ_l|² / (2l + 1), where |s_l|² =
        (2l + 1) v_l with the variance v_l of a coefficient of band l. The noises give v_0 and the
        mean of the bands above, and v_l is taken to grow from the one as l²: fine structure is what
        few samples miss first. Such are the spectra of direct light on five surfaces, from v_5 /
        v_0 = 20 after 16 samples to 2 after 1024, within a fifth. Channels are of the same paths,
        and so are their errors.
        """
        if isinstance(layer, GlowLayer):
            brightest = self.glow_weights(layer).reshape(layer.glows, -1).sum(axis=1).max()
            return np.array([(layer.glows * brightest) ** 2])
        bands = np.arange(min(layer.order, self.term_of(layer).order))
        light = self.term_of(layer).luminance.sum(axis=0)[: len(bands) ** 2]
        energy = np.add.reduceat(light**2, bands**2)
        growth = bands**2 / max(
            (np.arange(1, layer.order) ** 2).sum() / max(layer.order - 1, 1), 1.0
        )
        return np.array([energy @ (1.0 - growth), energy @ growth])[: layer.noises]

    def judged(self, halves: np.ndarray, layer: Layer) -> np.ndarray:
        """The sums (…, channels, n²) whose spread estimates a layer's noise: those of its luminance
        alone, (…, n²).

        Colours have errors of their own size, by the lights that they met and the albedo; mixed as
        luminance mixes them they come to what ``gains`` counts.
        """
        return np.asarray(np.einsum("...cn,c->...n", halves, self.mix(layer)))

    def mix(self, layer: Layer) -> np.ndarray:
        """Shares of a layer's channels in the luminance that leaves a texel under white light;
        (channels,) float64.

        Of what is kept for several albedos it is the highest alone, which errors are held against.
        Of what glows it is the mean, and ``gains`` take all to be as bright as the brightest.
        """
        if layer.nodes:
            return np.eye(layer.channels)[-1]
        mix = LUMINANCE_WEIGHTS * np.array(self.albedo)
        if layer.colours == 3:
            mix = mix / max(mix.sum(), 1e-30)
        else:
            mix = np.ones(1)
        return np.tile(mix, layer.channels // len(mix)) * (len(mix) / layer.channels)

    def weights(self, layer: Layer) -> np.ndarray:
        """R^k for k = 0 … bounces, over the chance to get there, of the layer's channels; (bounces
        + 1, channels).
        """
        albedo = np.array(layer.nodes or self.prepared.scene.surfaces.albedo[: layer.channels])
        return path_weights(albedo, self.plan.bounces if layer.reflected else 0, self.plan.survival)

    def shares(self, layers: Sequence[Layer]) -> np.ndarray:
        """What a path counts in ``layers`` that never left, or left after k = 0, 1, … bounces: R^k,
        or 0.

        (all channels of all layers, bounces + 2) float64, k at k + 1; no longer than the longest
        path of these.
        """
        return self._stacked([self._shares(layer) for layer in layers])

    def squares(self, layers: Sequence[Layer]) -> np.ndarray:
        """The squares of what a path counts in the luminance of ``layers``; (layers, bounces + 2),
        as ``shares``.
        """
        return self._stacked(
            [(self.mix(layer) @ self._shares(layer))[None] ** 2 for layer in layers]
        )

    def coloured_rules(self, layers: Sequence[Layer], orders: np.ndarray) -> ColouredRules:
        """``shares`` and ``squares`` on a surface with colours, in rows with harmonics of these
        ``orders``.
        """
        mixes = [np.eye(layer.channels, 3) for layer in layers]
        squares = [np.pad(self.mix(layer), (0, 3 - layer.channels))[None] for layer in layers]
        reflected = np.array([float(layer.reflected) for layer in layers])
        straight = np.array([float(layer.kind != "indirect") for layer in layers])
        channels = [layer.channels for layer in layers]
        return ColouredRules(
            orders,
            np.append(np.repeat(straight, channels), straight),
            np.append(np.repeat(reflected, channels), reflected),
            np.vstack([*mixes, *squares]),
            np.arange(sum(channels) + len(layers)) >= sum(channels),
            self.plan.bounces if reflected.any() else 0,
            self.plan.survival,
            self.plan.branches,
        )

    def _stacked(self, own: Sequence[np.ndarray]) -> np.ndarray:
        longest = max(shares.shape[1] for shares in own)
        return np.vstack(
            [np.pad(shares, ((0, 0), (0, longest - shares.shape[1]))) for shares in own]
        )

    def _shares(self, layer: Layer) -> np.ndarray:
        weights = self.weights(layer)
        shares = np.zeros((layer.channels, len(weights) + 1))
        shares[:, 1:] = weights.T
        if layer.kind == "indirect":
            shares[:, 1] = 0.0
        return shares


MOST_GATHERED = 1.5
"""The most that a ray gathers of a ball that glows with radiance 1: its diameter over its mean
chord.
"""


def path_weights(albedo: np.ndarray, bounces: int, survival: float, leaving: int = 0) -> np.ndarray:
    """R^(k + ``leaving``) for k = 0 … bounces, over the chance to get there; (bounces + 1,
    channels) float64.

    ``leaving`` 0 is of light that arrives, 1 of what leaves the surface. Chances: from the second
    hit on, ``survival``.
    """
    k = np.arange(bounces + 1)[:, None]
    return np.asarray(albedo ** (k + leaving) / survival ** np.maximum(k - 1, 0))


def mixing_of(albedo: Colour, plan: ScenePlan) -> np.ndarray:
    """What light that is kept for the nodes of a ``plan`` counts at an ``albedo``; (3, nodes)
    float64.
    """
    return np.array([mixing_weights(share, plan.nodes, plan.bounces) for share in albedo])


def spec_name(shading: str) -> str:
    """The name of the bake spec that views of a ``shading`` read: vicinity shading has one of its
    own.
    """
    if shading == "vicinity":
        return "vicinity"
    return "gi"


def spec_for(prepared: PreparedScene, shading: str) -> BakeSpec:
    """The bake spec that views of a ``shading``, or of a spec's name, read."""
    plan = prepared.scene.plan
    return BakeSpec(prepared, vicinity_plan(plan) if spec_name(shading) == "vicinity" else plan)


def to_luminance(
    light: np.ndarray, albedo: tuple[float, float, float], channels: int
) -> np.ndarray:
    """Luminance of the reflected ``light`` (3, n²), split over the channels of the transfer;
    (channels, n²).
    """
    weighted = (LUMINANCE_WEIGHTS * np.array(albedo))[:, None] * light
    if channels == 3:
        return weighted
    return weighted.sum(axis=0, keepdims=True)


def square_light(light: np.ndarray) -> np.ndarray:
    """Coefficients q_i = ∫ L² Y_i dω of the square of L = Σ ``light`` (n²,) Y_i, of the same order;
    (n²,) float64.
    """
    basis, weights = basis_of(math.isqrt(len(light)))
    return np.asarray(basis @ (weights * (light @ basis) ** 2))


@cache
def basis_of(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Harmonics (n², nodes) at nodes that integrate products of three of them, and their weights
    (nodes,).
    """
    theta, phi, weights = sphere_nodes(3 * order)
    return evaluate_harmonics(order, theta, phi), weights


def band_of(order: int) -> np.ndarray:
    """The band l of each coefficient i < order²; (n²,) int."""
    return np.repeat(np.arange(order), 2 * np.arange(order) + 1)
