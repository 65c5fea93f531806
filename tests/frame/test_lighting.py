"""The light around a view: turned each time, boiled down to a key light, and noise at another
albedo.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.lighting import RotatedLight, shoulder_light
from isogi_core.frame.noise_rescaling import (
    all_weights,
    reflected_weights,
    scatter_at,
    weights_between,
)
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors, evaluate
from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions, solid_angles
from isogi_core.model.view import IDENTITY, Camera, Quaternion, View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import orbital
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, luminance
from tests.loaded import load_scene

LAMP = {"type": "directional", "azimuth": 90.0, "elevation": 30.0, "irradiance": [2.0, 1.0, 0.5]}
CAMERA = Camera((10.0, 3.0, 4.0), (0.0, 0.0, 0.0))
QUARTER = quaternion_from_angles(90.0, 0.0, 0.0)
ODD = quaternion_from_angles(33.0, -20.0, 71.0)


def around(lights: list[Any], turn: Quaternion = IDENTITY, **settings: Any) -> RotatedLight:
    """The light of a scene, turned; harmonics have all of it unless given."""
    prepared = PreparedScene(
        load_scene("demo:orbital", **{"lights": lights, "lobes": 0, **settings})
    )
    return RotatedLight(spec_for(prepared, "gi"), View(0.03, CAMERA, turn))


def spot(folder: Path, direction: tuple[float, float, float], glow: float = 0.0) -> dict[str, Any]:
    """A probe that is bright in the pixels within 12 degrees of a direction, and glows all over."""
    directions = pixel_directions(64, 128)
    image = np.where(
        (directions @ np.array(direction) > math.cos(math.radians(12)))[..., None], 50.0, glow
    )
    write_hdr(folder / "spot.hdr", np.broadcast_to(image, (64, 128, 3)).astype(np.float32))
    return {"type": "probe", "file": str(folder / "spot.hdr")}


def test_light_rotates_as_its_directions_do(tmp_path: Path) -> None:
    """ℓ of the turned light against the sum over the probe's own pixels in turned directions."""
    turned = around([spot(tmp_path, (0.6, 0.0, 0.8), 0.2), CONSTANT], ODD, order=5)
    matrix = Rotation.from_quat(ODD, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turned.matrix, matrix, atol=1e-12)
    image = turned.spec.prepared.scene.lighting.environment.image
    expected = np.zeros((3, 25))
    basis = np.empty(25)
    for light, area, d in zip(
        image.reshape(-1, 3),
        solid_angles(*image.shape[:2]).ravel(),
        (pixel_directions(*image.shape[:2]) @ matrix.T).reshape(-1, 3),
        strict=True,
    ):
        evaluate(5, *map(float, d), basis)
        expected += area * light[:, None] * basis
    expected[:, 0] += math.sqrt(4 * math.pi)
    np.testing.assert_allclose(turned.light[:, :25], expected, atol=0.01 * expected[0, 0])


def test_rotation_keeps_the_mean_and_the_power_of_each_band() -> None:
    plain = around([SKY])
    odd = around([SKY], ODD)
    assert np.array_equal(plain.light[:, : plain.spec.straight], plain.spec.light)
    np.testing.assert_allclose(
        odd.mean, plain.spec.prepared.scene.lighting.environment.mean(), rtol=1e-3
    )
    for l in range(plain.spec.order):
        band = slice(l * l, (l + 1) ** 2)
        np.testing.assert_allclose(
            (odd.light[:, band] ** 2).sum(), (plain.light[:, band] ** 2).sum(), rtol=1e-9
        )


def test_constant_light_has_band_0_alone() -> None:
    turned = around([CONSTANT], ODD)
    np.testing.assert_allclose(turned.light, [[math.sqrt(4 * math.pi)]] * 3)
    assert turned.sky.order == 1


def test_reflected_light_is_tinted_by_the_albedo() -> None:
    turned = around([SKY], albedo=[0.2, 0.5, 1.0])
    np.testing.assert_allclose(turned.reflected, turned.light * np.array([[0.2], [0.5], [1.0]]))
    assert turned.albedo.tolist() == [0.2, 0.5, 1.0]


