"""Bake specs: the scene and the plan by which light is baked, and the light that the baked
coefficients are multiplied by.
"""

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
    """The part of a texel's light that meets one ``light``, unturned, (3, n²), linear RGB: the sum
    of some ``layers``.

    - ``layers``: their numbers in the plan; ``node``: the one channel that counts, of a layer kept
      for several albedos or of several glows.
    - ``order``: of the light.
    - ``luminance``: (channels, n²), luminance of the reflected light, see ``to_luminance``.
    - ``square``: (n²,), harmonics of the square of that luminance in the unit of a bake spec, see
      ``bake.noise``; for a node its share of that of all nodes, for glows an upper bound.
    - ``glows``: True for light of glows.
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
    """A ``prepared`` scene, and the ``plan`` by which it is lit: the scene's, or that of vicinity
    shading.

    - ``shown``: isosurface that texels are projected onto, see ``locate``; None if they are not
      projected.
    - ``seen``: albedo of the surface in frames; by default the one at which noise of texels is
      judged, which is the scene's, or the highest that views may ask for.
    """

    prepared: PreparedScene
    plan: ScenePlan
    shown: Isovalue | None = None
    seen: Colour | None = None

    @property
    def albedo(self) -> Colour:
        """Albedo by which light leaves the surface, linear RGB."""
        return self.seen or self.prepared.scene.inputs.albedo

    def of_albedo(self, albedo: Colour) -> "BakeSpec":
        """Return the spec of the same light in the store as a surface of another ``albedo``
        reflects it.
        """
        if albedo == self.albedo:
            return self
        if albedo == self.prepared.scene.surfaces.albedo:
            return self._of_scene
        return self._with_albedo(albedo)

    @cached_property
    def _of_scene(self) -> "BakeSpec":
        """The spec of the scene's albedo; it is kept, as most views have it."""
        return self._with_albedo(self.prepared.scene.surfaces.albedo)

    def _with_albedo(self, albedo: Colour) -> "BakeSpec":
        """Make the spec of an ``albedo``; it shares all parts that do not depend on the albedo."""
        seen = replace(self, seen=albedo)
        vars(seen).update(light=self.light, beside=self.beside, _lights=self._lights)
        return seen

    @cached_property
    def moving(self) -> "BakeSpec":
        """The spec for views that move: it takes out a few lobes at most, as each costs shadow
        rays. The light in the store is the same.
        """
        if self.plan.lobes <= FEW_LOBES_SEARCHED:
            return self
        return replace(self, plan=replace(self.plan, lobes=FEW_LOBES_SEARCHED))

    @cached_property
    def digest(self) -> str:
        """Hex name of everything that its light in the store depends on."""
        return self.prepared.scene.plan_digest(self.plan, self.shown)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of the layers that are baked; see ``Scene.kind_of``."""
        return frozenset(
            self.prepared.scene.kind_of(layer, self.plan) for layer in self.plan.layers
        )

    @property
    def rough(self) -> bool:
        """True if the noise of light is estimated roughly, from one difference of halves: that of
        irradiance or glow. Of a single texel it may be small by chance.
        """
        return any(layer.kind in ("irradiance", GLOW_KIND) for layer in self.plan.layers)

    @cached_property
    def coloured(self) -> bool:
        """True if paths carry the colours of the surfaces that they hit to harmonics."""
        return COLOURED_KIND in self.kinds

    @property
    def order(self) -> int:
        """Order of the light, and so of the coefficients that frames read; 1 if no harmonics
        are kept.
        """
        return self.plan.order

    @property
    def channels(self) -> int:
        """Number of channels that light is kept in."""
        return self.plan.channels

    @cached_property
    def light(self) -> np.ndarray:
        """SH coefficients ℓ of the unturned light that transfer is multiplied by, linear RGB, (3,
        n²) float64. Source: S1, eq. 7.

        Irradiance contains the light already: then this is 1. For vicinity shading it is an even
        light, the mean of all light, lamps included.
        """
        # Light that texels met already is not multiplied again.
        if self.plan.representation == "irradiance":
            return np.ones((3, 1))
        if self.plan.representation == "vicinity":
            return self.prepared.around[:, :1]
        return project_environment(self.prepared.scene.lighting.environment, self.order)

    @cached_property
    def luminance_light(self) -> np.ndarray:
        """Luminance of ``light`` times the albedo, divided among the channels; (channels, n²)
        float64.
        """
        return to_luminance(self.light, self.albedo, self.channels)

    @cached_property
    def unoccluded(self) -> float:
        """Luminance that leaves an unoccluded surface, a mean over rotations of the light. It
        does not depend on ``seen``.
        """
        mean = self.prepared.around[:, 0] / np.sqrt(4.0 * np.pi)
        if self.prepared.scene.lighting.glowing.any:
            mean = mean + self.prepared.scene.glow_around
        return float(mean * self.prepared.scene.inputs.albedo @ LUMINANCE_WEIGHTS)

    @cached_property
    def unit(self) -> float:
        """Radiance by which light is divided before it is squared: a power of two near
        ``unoccluded``.

        In single floats, squares of light below 1e-19 or above 1e19 would underflow or overflow.
        """
        return math.ldexp(1.0, math.frexp(self.unoccluded)[1])

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The terms of light: direct light first, which is without lobes, then all other layers,
        which meet all of the light; glows last.

        For irradiance, the term stands for a transfer that meets light of the radiance ``unit``.
        For a layer kept for several albedos, each node is a term whose light is weighted as the
        spec's albedo mixes it.
        """
        lit = (
            part
            for layers, light in self._lights
            for part in self._by_node(self._term(layers, light))
        )
        return (*lit, *self._glow_terms())

    def _glow_terms(self) -> Iterator[Term]:
        """Yield the terms of glows, each under its radiance; a single channel each if there are
        several glows.
        """
        for number, layer in enumerate(self.plan.layers):
            if isinstance(layer, GlowLayer):
                for node, light in enumerate(
                    layer.lights(self.prepared.scene.lighting.glowing.radiances)
                ):
                    luminance = to_luminance(light, self.albedo, self.channels)
                    # A path gathers at most MOST_GATHERED times the radiance of a glow.
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
        """Return the luminance that leaves a texel for light 1 in each channel of glows;
        (channels,) float64.
        """
        # A single glow has one term for all its channels, several have a term for each channel.
        each = [term.luminance[:, 0] for term in self._glow_terms()]
        if layer.glows == 1:
            if len(each[0]) == layer.channels:
                return each[0]
            return each[0].sum(keepdims=True)
        return np.array([weights.sum() for weights in each])

    @cached_property
    def _lights(self) -> tuple[tuple[tuple[int, ...], np.ndarray], ...]:
        """Pairs of layers that meet the same light, by their numbers, and that light, (3, n²)."""
        numbers = [
            number for number, layer in enumerate(self.plan.layers) if layer.kind != GLOW_KIND
        ]
        # Direct light is without lobes, and so a separate group.
        straight = tuple(i for i in numbers if self.plan.layers[i].kind == "direct")
        groups = [
            group for group in (straight, tuple(i for i in numbers if i not in straight)) if group
        ]
        return tuple(
            (group, self._light_met_by(group, self.lobes if group == straight else ()))
            for group in groups
        )

    def _light_met_by(self, layers: tuple[int, ...], lobes: tuple[Lobe, ...]) -> np.ndarray:
        """Return the light that ``layers`` meet, without some ``lobes``; (3, n²)."""
        order = min(max(self.plan.layers[i].order for i in layers), self.order)
        return np.asarray(self.light[:, : order**2] - project_lobes(lobes, order))

    def _term(self, layers: tuple[int, ...], light: np.ndarray) -> Term:
        """Make the term of ``layers`` under a ``light``."""
        luminance = to_luminance(light, self.albedo, self.channels)
        # Square the light in units of the spec, so that single floats hold it.
        square = square_light(luminance.sum(axis=0) / self.unit)
        if self.plan.representation == "irradiance":
            square = square * self.unit
        return Term(layers, math.isqrt(light.shape[1]), light, luminance, square)

    def _by_node(self, term: Term) -> Iterator[Term]:
        """Yield a ``term``, or its parts by the nodes that its light is kept for, each with the
        weight of its node.
        """
        if not self.plan.layers[term.layers[0]].nodes:
            yield term
            return
        # Shares of the channels in the luminance of reflected white light.
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
        """Weights of the light at each node in light of the spec's albedo; (3, nodes) float64."""
        return mixing_of(self.albedo, self.plan)

    def term_of(self, layer: Layer) -> Term:
        """Return the last of the terms that have a layer of the kind of ``layer``; the first of all
        terms if none has.

        ``layer`` need not be in the plan: with other bands or precision it has the same term. A
        layer with nodes has a term for each, by ascending albedo: the last is that of the highest
        albedo, at which noise is judged.
        """
        kinds = [{self.plan.layers[i].kind for i in term.layers} for term in self.terms]
        found = [term for term, kept in zip(self.terms, kinds, strict=True) if layer.kind in kept]
        return found[-1] if found else self.terms[0]

    @property
    def columns(self) -> int:
        """Number of coefficients per channel that frames read: those of all terms, one after
        another.
        """
        return sum(term.order**2 for term in self.terms)

    @property
    def firsts(self) -> np.ndarray:
        """The first column of each term; (terms,) int64."""
        return np.cumsum([0, *(term.order**2 for term in self.terms[:-1])])

    @property
    def straight(self) -> int:
        """Number of columns, the first ones, that do not hold reflected light alone."""
        if len(self.terms) > 1:
            return int(self.firsts[1])
        return self.columns

    @property
    def lobes(self) -> tuple[Lobe, ...]:
        """The lobes that are left out of direct light in texels, as pixels light them by shadow
        rays.
        """
        return self.prepared.scene.inputs.lobes[: self.plan.lobes]

    @cached_property
    def beside(self) -> np.ndarray:
        """SH coefficients of the unturned lights without lobes, as an unshadowed surface
        receives them; as ``PreparedScene.around``.
        """
        around = self.prepared.around
        return np.asarray(around - project_lobes(self.lobes, math.isqrt(around.shape[1])))

    def gains(self, layer: Layer) -> np.ndarray:
        """Return the weights of the squared noises of a ``layer`` in the variance of a texel's
        luminance; (noises,) float64.

        A mean over rotations of the light: E[(s·Dℓ)²] = Σ_l |s_l|² |ℓ_l|² / (2l + 1), with |s_l|² =
        (2l + 1) v_l and v_l the variance of a coefficient of band l. The noises give v_0 and the
        mean over the bands above; v_l is taken to grow from v_0 as l², as few samples miss fine
        structure first. The spectra of direct light on five surfaces follow this, from v_5 / v_0 =
        20 after 16 samples to 2 after 1024, within a fifth. All channels come from the same paths,
        and so their errors add.
        """
        if isinstance(layer, GlowLayer):
            # All glows count as the brightest of them.
            brightest = self.glow_weights(layer).reshape(layer.glows, -1).sum(axis=1).max()
            return np.array([(layer.glows * brightest) ** 2])
        # Sum the energy of the light in each band; frames read no band beyond the light's order.
        bands = np.arange(min(layer.order, self.term_of(layer).order))
        light = self.term_of(layer).luminance.sum(axis=0)[: len(bands) ** 2]
        energy = np.add.reduceat(light**2, bands**2)
        # Growth of the variance with the band, 1 on average over the bands above 0.
        growth = bands**2 / max(
            (np.arange(1, layer.order) ** 2).sum() / max(layer.order - 1, 1), 1.0
        )
        return np.array([energy @ (1.0 - growth), energy @ growth])[: layer.noises]

    def luminance_sums(self, halves: np.ndarray, layer: Layer) -> np.ndarray:
        """Return the sums of a layer's luminance from sums of its channels, ``halves`` (…,
        channels, n²): the spread of these estimates its noise; (…, n²).

        The error of each colour depends on its light and on the albedo. Mixed with the weights of
        luminance, they give the error that ``gains`` expects.
        """
        return np.asarray(np.einsum("...cn,c->...n", halves, self.mix(layer)))

    def mix(self, layer: Layer) -> np.ndarray:
        """Return the shares of a layer's channels in the luminance that leaves a texel under white
        light; (channels,) float64.

        For nodes the highest albedo alone counts, as noise is judged at it. For glows the mean
        counts, while ``gains`` takes each to be as bright as the brightest.
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
        """Return R^k for k = 0 … bounces, divided by the probability to get there, for each of
        the layer's channels; (bounces + 1, channels).
        """
        albedo = np.array(layer.nodes or self.prepared.scene.surfaces.albedo[: layer.channels])
        return path_weights(albedo, self.plan.bounces if layer.reflected else 0, self.plan.survival)

    def shares(self, layers: Sequence[Layer]) -> np.ndarray:
        """Return the weights of a path in ``layers`` if it never leaves, or leaves after k = 0, 1,
        … bounces: R^k over the probability to get there, or 0.

        (channels of all layers, bounces + 2) float64; column 0 is for paths that never leave,
        column k + 1 for k bounces. The longest path of these layers decides the number of columns.
        """
        return self._stacked([self._shares(layer) for layer in layers])

    def squares(self, layers: Sequence[Layer]) -> np.ndarray:
        """Return the squares of a path's weights in the luminance of ``layers``; (layers,
        bounces + 2), columns as in ``shares``.
        """
        return self._stacked(
            [(self.mix(layer) @ self._shares(layer))[None] ** 2 for layer in layers]
        )

    def coloured_rules(self, layers: Sequence[Layer], orders: np.ndarray) -> ColouredRules:
        """Return the rules of ``shares`` and ``squares`` for a surface with colours, in rows
        with harmonics of these ``orders``.
        """
        # First a row for each channel of each layer, then a row for the square of each layer's
        # luminance.
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

    def _stacked(self, tables: Sequence[np.ndarray]) -> np.ndarray:
        """Stack tables of weights, padded with zeros to the same number of columns."""
        longest = max(shares.shape[1] for shares in tables)
        return np.vstack(
            [np.pad(shares, ((0, 0), (0, longest - shares.shape[1]))) for shares in tables]
        )

    def _shares(self, layer: Layer) -> np.ndarray:
        """Return the weights of a path in one ``layer``, as in ``shares``."""
        weights = self.weights(layer)
        shares = np.zeros((layer.channels, len(weights) + 1))
        shares[:, 1:] = weights.T
        # Light without a bounce is direct.
        if layer.kind == "indirect":
            shares[:, 1] = 0.0
        return shares


MOST_GATHERED = 1.5
"""Most light that a ray gathers from a ball which glows with radiance 1: its diameter over its
mean chord.
"""


def path_weights(albedo: np.ndarray, bounces: int, survival: float, leaving: int = 0) -> np.ndarray:
    """Return R^(k + ``leaving``) for k = 0 … bounces, divided by the probability to get there;
    (bounces + 1, channels) float64.

    ``leaving`` is 0 for light that arrives, 1 for light that leaves the surface. A path continues
    after its second and later hits with probability ``survival``.
    """
    k = np.arange(bounces + 1)[:, None]
    return np.asarray(albedo ** (k + leaving) / survival ** np.maximum(k - 1, 0))


def mixing_of(albedo: Colour, plan: ScenePlan) -> np.ndarray:
    """Return the weights of light kept for the nodes of a ``plan`` in light of an ``albedo``;
    (3, nodes) float64.
    """
    return np.array([mixing_weights(share, plan.nodes, plan.bounces) for share in albedo])


def spec_name(shading: str) -> str:
    """Return the name of the bake spec that views of a ``shading`` read."""
    if shading == "vicinity":
        return "vicinity"
    return "gi"


def spec_for(prepared: PreparedScene, shading: str) -> BakeSpec:
    """Return the bake spec that views of a ``shading``, or of a spec's name, read."""
    plan = prepared.scene.plan
    return BakeSpec(prepared, vicinity_plan(plan) if spec_name(shading) == "vicinity" else plan)


