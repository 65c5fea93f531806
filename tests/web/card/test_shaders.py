"""The shaders' functions, one by one, beside the kernels that have the same formulas."""

from typing import Any

import numpy as np
import pytest

from isogi_core.frame.card.block_format import words_of
from isogi_core.kernels.shading.framebuffer import FINAL, srgb, tone
from isogi_core.kernels.shading.irradiance_ratio import Unshadowed, agree, unshadowed_light
from isogi_core.kernels.shading.lobes import irradiance
from isogi_core.kernels.tracing.cubic import cubic_along, first_crossing, turning_points
from isogi_core.kernels.tracing.field import normal, smooth_gradient, value
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, UNKNOWN_SIDE, cast, launch
from isogi_core.plan.scene import Scene
from tests.frame.conftest import Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import CardScene, Lab, packed

PLAIN = {"VOXELS": "highp usampler3D", "SMOOTH": 1, "RATIOS": 1, "LOBES": 1, "SHADING": 0}
RNG = np.random.default_rng(51)


def run(
    lab: Lab, includes: list[str], body: str, inputs: np.ndarray, **uniforms: Any
) -> np.ndarray:
    """Four numbers of each of the ``inputs`` (items, fours, 4) by a ``body`` of GLSL."""
    fours = inputs.shape[1]
    given = {
        "includes": includes,
        "body": body,
        "inputs": packed(inputs),
        "fours": fours,
        "defines": PLAIN,
        "uniforms": uniforms,
    }
    return lab.floats(
        "window.device ??= bench.device(); return bench.evaluate(device, given);", given
    ).reshape(-1, 4)


def cubics(count: int) -> np.ndarray:
    """Cubics of rays through cells with corners on both sides; (count, 4) float32."""
    corners = RNG.normal(size=(count, 8))
    a = RNG.random((count, 3))
    d = RNG.normal(size=(count, 3))
    return np.array(
        [cubic_along(tuple(c), tuple(p), tuple(q)) for c, p, q in zip(corners, a, d, strict=True)],
        np.float32,
    )


def test_a_ray_through_a_cell_is_the_same_cubic(lab: Lab) -> None:
    numbers = RNG.random((200, 4, 4)).astype(np.float32)
    corners = numbers[:, :2].reshape(-1, 8)
    a = numbers[:, 2, :3]
    d = numbers[:, 3, :3]
    body = """vec4 p = given(0), q = given(1);
      float[8] corners = float[8](p.x, p.y, p.z, p.w, q.x, q.y, q.z, q.w);
      return cubic_along(corners, given(2).xyz, given(3).xyz);"""
    expected = [
        cubic_along(tuple(c), tuple(p), tuple(q))
        for c, p, q in zip(corners.tolist(), a.tolist(), d.tolist(), strict=True)
    ]
    np.testing.assert_allclose(run(lab, ["cubic.glsl"], body, numbers), expected, atol=2e-6)


def test_cubics_turn_where_the_kernel_has_it(lab: Lab) -> None:
    q = np.vstack(
        [cubics(200), [[0, 0, 1, -0.5], [0, 1, -1, 0.2], [0, 0, 0, 1], [1, -1.5, 0.6, -0.05]]]
    ).astype(np.float32)
    found = run(lab, ["cubic.glsl"], "return vec4(turning_points(given(0)), 0.0, 0.0);", q[:, None])
    expected = [turning_points(tuple(each)) for each in q.astype(float).tolist()]
    np.testing.assert_allclose(found[:, :2], expected, atol=2e-5)


def test_cubics_cross_where_the_kernel_has_it(lab: Lab) -> None:
    q = cubics(2000)
    found = run(
        lab,
        ["cubic.glsl"],
        "return vec4(first_crossing(given(0), given(0).w > 0.0, 0.0));",
        q[:, None],
    )[:, 0]
    pairs = [
        first_crossing(tuple(each), each[3] > 0.0, 0.0, True) for each in q.astype(float).tolist()
    ]
    expected = np.array([t if crosses else -1.0 for t, crosses in pairs])
    assert 0.3 < (expected >= 0.0).mean() < 0.9
    same = (found >= 0.0) == (expected >= 0.0)
    assert same.mean() > 0.998, "but for those that only touch"
    values = np.abs([np.polyval(each, t) for each, t in zip(q[same], found[same], strict=True)])
    scale = np.abs(q[same]).max(axis=1)
    assert (values[found[same] >= 0.0] < 2e-6 * scale[found[same] >= 0.0]).all(), (
        "at a root, to rounding"
    )
    assert (np.abs(found - expected)[same] < 1e-3).mean() > 0.999, "at the first one"


@pytest.fixture(scope="module")
def bench(make_bench: Make) -> Workbench:
    """The casting: walls, holes and a corner of the volume that is solid."""
    return make_bench(
        load_scene("demo:casting", lights=[{"type": "constant", "radiance": 1.0}], target_error=0.5)
    )