def test_sky_holds_the_cosine_lobe_of_each_coefficient() -> None:
    turned = around([SKY], ODD, albedo=[0.2, 0.5, 1.0])
    assert turned.sky.order == 3, "with 99 % of any light"
    bands = [l for l in range(3) for _ in range(2 * l + 1)]
    np.testing.assert_allclose(turned.sky.lobe, cosine_lobe_factors(3)[bands] / math.pi)
    np.testing.assert_allclose(
        turned.sky.light,
        turned.light[:, :9] * np.array([[0.2], [0.5], [1.0]]) / turned.spec.unit,
    )


@pytest.mark.parametrize(
    "settings", [{"representation": "irradiance", "rotating": False}, {"order": 2}]
)
def test_unshadowed_light_does_not_depend_on_what_texels_keep(settings: dict[str, Any]) -> None:
    own = around([SKY], **settings).sky
    other = around([SKY]).sky
    assert own.order == other.order
    np.testing.assert_allclose(own.light, other.light)


def test_unshadowed_light_beside_a_lobe_is_without_it() -> None:
    whole = around([SKY], ODD)
    rest = around([SKY], ODD, lobes=1)
    (sun,) = rest.spec.lobes
    lost = (whole.sky.light - rest.sky.light)[:, 0] * rest.spec.unit * math.sqrt(4.0 * math.pi)
    np.testing.assert_allclose(lost, rest.albedo * np.array(sun.flux))
    assert np.array_equal(whole.around, rest.around), "other models have all of it"


def test_terms_stand_side_by_side_from_their_first_columns() -> None:
    turned = around([SKY], ODD, lobes=1, order=3, indirect_order=2)
    light, square, firsts, straight = turned.in_units
    assert (light.shape, square.shape, firsts.tolist(), straight) == ((3, 13), (13,), [0, 9], 9)
    for layer, columns in zip(turned.spec.plan.layers, (slice(0, 9), slice(9, 13)), strict=True):
        expected = turned.albedo[:, None] * turned.light_of(layer) / turned.spec.unit
        np.testing.assert_allclose(light[:, columns], expected, rtol=1e-6)


def test_surroundings_are_the_environment_and_its_rotation() -> None:
    turned = around([SKY, CONSTANT], QUARTER)
    environment = turned.spec.prepared.scene.lighting.environment
    assert turned.surroundings.image is environment.image
    assert turned.surroundings.constant.tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(turned.surroundings.matrix @ (1, 0, 0), (0, 1, 0), atol=1e-12)


def test_surroundings_have_the_environments_table_and_lamps() -> None:
    turned = around([SKY, LAMP])
    scene = turned.spec.prepared.scene
    assert turned.surroundings.table is scene.lighting.environment.table
    assert turned.surroundings.table.rows.shape == (513,)
    assert turned.surroundings.table.columns.shape == (512, 1025)
    assert turned.surroundings.lamps is scene.lighting.lamps.arrays
    assert around([CONSTANT]).surroundings.table.rows.shape == (0,)


@pytest.mark.parametrize("direction", [(0.0, 0.6, 0.8), (-0.6, 0.8, 0.0), (0.0, 0.0, -1.0)])
def test_key_light_comes_from_the_brightest_side(
    tmp_path: Path, direction: tuple[float, float, float]
) -> None:
    key, _, _ = around([spot(tmp_path, direction)]).key_light()
    assert np.dot(key, direction) > 0.999
    key, _, _ = around([spot(tmp_path, direction)], QUARTER).key_light()
    x, y, z = direction
    assert np.dot(key, (-y, x, z)) > 0.999


def test_key_and_ambient_light_have_the_bands_0_and_1(tmp_path: Path) -> None:
    """A directional light of irradiance E over a constant A: band 0 is √4π (A + E/4π), band 1 is E
    Y_1(key).
    """
    turned = around([spot(tmp_path, (0.6, 0.0, 0.8), glow=0.5)], ODD)
    key, sun, ambient = turned.key_light()
    flux = math.pi * sun
    np.testing.assert_allclose(ambient + flux / (4 * math.pi), turned.mean, rtol=1e-9)
    basis = np.empty(4)
    evaluate(2, *key, basis)
    expected = LUMINANCE_WEIGHTS @ turned.light[:, 1:4]
    np.testing.assert_allclose(
        (LUMINANCE_WEIGHTS @ flux) * basis[1:], expected, rtol=1e-6, atol=1e-9
    )