def to_luminance(
    light: np.ndarray, albedo: tuple[float, float, float], channels: int
) -> np.ndarray:
    """Return the luminance of the reflected ``light`` (3, n²), divided among the channels of
    the transfer: a row for each colour, or their sum if the transfer has one channel; (channels,
    n²).
    """
    weighted = (LUMINANCE_WEIGHTS * np.array(albedo))[:, None] * light
    if channels == 3:
        return weighted
    return weighted.sum(axis=0, keepdims=True)


def square_light(light: np.ndarray) -> np.ndarray:
    """Return the coefficients q_i = ∫ L² Y_i dω of the square of L = Σ ``light`` (n²,) Y_i, of
    the same order; (n²,) float64.
    """
    # Evaluate the light at quadrature nodes, square it there, and project it again.
    basis, weights = basis_of(math.isqrt(len(light)))
    return np.asarray(basis @ (weights * (light @ basis) ** 2))


@cache
def basis_of(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return harmonics (n², nodes) at nodes that integrate products of three of them exactly,
    and the weights of the nodes, (nodes,).
    """
    theta, phi, weights = sphere_nodes(3 * order)
    return evaluate_harmonics(order, theta, phi), weights


def band_of(order: int) -> np.ndarray:
    """Return the band l of each coefficient i < order²; (n²,) int."""
    return np.repeat(np.arange(order), 2 * np.arange(order) + 1)