@pytest.fixture(scope="module")
def volume(lab: Lab, bench: Workbench) -> Scene:
    """The scene of the ``bench``, whose volume the card has as ``card``."""
    CardScene(lab, bench.renderer, bench.view(size=32), (32, 32))
    return bench.scene


def run_in(
    lab: Lab, scene: Scene, includes: list[str], body: str, inputs: np.ndarray
) -> np.ndarray:
    """As ``run``, in the volume of a scene at its isovalue."""
    given = {
        "includes": includes,
        "body": body,
        "inputs": packed(inputs),
        "fours": inputs.shape[1],
        "isovalue": scene.isovalue,
    }
    script = """const { codeOf } = await import("/web/card/document.js");
      const { volume, document } = card.drawing;
      const active = volume.at(codeOf(document, given.isovalue));
      const uniforms = { ...active, offset: document.grid.offset };
      const sampler = document.volume.type === "float32" ? "sampler3D" : "usampler3D";
      const defines = { VOXELS: `highp ${sampler}`, SMOOTH: 1, LOBES: 1, SHADING: 0 };
      return bench.evaluate(card.device, { ...given, uniforms, defines });"""
    return lab.floats(script, given).reshape(-1, 4)


def points_in(scene: Scene, count: int) -> np.ndarray:
    """Places all over the box of a volume, some on its faces; (count, 1, 4) float32."""
    points = RNG.random((count, 1, 4)) * [*(np.array(scene.volume.size) - 1), 0]
    points[:20, 0, 0] = 0.0
    points[20:40, 0, 1] = scene.volume.size[1] - 1
    return points.astype(np.float32)