def test_light_without_a_direction_has_its_key_over_the_shoulder() -> None:
    turned = around([CONSTANT])
    key, sun, ambient = turned.key_light()
    assert key == shoulder_light(CAMERA)
    np.testing.assert_allclose(sun, [0.6] * 3, rtol=1e-9)
    np.testing.assert_allclose(ambient, [0.4] * 3, rtol=1e-9)
    right, up, forward = CAMERA.basis()
    assert np.dot(key, forward) < 0 < np.dot(key, up) and np.dot(key, right) < 0


@pytest.mark.parametrize(("glow", "own"), [(10.0, False), (2.0, True)])
def test_light_with_hardly_a_direction_has_none(tmp_path: Path, glow: float, own: bool) -> None:
    """A spot has 4 % of all light, or 20 %."""
    direction = (0.6, 0.0, 0.8)
    key, _, _ = around([spot(tmp_path, direction, glow)]).key_light()
    assert (np.dot(key, direction) > 0.99) == own
    assert (key == shoulder_light(CAMERA)) != own


def test_a_scene_without_light_has_a_dark_key_light() -> None:
    key, sun, ambient = around([{"type": "constant", "radiance": 0.0}]).key_light()
    assert np.linalg.norm(key) == pytest.approx(1.0)
    assert not sun.any() and not ambient.any()


