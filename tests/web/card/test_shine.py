"""Shine that a card draws: its functions beside the kernels, its pictures beside isogi's."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.card.blurred_surroundings import blurred_surroundings
from isogi_core.frame.rays.shine import lobe_of
from isogi_core.kernels.transport.microfacets import (
    light_below,
    reflected,
    reflected_pdf,
    sample_reflected,
    schlick_fresnel,
)
from isogi_core.model.environment import pixel_directions
from isogi_core.model.material import Shine
from isogi_core.model.view import View, rotation_matrix
from tests.frame.conftest import LOOSE, SKY, Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import TURN, CardScene, Lab, developed, light_of, packed, plain_light

SIZE = (64, 64)
RNG = np.random.default_rng(79)


def view_at(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=SIZE[0], **settings)


INCLUDES = ["intersect.glsl", "field.glsl", "irradiance_ratio.glsl", "lobes.glsl", "shine.glsl"]
KINDS = {
    "plastic": {"kind": "plastic", "roughness": 0.5, "strength": 0.8},
    "metal": {"kind": "metal", "roughness": 0.3},
}


@pytest.fixture(scope="module", params=KINDS)
def shown(request: pytest.FixtureRequest, lab: Lab, make_bench: Make) -> Workbench:
    """A scene that shines, which the card has as ``card``."""
    scene = load_scene("demo:orbital", lights=[SKY], shine=KINDS[request.param], target_error=0.5)
    bench = make_bench(scene)
    CardScene(lab, bench.renderer, view_at(bench), SIZE, lobes=True)
    return bench


def run(lab: Lab, body: str, inputs: np.ndarray) -> np.ndarray:
    """Four numbers of each of the ``inputs`` (items, fours, 4) by a ``body`` of GLSL, with the
    shine of the card's scene under a turned light.
    """
    given = {
        "includes": INCLUDES,
        "body": body,
        "inputs": packed(inputs),
        "fours": inputs.shape[1],
        "turn": TURN,
    }
    script = """const { turnLight } = await import("/web/card/light.js");
      const { shine, document, programs } = card.drawing;
      const light = turnLight(document, given.turn);
      const uniforms = { ...shine.at(programs.energy, undefined, light, 0), albedo: [1, 1, 1] };
      const integers = document.volume.type !== "float32";
      const defines = { VOXELS: `highp ${integers ? "u" : ""}sampler3D`, SMOOTH: 1, LOBES: 1 };
      defines.RATIOS = 1;
      return bench.evaluate(card.device, { ...given, uniforms, defines });"""
    return lab.floats(script, given).reshape(-1, 4)


def directions(count: int) -> np.ndarray:
    """Unit vectors above the surface; (count, 4) float32, the last number a random one."""
    w = RNG.normal(size=(count, 4))
    w[:, :3] /= np.linalg.norm(w[:, :3], axis=1, keepdims=True)
    w[:, 2] = np.abs(w[:, 2])
    w[:, 3] = RNG.random(count)
    return w.astype(np.float32)


def test_directions_are_sampled_as_by_the_kernel(lab: Lab, shown: Workbench) -> None:
    given = np.stack([directions(300), RNG.random((300, 4))], axis=1).astype(np.float32)
    body = "return vec4(sample_reflected(given(0).xyz, given(1).xy), 0.0);"
    alpha = lobe_of(light_of(shown.renderer, view_at(shown))).alpha
    expected = [
        sample_reflected(alpha, tuple(v[:3]), float(a), float(b))
        for v, (a, b, *_) in given.astype(float)
    ]
    apart = np.abs(run(lab, body, given)[:, :3] - expected).max(axis=1)
    assert np.median(apart) < 1e-4 and (apart < 1e-3).mean() > 0.85, "but for the steepest facets"
    assert apart.max() < 0.03


def test_a_ray_weighs_the_lobe_over_its_density(lab: Lab, shown: Workbench) -> None:
    given = np.stack([directions(300), directions(300)], axis=1)
    lobe = lobe_of(light_of(shown.renderer, view_at(shown)))
    pairs = [(tuple(v[:3]), tuple(w[:3])) for v, w in given.astype(float)]
    density = np.array([reflected_pdf(lobe.alpha, v, w) for v, w in pairs])
    shares = np.array([lobe.strength * reflected(lobe.alpha, v, w) for v, w in pairs]) / density
    fresnel = np.array([schlick_fresnel(lobe.facing, v, w) for v, w in pairs])
    body = """vec3 v = given(0).xyz, l = given(1).xyz;
      return vec4(weight_of(v, l), reflected_pdf(v, l));"""
    found = run(lab, body, given)
    np.testing.assert_allclose(found[:, :3], shares[:, None] * fresnel, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(found[:, 3], density, rtol=2e-3)


def test_diffuse_light_is_left_as_by_the_kernel(lab: Lab, shown: Workbench) -> None:
    given = directions(300)[:, None]
    lobe = lobe_of(light_of(shown.renderer, view_at(shown)))
    expected = [light_below(lobe, float(v)) for v in given[:, 0, 2]]
    found = run(lab, "return vec4(light_below(given(0).z), 0.0);", given)[:, :3]
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize("level", [0, 2])
def test_surroundings_are_looked_up_where_they_are(lab: Lab, shown: Workbench, level: int) -> None:
    """At the middles of their pixels, under a turned light."""
    around = blurred_surroundings(shown.scene.lighting.environment)
    rows = around.rows >> level
    towards = pixel_directions(rows, 2 * rows) @ rotation_matrix(TURN).T
    width = np.pi / rows
    given = np.concatenate([towards, np.full((*towards.shape[:2], 1), width)], axis=2)
    body = "return vec4(far_light(given(0).xyz, given(0).w), 0.0);"
    picked = RNG.choice(rows * 2 * rows, 500)
    found = run(lab, body, given.reshape(-1, 1, 4)[picked].astype(np.float32))[:, :3]
    expected = around.brightness * around.levels[level].reshape(-1, 3)[picked].astype(float)
    near = np.abs(found / expected - 1.0).max(axis=1)
    assert np.median(near) < 2e-3 and (near < 0.05).mean() > 0.97


MOST = 13.0
"""Mean difference, levels of 255: the noise of the final picture itself is half of a tenth."""

SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "plastic": ({"environment": "studio"}, {"kind": "plastic", "roughness": 0.3}),
    "mirror": ({"environment": "studio"}, {"kind": "metal", "roughness": 0.1}),
    "metal": ({"lights": [SKY]}, {"kind": "metal", "roughness": 0.4}),
}


@pytest.fixture(scope="module", params=SCENES)
def shiny(request: pytest.FixtureRequest, make_bench: Make) -> Workbench:
    """The casting with a shine; ``view_at`` is baked."""
    light, shine = SCENES[request.param]
    given = {"bounces": 2, "target_error": LOOSE, "projected": False}
    bench = make_bench(load_scene("demo:casting", shine=shine, **light, **given))
    bench.bake(view_at(bench))
    return bench


@pytest.mark.parametrize("rest", [False, True])
def test_shine_is_near_to_isogis(lab: Lab, shiny: Workbench, rest: bool) -> None:
    """Beside the final picture, in levels of 255, away from edges."""
    view = view_at(shiny)
    exposure = shiny.scene.default_exposure
    truth = shiny.settled(view).radiance
    card = CardScene(lab, shiny.renderer, view, SIZE, lobes=True)
    card.light(view, LOOSE)
    shown = card.picture(view, rest=rest, exposure=exposure)
    plain = plain_light(shiny.renderer, view, LOOSE)[0]
    on = shown.covers == 1.0
    codes = developed(truth, on, exposure)
    # Edges are where a neighbour differs by more than the page's check takes for none.
    beside = [np.roll(codes, step, axis) for axis in (0, 1) for step in (-1, 1)]
    flat = on & (np.abs(codes - beside).max(axis=(0, 3)) < 24)
    assert flat.sum() > 300
    near, far = (
        np.abs(developed(light, on, exposure) - codes)[flat].mean()
        for light in (shown.light, plain)
    )
    assert near < MOST and near < 0.65 * far, (near, far)


def test_another_lobe_needs_no_other_document(lab: Lab, shiny: Workbench) -> None:
    """A view may ask for any."""
    view = view_at(shiny)
    other = Shine("metal", 0.6, 0.7)
    card = CardScene(lab, shiny.renderer, view, SIZE, lobes=True)
    card.light(view, LOOSE)
    lobe = {"kind": other.kind, "roughness": other.roughness, "strength": other.strength}
    found = card.picture(view, shine=lobe).light
    CardScene(lab, shiny.renderer, replace(view, shine=other), SIZE, lobes=True)
    card.light(view, LOOSE)
    assert np.array_equal(card.picture(view).light, found)
    assert not np.array_equal(card.picture(view, shine={**lobe, "roughness": 0.3}).light, found)
    plain = card.picture(view, shine={**lobe, "strength": 0.0})
    dull = card.picture(view, shine={**lobe, "kind": "plastic", "strength": 0.0})
    assert np.array_equal(plain.light, dull.light), "without strength nothing is mirrored"