def near_surface(bench: Workbench, count: int) -> np.ndarray:
    """Points of the surface that a view shows; (count, 3) float32."""
    points = bench.renderer.gbuffer(bench.view(size=64)).points
    return points[:: max(len(points) // count, 1)][:count]


def test_values_are_the_kernels(lab: Lab, volume: Scene, bench: Workbench) -> None:
    points = points_in(volume, 300)
    field = bench.prepared.field
    found = run_in(
        lab, volume, ["volume.glsl", "field.glsl"], "return vec4(value(given(0).xyz));", points
    )[:, 0]
    codes = bench.prepared.voxel_codes
    expected = [
        (value(field.voxels, tuple(p)) - codes.base) / codes.gain
        for p in points[:, 0, :3].astype(float).tolist()
    ]
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.ptp(expected))


def test_gradients_and_normals_are_the_kernels(lab: Lab, volume: Scene, bench: Workbench) -> None:
    points = np.pad(near_surface(bench, 300), ((0, 0), (0, 1)))[:, None]
    includes = ["volume.glsl", "field.glsl"]
    field = bench.prepared.field
    places = [tuple(p) for p in points[:, 0, :3].astype(float).tolist()]
    found = run_in(
        lab, volume, includes, "return vec4(smooth_gradient(given(0).xyz), 0.0);", points
    )[:, :3]
    expected = (
        np.array([smooth_gradient(field.voxels, p) for p in places])
        / bench.prepared.voxel_codes.gain
    )
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    normals = run_in(lab, volume, includes, "return vec4(normal(given(0).xyz), 0.0);", points)[
        :, :3
    ]
    np.testing.assert_allclose(normals, [normal(field, p) for p in places], atol=1e-5)


def test_shadow_rays_start_where_the_kernels_do(lab: Lab, volume: Scene, bench: Workbench) -> None:
    points = near_surface(bench, 200)
    normals = np.array(
        [normal(bench.prepared.field, tuple(p)) for p in points.astype(float).tolist()]
    )
    inputs = np.stack([np.pad(points, ((0, 0), (0, 1))), np.pad(normals, ((0, 0), (0, 1)))], axis=1)
    includes = ["intersect.glsl", "field.glsl", "lobes.glsl"]
    found = run_in(
        lab, volume, includes, "return vec4(launch(given(0).xyz, given(1).xyz), 0.0);", inputs
    )[:, :3]
    iso = volume.volume.normalise_isovalue(volume.isovalue)
    pairs = zip(points.astype(float).tolist(), normals.tolist(), strict=True)
    expected = [
        launch(bench.prepared.field, iso, tuple(p), tuple(n), OUTSIDE_SIGN) for p, n in pairs
    ]
    assert (np.abs(found - expected).max(axis=1) < 1e-4).mean() > 0.99, (
        "but where the place is at the isovalue"
    )


@pytest.mark.parametrize("inside", [False, True], ids=["from afar", "off the surface"])
def test_rays_meet_what_the_kernels_meet(
    lab: Lab, volume: Scene, bench: Workbench, inside: bool
) -> None:
    """Rays into the volume from outside, and shadow rays from the surface."""
    size = np.array(volume.volume.size) - 1.0
    count = 2000
    if inside:
        on = near_surface(bench, 500)
        n = np.array([normal(bench.prepared.field, tuple(p)) for p in on.astype(float).tolist()])
        o = np.repeat(on + 0.4 * n, 4, axis=0)
        d = RNG.normal(size=(4 * len(on), 3))
        side = OUTSIDE_SIGN
        given = "OUTSIDE"
    else:
        ends = RNG.random((count, 3)) * size
        way = RNG.normal(size=(count, 3))
        o = size / 2 + 1.2 * np.linalg.norm(size) * way / np.linalg.norm(way, axis=1, keepdims=True)
        d = ends - o
        side = UNKNOWN_SIDE
        given = "UNKNOWN"
    inputs = np.pad(np.stack([o, d], axis=1), ((0, 0), (0, 0), (0, 1))).astype(np.float32)
    found = run_in(
        lab,
        volume,
        ["intersect.glsl"],
        f"return vec4(cast_ray(given(0).xyz, given(1).xyz, {given}));",
        inputs,
    )[:, 0]
    iso = volume.volume.normalise_isovalue(volume.isovalue)
    field = bench.prepared.field
    rays = inputs[..., :3].astype(float)
    expected = np.array([cast(field, iso, tuple(a), tuple(b), side)[0] for a, b in rays.tolist()])
    hits = np.isfinite(expected)
    assert 0.1 < hits.mean() < 0.95
    assert (hits == (found >= 0.0)).mean() > 0.998
    both = hits & (found >= 0.0)
    away = np.abs(found - expected)[both] * np.abs(rays[both, 1]).max(axis=1)
    assert np.quantile(away, 0.99) < 0.01, "voxels"


def test_unshadowed_light_is_the_kernels(lab: Lab) -> None:
    n = RNG.normal(size=(100, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    quadric = RNG.normal(size=(3, 9)).astype(np.float32)
    least = np.array([0.1, 0.2, 0.0], np.float32)
    uniforms = {"quadric": quadric.T.ravel().tolist(), "least": least.tolist()}
    inputs = np.pad(n, ((0, 0), (0, 1)))[:, None]
    found = run(
        lab,
        ["irradiance_ratio.glsl"],
        "return vec4(unshadowed_light(given(0).xyz), 0.0);",
        inputs,
        **uniforms,
    )
    expected = [
        unshadowed_light(Unshadowed(quadric, least), *each) for each in n.astype(np.float32)
    ]
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-5)


def test_weights_by_normals_are_the_kernels(lab: Lab) -> None:
    pairs = RNG.normal(size=(200, 2, 3))
    pairs /= np.linalg.norm(pairs, axis=2, keepdims=True)
    pairs[0] = pairs[0, 0]
    found = run(
        lab,
        ["irradiance_ratio.glsl"],
        "return vec4(agree(given(0).xyz, given(1).xyz));",
        np.pad(pairs, ((0, 0), (0, 0), (0, 1))),
    )
    records = np.zeros((len(pairs), 16), np.float32)
    records[:, 11:14] = pairs[:, 0]
    expected = [
        agree(records, i, tuple(pair[1].astype(np.float32))) for i, pair in enumerate(pairs)
    ]
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-3, atol=1e-6)


def test_words_of_normals_are_read_back(lab: Lab) -> None:
    n = RNG.normal(size=(300, 3)).astype(np.float32)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:7] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0]]
    words = words_of(n, np.full(len(n), FINAL, np.uint8))
    halves = np.stack([words & 0xFFFF, words >> 16, 0 * words, 0 * words], axis=1)[:, None]
    body = "return vec4(octahedral(uint(given(0).x) | uint(given(0).y) << 16), 0.0);"
    np.testing.assert_allclose(
        run(lab, ["irradiance_ratio.glsl"], body, halves)[:, :3], n, atol=1e-4
    )


def test_the_tone_curve_and_srgb_are_the_kernels(lab: Lab) -> None:
    x = np.concatenate([[0.0], np.geomspace(1e-4, 50.0, 200)]).astype(np.float32)
    inputs = np.repeat(x[:, None, None], 4, axis=2)
    body = "return vec4(tone(given(0).x), srgb(min(given(0).xyz, 1.0)).x, 0.0, 0.0);"
    found = run(lab, ["film.glsl"], body, inputs, curve=[1.7, 0.16, 0.6], exposure=1.0)
    np.testing.assert_allclose(found[:, 0], [tone(float(each)) for each in x], atol=2e-6)
    np.testing.assert_allclose(found[:, 1], [srgb(min(float(each), 1.0)) for each in x], atol=2e-5)


def test_light_of_a_lobe_at_the_horizon_is_the_kernels(lab: Lab) -> None:
    s = 0.3
    cosines = np.linspace(-0.3, 1.0, 60).astype(np.float32)
    inputs = np.stack([cosines, np.full(60, s), 0 * cosines, 0 * cosines], axis=1)[:, None]
    includes = ["intersect.glsl", "field.glsl", "lobes.glsl"]
    found = run(lab, includes, "return vec4(irradiance(given(0).x, given(0).y));", inputs)[:, 0]
    np.testing.assert_allclose(found, [irradiance(float(c), s) for c in cosines], atol=1e-5)
