"""The light around a view: the environment turned, as coefficients, as a picture, and as one key light."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.look import Look, band_of
from isogi_core.kernels.harmonics import cosine_lobe_factors, rotate
from isogi_core.kernels.lamps import DIRECTIONAL, LampArrays
from isogi_core.kernels.lattice import Sky
from isogi_core.kernels.lit import Surroundings
from isogi_core.kernels.shading import LocalModel
from isogi_core.kernels.shares import LEAST, Bare
from isogi_core.model.plan import Layer
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import Camera, View, rotation_matrix

KEY_SHARE = 0.1
"""An environment whose first band carries less than this share of its mean has no key light of its own."""

SHINE, EXPONENT = 0.3, 32.0
"""Phong's highlight: strength and exponent."""


@dataclass(frozen=True, eq=False)
class Turned:
    """The lights of a ``look``, turned for one view and reflected by the albedo that it asks for."""

    look: Look
    view: View

    @cached_property
    def seen(self) -> Look:
        """The look with the view's albedo. ViewError where its light is not of that."""
        return self.look.of_albedo(self.look.recipe.scene.albedo_for(self.view.albedo))

    @cached_property
    def matrix(self) -> np.ndarray:
        """The light's rotation, (3, 3) float64."""
        return rotation_matrix(self.view.light)

    @cached_property
    def light(self) -> np.ndarray:
        """What texels' columns are multiplied by, the light of each term turned, side by side; (3, Σ n²) linear RGB."""
        return np.concatenate([turn(term.light, self.matrix) for term in self.seen.terms], axis=1)

    def light_of(self, layer: Layer) -> np.ndarray:
        """What a ``layer``'s coefficients are multiplied by in all, turned; (3, n²) float64 linear RGB."""
        term = self.seen.term_of(layer)
        return turn(self.look.light[:, : term.order**2] if layer.nodes else term.light, self.matrix)

    def colours_of(self, layer: Layer, light: np.ndarray) -> np.ndarray:
        """Light (…, channels, n²) of a ``layer`` in the three colours that the surface gives it; (…, 3, n²)."""
        if layer.nodes:
            return np.asarray(np.einsum("...jn,cj->...cn", light, self.seen.mixing))
        return np.broadcast_to(light, (*light.shape[:-2], 3, light.shape[-1]))

    @cached_property
    def around(self) -> np.ndarray:
        """ℓ of the turned lights as a surface without shadows has them; (3, n²) float64 linear RGB."""
        return turn(self.look.recipe.around, self.matrix)

    @property
    def albedo(self) -> np.ndarray:
        """The albedo of the surface, (3,)."""
        return np.array(self.seen.albedo)

    @property
    def unoccluded(self) -> float:
        """``Look.unoccluded`` at the view's albedo."""
        own = float(LUMINANCE @ self.look.recipe.scene.needs.albedo)
        return self.look.unoccluded * float(LUMINANCE @ self.albedo) / max(own, 1e-30)

    @property
    def tint(self) -> np.ndarray:
        """How much more a surface of the view's albedo reflects than one of the look's own, (3,)."""
        return self.albedo / np.maximum(self.look.albedo, 1e-30) if self.seen is not self.look else np.ones(3)

    @cached_property
    def reflected(self) -> np.ndarray:
        """``light`` times the albedo: τ·ℓ is the radiance that leaves the surface; (3, Σ n²) float64."""
        return self.albedo[:, None] * self.light

    @cached_property
    def square(self) -> np.ndarray:
        """The square of the luminance that ``reflected`` brings, in the look's ``unit``; (Σ n²,) float64."""
        return np.concatenate([turn(term.square[None], self.matrix)[0] for term in self.seen.terms])

    @property
    def in_units(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``reflected`` and ``square`` in the look's ``unit``, and where terms begin: as for ``light_texels``."""
        light = np.ascontiguousarray(self.reflected / self.look.unit, np.float32)
        return light, np.ascontiguousarray(self.square, np.float32), self.look.firsts.astype(np.int32)

    @cached_property
    def lobes(self) -> LampArrays:
        """The look's lobes as lamps, turned; what they give is told times its albedo and in its ``unit``."""
        lobes = self.look.lobes
        discs = [disc(np.array(lobe.towards), lobe.cosine) for lobe in lobes]
        towards = np.array([lobe.towards for lobe in lobes]).reshape(-1, 3) @ self.matrix.T
        edges = np.array(discs).reshape(-1, 2, 3) @ self.matrix.T
        shine = np.array([lobe.irradiance for lobe in lobes]).reshape(-1, 3) * self.look.albedo
        shine /= math.pi * self.look.unit
        return LampArrays(np.full(len(lobes), DIRECTIONAL, np.int8), towards, edges, shine)

    @cached_property
    def sky(self) -> Sky:
        """Unshadowed light, lobes beside, in the look's ``unit``: it stands in for what is not baked."""
        around = turn(self.look.beside, self.matrix)
        order = math.isqrt(around.shape[1])
        lobe = cosine_lobe_factors(order)[band_of(order)] / math.pi
        return Sky(order, lobe, self.albedo[:, None] * around / self.look.unit)

    @cached_property
    def bare(self) -> Bare:
        """The same by the normal, in single floats; what texels' light is carried as shares of.

        Of lobes, whose light texels have from other surfaces alone, it holds the mean, as if from all sides. A colour
        of lamps that the middle of the volume sees nothing of counts as the brightest one there.
        """
        shining = self.look.recipe.scene.lamps.arrays.colours.any(axis=0) & (self.mean == 0.0)
        mean = self.albedo * np.where(shining, self.mean.max() or 1.0, self.mean) / self.look.unit
        lobes = (self.around - turn(self.look.beside, self.matrix))[:, 0] / math.sqrt(4.0 * math.pi)
        reflected = np.maximum(self.albedo * lobes / self.look.unit, 0.0)
        quadric = quadric_of(self.sky.lobe * self.sky.light)
        return Bare(*(np.ascontiguousarray(each, np.float32) for each in (quadric, LEAST * mean, reflected)))

    @cached_property
    def surroundings(self) -> Surroundings:
        """All light as it is, for the path tracer."""
        return self.look.recipe.surroundings(self.matrix)

    @property
    def mean(self) -> np.ndarray:
        """Mean radiance of the environment, (3,) linear RGB."""
        return self.around[:, 0] / math.sqrt(4.0 * math.pi)

    def local_model(self, shading: str, depths: tuple[float, float]) -> LocalModel:
        """The constants of a local model under this environment: one key light and an ambient rest."""
        key, sun, ambient = self.key_light()
        near, far = depths if shading.endswith("fog") else (0.0, 0.0)
        return LocalModel(
            key=key,
            sun=triple(self.albedo * sun),
            ambient=triple(self.albedo * ambient),
            shine=SHINE if shading.startswith("phong") else 0.0,
            exponent=EXPONENT,
            shadow=shading.endswith("shadow"),
            fog_near=near,
            fog_far=far,
        )

    def key_light(self) -> tuple[tuple[float, float, float], np.ndarray, np.ndarray]:
        """Direction towards the key light, its irradiance over π, and the ambient radiance; both (3,) linear RGB.

        The strongest lamp as the middle of the volume sees it, and all else as ambient light. Without one,
        the directional light and constant with the same bands 0 and 1 as the environment: D·Y_1 = ℓ_1,
        at most what band 0 holds. Without a direction of its own, a light over the camera's shoulder
        carries six tenths of the mean.
        """
        scene = self.look.recipe.scene
        directions, irradiances = scene.lamps.seen_from(scene.volume.centre)
        strengths = irradiances @ LUMINANCE
        if strengths.any():
            best = int(strengths.argmax())
            rest = (irradiances.sum(axis=0) - irradiances[best]) / (4.0 * math.pi)
            return triple(directions[best]), irradiances[best] / math.pi, scene.environment.mean() + rest
        first = np.array([self.around[:, i] if i < self.around.shape[1] else np.zeros(3) for i in (3, 1, 2)])
        pull = first @ LUMINANCE
        strength = float(np.linalg.norm(pull)) * math.sqrt(4.0 * math.pi / 3.0)
        mean = float(self.mean @ LUMINANCE)
        if strength <= KEY_SHARE * 4.0 * math.pi * mean:
            return shoulder_light(self.view.camera), 0.6 * self.mean, 0.4 * self.mean
        share = min(strength / (4.0 * math.pi * mean), 0.9)
        towards = pull / np.linalg.norm(pull)
        return triple(towards), 4.0 * share * self.mean, (1.0 - share) * self.mean


def turn(light: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Coefficients (…, n²) of lights turned by ``matrix`` (3, 3), always from the unturned one."""
    if light.shape[1] == 1 or np.array_equal(matrix, np.eye(3)):
        return light
    turned = np.empty_like(light)
    rotate(math.isqrt(light.shape[1]), matrix, light, turned)
    return turned


def quadric_of(light: np.ndarray) -> np.ndarray:
    """Harmonics (3, n²) of order 3 at most as polynomials of the unit vector: over 1, y, z, x, xy, yz, z², xz, x² - y².

    Returns (3, 9) float64. Source: Ramamoorthi and Hanrahan 2001, eq. 13.
    """
    quadric = np.zeros((3, 9))
    quadric[:, : light.shape[1]] = light
    quadric[:, 0] -= math.sqrt(5.0 / 4.0) * quadric[:, 6]
    return quadric * np.sqrt(np.array([1.0, 3.0, 3.0, 3.0, 15.0, 15.0, 45.0 / 4.0, 15.0, 15.0 / 4.0]) / (4.0 * math.pi))


def disc(towards: np.ndarray, cosine: float) -> np.ndarray:
    """Two radii (2, 3) of the disc about the unit direction ``towards`` (3,) whose half angle has the ``cosine``."""
    aside = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    east = aside / np.linalg.norm(aside)
    return math.sqrt(1.0 - cosine**2) * np.array([east, np.cross(towards, east)])


def shoulder_light(camera: Camera) -> tuple[float, float, float]:
    """Unit direction towards a light above and to the left of the viewer."""
    right, up, forward = camera.basis()
    towards = -forward + 0.5 * up - 0.4 * right
    return triple(towards / np.linalg.norm(towards))


def triple(v: np.ndarray) -> tuple[float, float, float]:
    """Three floats, as the kernels take vectors."""
    x, y, z = (float(a) for a in v)
    return x, y, z
