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
from isogi_core.model.view import View, rotation_matrix
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import TURN, CardScene, Difference, Lab, difference, light_of, packed

SIZE = (64, 64)
STUDIO = {"type": "environment", "environment": "studio"}
RNG = np.random.default_rng(79)


def view_at(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=SIZE[0], **settings)


def bench_of(make_bench: Make, light: dict[str, Any], shine: dict[str, Any]) -> Workbench:
    """The casting under a light, with this shine; ``view_at`` is baked."""
    bench = make_bench(
        load_scene(
            "demo:casting",
            lights=[light],
            shine=shine,
            bounces=2,
            target_error=LOOSE,
            projected=False,
        )
    )
    bench.bake(view_at(bench))
    return bench


INCLUDES = ["intersect.glsl", "field.glsl", "irradiance_ratio.glsl", "shine.glsl"]
KINDS = {"plastic": {"kind": "plastic", "roughness": 0.5, "strength": 0.8}, "metal": {"kind": "metal", "roughness": 0.3}}


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
      const { shine, document } = card.drawing;
      const light = turnLight(document, given.turn);
      const uniforms = { ...shine.at(light, 0), albedo: [1, 1, 1] };
      const defines = { VOXELS: "highp usampler3D", SMOOTH: 1, RATIOS: 1, LOBES: 1 };
      if (document.volume.type === "float32") defines.VOXELS = "highp sampler3D";
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
    np.testing.assert_allclose(run(lab, body, given)[:, :3], expected, atol=2e-4)


def test_a_ray_weighs_the_lobe_over_its_density(lab: Lab, shown: Workbench) -> None:
    given = np.stack([directions(300), directions(300)], axis=1)
    lobe = lobe_of(light_of(shown.renderer, view_at(shown)))
    pairs = [(tuple(v[:3]), tuple(l[:3])) for v, l in given.astype(float)]
    density = [reflected_pdf(lobe.alpha, v, l) for v, l in pairs]
    expected = [
        lobe.strength * reflected(lobe.alpha, v, l) / p * np.array(schlick_fresnel(lobe.facing, v, l))
        for (v, l), p in zip(pairs, density, strict=True)
    ]
    body = "return vec4(weight_of(given(0).xyz, given(1).xyz), reflected_pdf(given(0).xyz, given(1).xyz));"
    found = run(lab, body, given)
    np.testing.assert_allclose(found[:, :3], expected, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(found[:, 3], density, rtol=2e-3)


def test_diffuse_light_is_left_as_by_the_kernel(lab: Lab, shown: Workbench) -> None:
    given = directions(300)[:, None]
    lobe = lobe_of(light_of(shown.renderer, view_at(shown)))
    expected = [light_below(lobe, float(v)) for v in given[:, 0, 2]]
    found = run(lab, "return vec4(light_below(given(0).z), 0.0);", given)[:, :3]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("level", [0, 2])
def test_surroundings_are_looked_up_where_they_are(lab: Lab, shown: Workbench, level: int) -> None:
    """At the middles of their pixels, under a turned light."""
    around = blurred_surroundings(shown.scene.lighting.environment)
    rows = around.rows >> level
    towards = pixel_directions(rows, 2 * rows) @ rotation_matrix(TURN).T
    width = np.pi / rows
    # Density of one of four rays whose solid angle has that width.
    density = 1.0 / (4.0 * np.pi * width**2 * 4.0)
    given = np.concatenate([towards, np.full((*towards.shape[:2], 1), density)], axis=2)
    body = "return vec4(far_light(given(0).xyz, given(0).w), 0.0);"
    picked = RNG.choice(rows * 2 * rows, 500)
    found = run(lab, body, given.reshape(-1, 1, 4)[picked].astype(np.float32))[:, :3]
    expected = around.brightness * around.levels[level].reshape(-1, 3)[picked].astype(float)
    near = np.abs(found / expected - 1.0).max(axis=1)
    assert np.median(near) < 2e-3 and (near < 0.05).mean() > 0.97


def compared(lab: Lab, bench: Workbench, rest: bool, **more: Any) -> Difference:
    """How far the card's picture is from isogi's final one."""
    view = replace(view_at(bench), **more)
    truth = bench.settled(view)
    card = CardScene(lab, bench.renderer, view, SIZE, lobes=True)
    card.light(view, LOOSE)
    exposure = bench.scene.default_exposure
    shown = card.picture(view, rest=rest, exposure=exposure)
    return difference(shown, truth.radiance, truth.state > 0, exposure)