def test_the_strongest_lamp_is_the_key_light() -> None:
    """As the volume's middle sees it; the other lamps' irradiance E is a radiance of E/4π from all
    around.
    """
    scene = load_scene("demo:orbital")
    x, y, z = scene.volume.centre
    bulb = {"type": "point", "position": [x, y - 20.0, z], "intensity": [4000.0, 2000.0, 0.0]}
    turned = around([CONSTANT, LAMP, bulb])
    key, sun, ambient = turned.key_light()
    np.testing.assert_allclose(key, (0.0, -1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(sun, np.array([10.0, 5.0, 0.0]) / math.pi)
    np.testing.assert_allclose(ambient, 1.0 + np.array([2.0, 1.0, 0.5]) / (4 * math.pi), rtol=1e-12)
    key, sun, _ = around([SKY, LAMP]).key_light()
    np.testing.assert_allclose(key, (0.0, math.sqrt(0.75), 0.5), atol=1e-12)
    np.testing.assert_allclose(sun, np.array([2.0, 1.0, 0.5]) / math.pi)


def test_a_dark_lamp_is_no_key_light() -> None:
    dark = {"type": "directional", "irradiance": 0.0}
    assert around([SKY, dark]).key_light()[0] == around([SKY]).key_light()[0]


def test_path_traced_shadows_are_those_of_shadow_rays(
    workbench: Callable[[Scene], Workbench],
) -> None:
    """Without bounces, a lamp alone makes the reference the local model with a hard shadow, pixel
    by pixel.
    """
    bench = workbench(load_scene("demo:casting", lights=[{**LAMP, "elevation": 50.0}], bounces=0))
    traced, local, open_air = (
        bench.renderer.render(bench.view(shading=shading)).radiance
        for shading in ("path_traced", "lambert_shadow", "lambert")
    )
    shadow = (local == 0.0) & (open_air > 0.0)
    assert shadow.any(axis=-1).sum() > 100 and local.any(axis=-1).sum() > 300
    np.testing.assert_allclose(traced, local, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("shading", "shine", "shadow", "fog"),
    [
        ("lambert", False, False, False),
        ("lambert_shadow", False, True, False),
        ("lambert_fog", False, False, True),
        ("phong", True, False, False),
        ("phong_shadow", True, True, False),
    ],
)
def test_each_local_model_has_the_parts_of_its_name(
    shading: str, shine: bool, shadow: bool, fog: bool
) -> None:
    turned = around([SKY], albedo=0.5)
    model = turned.local_model(shading, (10.0, 30.0))
    key, sun, ambient = turned.key_light()
    assert (model.shine > 0, model.shadow, model.fog_far > model.fog_near) == (shine, shadow, fog)
    assert model.key == key
    np.testing.assert_allclose(model.sun, 0.5 * sun)
    np.testing.assert_allclose(model.ambient, 0.5 * ambient)


@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_a_lamp_inside_the_volume_lights_what_is_around_it(
    offset: float, workbench: Callable[[Scene], Workbench]
) -> None:
    """What stands in for its light while that is baked is about as bright as the light, as the
    exposure is.
    """
    x, y, z = load_scene("demo:orbital").volume.centre
    lamp = {"type": "point", "position": [x + offset, y, z], "intensity": 5000.0}
    bench = workbench(
        load_scene("demo:orbital", lights=[lamp], target_error=LOOSE, bounces=1, lattice=0.5)
    )
    view = bench.view(size=24)
    frames = bench.renderer.render(view), bench.bake(view)
    shown = [luminance(frame) * bench.scene.default_exposure for frame in frames]
    assert all(np.isfinite(each).all() for each in shown)
    assert all(0.01 < each.mean() < 2.0 for each in shown)


# --- noise at another albedo
# ------------------------------------------------------------------------------------------


CHANCES = np.array([0.1, 0.35, 0.7])
"""Of three texels: the chance of their paths to leave at each hit."""


@pytest.fixture(scope="module")
def judged() -> BakeSpec:
    """The orbital under constant light, of which views may ask for albedos up to 0.9; three
    bounces.
    """
    return orbital(0.3, sky=False, albedos=(0.0, 0.9))


def light_of(spec: BakeSpec) -> np.ndarray:
    """Band 0 of each term: what such paths bring unreflected, and at each of the albedos that are
    kept; (3, terms).
    """
    k = np.arange(1, spec.plan.bounces + 1)
    left = CHANCES[:, None] * (1.0 - CHANCES[:, None]) ** k
    return np.column_stack([CHANCES, left @ (np.array(spec.plan.nodes) ** k[:, None])])


@pytest.mark.parametrize("albedo", [(0.3, 0.3, 0.3), (0.05, 0.05, 0.05), (0.9, 0.5, 0.1)])
def test_noise_of_reflected_light_falls_as_squares_of_paths(
    albedo: tuple[float, float, float], judged: BakeSpec
) -> None:
    """Of paths that leave by such chances the variance is known: Σ (mean over colours of R^k)² f (1
    - f)^k.
    """
    seen = judged.of_albedo(albedo)
    kept = light_of(judged)
    k = np.arange(1, judged.plan.bounces + 1)
    left = CHANCES[:, None] * (1.0 - CHANCES[:, None]) ** k
    mix = np.array([0.2126, 0.7152, 0.0722]) * albedo
    brought = (mix / mix.sum()) @ np.array(albedo)[:, None] ** k
    np.testing.assert_allclose(
        kept @ reflected_weights(seen), left @ brought**2, rtol=0.02, atol=2e-4
    )
    weights = weights_between(seen, judged)
    ones = np.ones(3, np.float32)
    none = np.zeros(3, np.float32)
    ratio = scatter_at(weights, ones, ones, kept) / scatter_at(weights, ones, none, kept)
    np.testing.assert_allclose(
        ratio**2, left @ brought**2 / (left @ 0.9 ** (2 * k)), rtol=0.05, atol=2e-4
    )


def test_weights_of_all_paths_leave_the_surface_out(judged: BakeSpec) -> None:
    """Without reflected light it is the same at each albedo; with it there is less at a lower
    one.
    """
    dark = judged.of_albedo((0.3, 0.3, 0.3))
    kept = np.array([[1.0, *([0.0] * len(judged.plan.nodes))]])
    np.testing.assert_allclose(kept @ all_weights(dark), kept @ all_weights(judged))
    assert (light_of(judged) @ all_weights(dark) < light_of(judged) @ all_weights(judged)).all()


def test_noise_at_the_judged_albedo_stays(judged: BakeSpec) -> None:
    weights = weights_between(judged, judged)
    scatter = scatter_at(
        weights, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.5, 1.0]), light_of(judged)
    )
    np.testing.assert_allclose(scatter, [0.1, 0.2, 0.3], rtol=1e-6)
