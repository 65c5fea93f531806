"""The light around a view: the rotated environment and lamps, in the forms that the kernels of
shading take.
"""

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, Term, band_of
from isogi_core.files.vector import triple
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.irradiance_ratio import MIN_UNSHADOWED, Unshadowed
from isogi_core.kernels.shading.lattice import Sky
from isogi_core.kernels.shading.local_models import LocalModel
from isogi_core.kernels.simd.types import REGISTER_LANES
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors, rotate
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.lights import DIRECTIONAL, LampArrays
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.material import Shine
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import Camera, View, rotation_matrix
from isogi_core.plan.scene import Scene

PICTURE_FORMAT = 15
"""Number of the format of pictures. It counts up when the same light makes another picture, so
that browsers ask for theirs again.
"""


KEY_SHARE = 0.1
"""An environment whose band 1 is weaker than this share of its mean has no direction of its
own, and thus no key light.
"""


KEY_LIGHT_SHARE = 0.6
"""Share of a light that comes from its own direction; the rest is taken to come from everywhere."""


PHONG_STRENGTH = 0.3
PHONG_EXPONENT = 32.0
"""Strength and exponent of Phong's highlight."""


@dataclass(frozen=True, eq=False)
class RotatedLight:
    """The lights of a ``spec``, rotated for one view and reflected by the albedo that it asks
    for.
    """

    spec: BakeSpec
    view: View

    @cached_property
    def seen(self) -> BakeSpec:
        """The spec with the view's albedo. Raises ViewError if the scene's light is not made
        for it.
        """
        return self.spec.of_albedo(self.spec.prepared.scene.surfaces.leaving_for(self.view.albedo))

    @cached_property
    def matrix(self) -> np.ndarray:
        """The rotation of the light, (3, 3) float64."""
        return rotation_matrix(self.view.light)

    @cached_property
    def light(self) -> np.ndarray:
        """The light that texels' columns are multiplied by: rotated coefficients of each term
        in turn; (3, Σ n²) linear RGB.
        """
        return np.concatenate(
            [rotated_by(self._met(term), self.matrix) for term in self.seen.terms], axis=1
        )

    def _met(self, term: Term) -> np.ndarray:
        """Return the light of a ``term`` before rotation, (3, n²); glow has the brightness that
        the view asks for.
        """
        if term.glows:
            return self.glow * term.light
        return term.light

    def light_of(self, layer: Layer) -> np.ndarray:
        """Return the rotated light by which the coefficients of a ``layer`` are multiplied, if its
        light is not of glows; (3, n²) float64 linear RGB.
        """
        term = self.seen.term_of(layer)
        # Layers that are kept at several albedos, the nodes, are mixed to the albedo of the view in
        # ``colours_of``. The light of their terms is weighted for that already, so take that of the
        # spec.
        if layer.nodes:
            light = self.spec.light[:, : term.order**2]
        else:
            light = term.light
        return rotated_by(light, self.matrix)

    def colours_of(self, layer: Layer, light: np.ndarray) -> np.ndarray:
        """Return light (…, channels, n²) of a ``layer`` in the three colours that the surface
        gives it; (…, 3, n²).
        """
        if layer.nodes:
            return np.asarray(np.einsum("...jn,cj->...cn", light, self.seen.mixing))
        return np.broadcast_to(light, (*light.shape[:-2], 3, light.shape[-1]))

    @cached_property
    def around(self) -> np.ndarray:
        """ℓ of the rotated lights on a surface without shadows; (3, n²) float64 linear RGB."""
        return rotated_by(self.spec.prepared.around, self.matrix)

    @property
    def albedo(self) -> np.ndarray:
        """The share of light that leaves the surface, (3,): reflected by its albedo, and
        transmitted from its other side.
        """
        return np.array(self.seen.albedo)

    @property
    def coloured(self) -> bool:
        """True if the surface has colours by data; ``albedo`` is then the brightest of them."""
        return self.spec.prepared.scene.surfaces.colours is not None

    def tints(self, gbuffer: GBuffer, tiles: Tiles) -> np.ndarray:
        """Return the albedo of a coloured surface at each point of a G-buffer, over ``albedo``,
        which is the brightest of its colours; (m, 3) float32 from 0 to 1. Raises Cancelled.
        """
        found = gbuffer.albedos(self.spec.prepared.colours, tiles)
        return np.asarray(found / np.maximum(self.albedo, 1e-30).astype(np.float32))

    @property
    def shine(self) -> Shine | None:
        """The shine of the surface, None if it is diffuse. Raises ViewError if views of the
        scene may not ask for any.
        """
        return self.spec.prepared.scene.surfaces.shine_for(self.view.shine)

    @property
    def glow(self) -> float:
        """The brightness of glow over the scene's. Raises ViewError if the view asks for one
        and nothing glows.
        """
        return self.spec.prepared.scene.lighting.glow_for(self.view.glow)

    @property
    def reflecting(self) -> tuple[float, float, float]:
        """The largest albedo of each colour, of the surface or of a wall."""
        return replace(self.spec.prepared.scene.inputs, albedo=self.seen.albedo).reflecting

    @property
    def tint(self) -> np.ndarray:
        """The albedo that the view asks for over that of the spec, (3,)."""
        if self.seen is not self.spec:
            return self.albedo / np.maximum(self.spec.albedo, 1e-30)
        return np.ones(3)

    @cached_property
    def reflected(self) -> np.ndarray:
        """``light`` times the albedo: its product with τ is the radiance that leaves the
        surface; (3, Σ n²) float64.
        """
        return self.albedo[:, None] * self.light

    @cached_property
    def square(self) -> np.ndarray:
        """Harmonics of the function L², with the luminance L of ``reflected`` as a function of the
        direction, in the spec's ``unit``: ``Term.square`` of each term in turn, rotated; (Σ n²,)
        float64.

        For glows it is an upper bound. The variance of a path's luminance follows from it: see
        ``light_texels``.
        """
        squares = []
        for term in self.seen.terms:
            square = term.square
            if term.glows:
                square = self.glow**2 * square
            # The rotated square is the square of the rotated light.
            squares.append(rotated_by(square[None], self.matrix)[0])
        return np.concatenate(squares)

    @property
    def in_units(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """``reflected`` and ``square`` in the spec's ``unit``, the first column of each term,
        and that of reflected light: arguments of ``light_texels``.
        """
        light = np.ascontiguousarray(self.reflected / self.spec.unit, np.float32)
        square = np.ascontiguousarray(self.square, np.float32)
        return light, square, self.spec.firsts.astype(np.int32), self.spec.straight

    @cached_property
    def lobes(self) -> LampArrays:
        """The lobes of the spec as rotated directional lamps; their light includes its albedo,
        in its ``unit``.
        """
        lobes = self.spec.lobes
        discs = [disc(lobe.towards, lobe.cosine) for lobe in lobes]
        towards = np.array([lobe.towards for lobe in lobes]).reshape(-1, 3) @ self.matrix.T
        edges = np.array(discs).reshape(-1, 2, 3) @ self.matrix.T
        shine = np.array([lobe.irradiance for lobe in lobes]).reshape(-1, 3) * self.spec.albedo
        shine /= math.pi * self.spec.unit
        return LampArrays(np.full(len(lobes), DIRECTIONAL, np.int8), towards, edges, shine)

    @cached_property
    def sky(self) -> Sky:
        """Unshadowed light without lobes, in the spec's ``unit``: it replaces light that is not
        baked.
        """
        around = either_side(rotated_by(self.spec.beside, self.matrix), self.spec.prepared.scene)
        order = math.isqrt(around.shape[1])
        lobe = cosine_lobe_factors(order)[band_of(order)] / math.pi
        return Sky(order, lobe, self.albedo[:, None] * around / self.spec.unit)

    @cached_property
    def unshadowed(self) -> Unshadowed:
        """Unshadowed light as a function of the normal, in float32: irradiance ratios of texels
        are relative to it.
        """
        # A colour of lamps that the middle of the volume sees nothing of counts as the brightest
        # there: ratios to nothing are of no use.
        lamps = self.spec.prepared.scene.lighting.lamps.arrays.colours.any(axis=0)
        hidden = lamps & (self.mean == 0.0)
        mean = self.albedo * np.where(hidden, self.mean.max() or 1.0, self.mean) / self.spec.unit
        quadric = quadric_of(self.sky.lobe * self.sky.light)
        return Unshadowed(
            np.ascontiguousarray(quadric, np.float32),
            np.ascontiguousarray(MIN_UNSHADOWED * mean, np.float32),
        )

    @cached_property
    def surroundings(self) -> Surroundings:
        """All light as the path tracer takes it."""
        return self.spec.prepared.surroundings(self.matrix)

    @property
    def mean(self) -> np.ndarray:
        """Mean radiance of the environment, (3,) linear RGB."""
        return self.around[:, 0] / math.sqrt(4.0 * math.pi)

    def local_model(
        self, shading: str, depths: tuple[float, float], albedo: np.ndarray | None = None
    ) -> LocalModel:
        """Return the constants of a local model under this light: one key light, and the rest as
        ambient light.

        ``depths`` are those of fog; ``albedo`` (3,) replaces that of the surface if it is given.
        """
        if albedo is None:
            albedo = self.albedo
        key, sun, ambient = self.key_light()
        # Fog, highlight and shadow follow from the name of the model.
        near, far = (0.0, 0.0)
        if shading.endswith("fog"):
            near, far = depths
        highlight = 0.0
        if shading.startswith("phong"):
            highlight = PHONG_STRENGTH
        return LocalModel(
            key=key,
            sun=triple(albedo * sun),
            ambient=triple(albedo * ambient),
            shine=highlight,
            exponent=PHONG_EXPONENT,
            shadow=shading.endswith("shadow"),
            fog_near=near,
            fog_far=far,
        )

    def key_light(self) -> tuple[tuple[float, float, float], np.ndarray, np.ndarray]:
        """Return the direction towards the key light, its irradiance over π, and the ambient
        radiance; both (3,) linear RGB.

        1. The strongest lamp as seen from the middle of the volume, and all else as ambient light.
           Among walls, which reflect the lamp's light, it keeps the share KEY_LIGHT_SHARE.
        2. Without lamps, a directional and a constant light with the same bands 0 and 1 as the
           environment: D·Y_1 = ℓ_1, at most what band 0 holds.
        3. If the environment has no direction, a light over the camera's shoulder with the share
           KEY_LIGHT_SHARE of the mean.
        """
        scene = self.spec.prepared.scene
        # Case 1: take the strongest lamp.
        if self.key_follows == "nothing":
            directions, irradiances = scene.lighting.lamps.seen_from(scene.volume.centre)
            strengths = irradiances @ LUMINANCE_WEIGHTS
            best = int(strengths.argmax())
            towards = triple(directions[best])
            others = (irradiances.sum(axis=0) - irradiances[best]) / (4.0 * math.pi)
            rest = others + scene.lighting.environment.mean()
            key = irradiances[best] / math.pi
            if scene.lighting.room.any:
                return towards, KEY_LIGHT_SHARE * key, (1.0 - KEY_LIGHT_SHARE) * key + rest
            return towards, key, rest
        # Case 3: the environment is even, or nearly so.
        if self.key_follows == "camera":
            ambient = (1.0 - KEY_LIGHT_SHARE) * self.mean
            return shoulder_light(self.view.camera), KEY_LIGHT_SHARE * self.mean, ambient
        # Case 2: the directional light has a share of all light, which is 4π times the mean.
        pull, share = self._brightest_side
        direction = pull / np.linalg.norm(pull)
        share = min(share, 0.9)
        return triple(direction), 4.0 * share * self.mean, (1.0 - share) * self.mean

    @property
    def key_follows(self) -> Literal["nothing", "light", "camera"]:
        """Say how the key light moves: not at all, with the environment ("light"), or with the
        camera. These are cases 1, 2 and 3 of ``key_light``.
        """
        scene = self.spec.prepared.scene
        _, irradiances = scene.lighting.lamps.seen_from(scene.volume.centre)
        if (irradiances @ LUMINANCE_WEIGHTS).any():
            return "nothing"
        _, share = self._brightest_side
        return "light" if share > KEY_SHARE else "camera"

    @cached_property
    def _brightest_side(self) -> tuple[np.ndarray, float]:
        """The direction to the brightest side of the environment, (3,) of any length, and the share
        of all light, 4π times the mean, that a directional light from there has; 0 without light.
        """
        # The coefficients of band 1 for x, y and z point to the brightest side. The sum of their
        # squares for a directional light D is D² · 3 / 4π.
        band_1 = np.zeros((3, 3))
        if self.around.shape[1] > 1:
            band_1 = np.ascontiguousarray(self.around[:, [3, 1, 2]].T)
        pull = band_1 @ LUMINANCE_WEIGHTS
        strength = float(np.linalg.norm(pull)) * math.sqrt(4.0 * math.pi / 3.0)
        mean = float(self.mean @ LUMINANCE_WEIGHTS)
        return pull, strength / (4.0 * math.pi * mean) if mean > 0.0 else 0.0


def rotated_by(light: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return the coefficients of k lights (k, n²), rotated by ``matrix`` (3, 3); (k, n²).

    Rotate the unrotated light each time: errors of one rotation after the other add up.
    """
    if light.shape[1] == 1 or np.array_equal(matrix, np.eye(3)):
        return light
    rotated = np.empty_like(light)
    rotate(math.isqrt(light.shape[1]), matrix, light, rotated)
    return rotated


def either_side(light: np.ndarray, scene: Scene) -> np.ndarray:
    """Return unshadowed ``light`` (3, n²) as it falls on both sides of a surface that
    transmits, each by its share in the light that leaves: Y_l(-n) = (-1)^l Y_l(n). Other
    surfaces see only the side of their normal.
    """
    if not any(scene.surfaces.transmission):
        return light
    albedo = np.array(scene.surfaces.albedo)
    through = np.array(scene.surfaces.transmission)
    turned = (albedo - through) / np.maximum(albedo + through, 1e-30)
    return np.where(band_of(math.isqrt(light.shape[1])) % 2 == 1, turned[:, None], 1.0) * light


def quadric_of(light: np.ndarray) -> np.ndarray:
    """Return harmonics (3, n²) of order 3 at most as polynomials of the unit vector, (3, 9)
    float64: over 1, y, z, x, xy, yz, z², xz, x² - y².

    Source: Ramamoorthi and Hanrahan 2001, eq. 13.
    """
    quadric = np.zeros((3, 9))
    quadric[:, : light.shape[1]] = light
    quadric[:, 0] -= math.sqrt(5.0 / 4.0) * quadric[:, 6]
    return quadric * np.sqrt(
        np.array([1.0, 3.0, 3.0, 3.0, 15.0, 15.0, 45.0 / 4.0, 15.0, 15.0 / 4.0]) / (4.0 * math.pi)
    )


@lru_cache(64)
def disc(towards: tuple[float, float, float], cosine: float) -> np.ndarray:
    """Return two radii (2, 3) of the disc about the unit direction ``towards`` whose half angle
    has this ``cosine``.
    """
    normal = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    east = normal / np.linalg.norm(normal)
    return math.sqrt(1.0 - cosine**2) * np.array([east, np.cross(towards, east)])


def shoulder_light(camera: Camera) -> tuple[float, float, float]:
    """Return the unit direction towards a light above and to the left of the viewer."""
    right, up, forward = camera.basis()
    towards = -forward + 0.5 * up - 0.4 * right
    return triple(towards / np.linalg.norm(towards))


def version_of(light: RotatedLight, read: bytes) -> str:
    """Return a hex digest of all that a picture is made of: scene, bake spec, view, and the light
    that was ``read``. Of the view it counts the fields of its repr; callers name others in
    ``read``.

    Light is summed in the order of the processor's registers, so their width is part of it.
    """
    spec = light.spec.digest
    scene = light.spec.prepared.scene.digest
    return hashlib.blake2b(
        repr((PICTURE_FORMAT, scene, spec, light.view, read, REGISTER_LANES)).encode(),
        digest_size=16,
    ).hexdigest()
