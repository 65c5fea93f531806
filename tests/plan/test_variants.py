"""Scenes made of scenes: in other light, of another material, finer, and by the sides of several
surfaces.
"""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import files_of
from isogi_core.errors import SceneError
from isogi_core.files.radiance import write_hdr
from isogi_core.files.scene_file import read_clears, split_settings
from isogi_core.model.environment import Environment, pixel_directions, solid_angles
from isogi_core.model.lights import EnvironmentLight, ProbeLight
from isogi_core.model.material import MATERIALS, Material
from isogi_core.model.view import quaternion_from_angles, rotation_matrix
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import (
    OUTER,
    Side,
    find_materials,
    finer,
    has_finer,
    scene_of_side,
    sides_of,
    turned_by,
    under,
    with_clears,
    with_material,
)

TEXT = """
volume = "demo:orbital"
environment = "{}"
[[lights]]
type = "directional"
"""


@pytest.fixture(scope="module")
def own() -> Scene:
    return load_scene("demo:orbital")


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("probes") / "glow.hdr"
    image = np.ones((16, 32, 3))
    image[3, 5] = 64.0
    write_hdr(place, image)
    return place


def test_it_is_the_scene_that_its_file_would_be(own: Scene) -> None:
    lit = under(own, "studio", "orbital@studio")
    written = load_scene("demo:orbital", environment="studio")
    assert lit.lighting.lights == (EnvironmentLight("studio"),) == written.lighting.lights
    assert (lit.digest, lit.bake_digest, lit.plan) == (
        written.digest,
        written.bake_digest,
        written.plan,
    )
    assert lit.digest != own.digest and lit.id == "orbital@studio"


def test_it_shares_the_volume_and_what_was_surveyed(own: Scene) -> None:
    assert own.texels and own.presets is not None
    lit = under(own, "evening", "orbital@evening")
    assert lit.volume is own.volume and lit.texels is own.texels and lit.presets is own.presets
    assert lit.lighting.environment is under(own, "evening", "other").lighting.environment


def test_it_replaces_lamps_and_turns_then(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(TEXT.format("studio"))
    scene = load_scene(tmp_path / "a.toml")
    assert (
        scene.lighting.lights == (EnvironmentLight("studio"),)
        and not scene.lighting.lamps.any
        and scene.lighting.rotating
    )


def test_a_probe_is_found_beside_the_scene(probe: Path) -> None:
    (probe.parent / "a.toml").write_text(TEXT.format("glow.hdr"))
    scene = load_scene(probe.parent / "a.toml")
    assert scene.lighting.lights == (ProbeLight(probe.parent.resolve() / "glow.hdr"),)
    assert files_of(scene.source.document) == ["glow.hdr"]
    assert files_of({"environment": "studio", "lights": [{"type": "probe", "file": "x.hdr"}]}) == []
    assert under(scene, str(probe), "a@b").lighting.environment is scene.lighting.environment, (
        "equal probes are kept once"
    )


LOBES = {"surfaces": [{"isovalue": 0.012, "albedo": [0.8, 0.3, 0.1]}], "isovalue": 0.06}


def probes(folder: Path) -> tuple[Path, Path]:
    """A probe of 72 columns, 5 degrees each, and the same turned by hand by 40 degrees."""
    image = np.random.default_rng(4).uniform(0.0, 2.0, (36, 72, 3))
    image[6:14, 16:26] = 9.0
    for name, turned in (("own.hdr", image), ("turned.hdr", np.roll(image, 8, axis=1))):
        write_hdr(folder / name, turned)
    return folder / "own.hdr", folder / "turned.hdr"


def test_turned_light_is_that_of_a_probe_turned_by_hand(tmp_path: Path) -> None:
    own, by_hand = (
        load_scene("demo:orbital", environment=str(each), **LOBES) for each in probes(tmp_path)
    )
    assert own.lighting.baked_by_turn and not own.lighting.rotating
    turned = turned_by(own, (40.0, 0.0, 0.0), "turned")
    environment = turned.lighting.environment
    assert (environment.image == by_hand.lighting.environment.image).all()
    assert (environment.image != own.lighting.environment.image).any()
    assert turned.turn == (40.0, 0.0, 0.0) and turned.volume is own.volume
    assert turned.default_exposure == own.default_exposure != by_hand.default_exposure
    assert turned.bake_digest != own.bake_digest
    for side in sides_of(turned):
        made = scene_of_side(turned, side, 0.06)
        assert made.lighting.environment is environment
        assert build_scene(made.source).bake_digest == made.bake_digest, "as workers open it"


@pytest.mark.parametrize("yaw", [7.0, 40.0, -95.0])
@pytest.mark.parametrize("pitch", [0.0, 25.0])
def test_light_is_turned_as_views_turn_kept_light(tmp_path: Path, yaw: float, pitch: float) -> None:
    """After the turn that the scene gives its environment itself."""
    scene = load_scene(
        "demo:orbital", environment=str(probes(tmp_path)[0]), turned=[10.0, 5.0, 0.0], **LOBES
    )
    first = rotation_matrix(quaternion_from_angles(10.0, 5.0, 0.0))
    turn = rotation_matrix(quaternion_from_angles(yaw, pitch, 0.0))
    turned = turned_by(scene, (yaw, pitch, 0.0), "turned").lighting.environment
    own = load_scene("demo:orbital", environment=str(probes(tmp_path)[0]), **LOBES)
    towards, spread = moments(own.lighting.environment)
    matrix = turn @ first
    for found, expected, former in zip(
        moments(turned),
        (matrix @ towards, matrix @ spread @ matrix.T),
        (towards, spread),
        strict=True,
    ):
        size = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, atol=0.02 * size)
        assert np.abs(former - expected).max() > 0.03 * size


def moments(environment: Environment) -> tuple[np.ndarray, np.ndarray]:
    """The means of d (3,) and of d dᵀ (3, 3) over the radiance from all directions d."""
    size = environment.image.shape[:2]
    directions = pixel_directions(*size)
    weights = solid_angles(*size) * environment.image.mean(axis=-1)
    spread = np.einsum("hw,hwi,hwj->ij", weights, directions, directions)
    return np.einsum("hw,hwi->i", weights, directions), spread


def test_a_turn_about_z_moves_columns_and_keeps_energy(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", environment=str(probes(tmp_path)[0]), **LOBES)
    own = scene.lighting.environment
    half = turned_by(scene, (2.5, 0.0, 0.0), "half").lighting.environment
    expected = 0.5 * (own.image.astype(np.float64) + np.roll(own.image, 1, axis=1))
    np.testing.assert_allclose(half.image, expected, rtol=1e-6)
    np.testing.assert_allclose(half.mean(), own.mean(), rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "turnable"),
    [
        ({}, True),
        ({"rotating": False}, False),
        ({"lights": [{"type": "sky"}, {"type": "directional"}]}, False),
        ({"surfaces": None}, False),
    ],
)
def test_light_is_baked_for_each_turn_where_none_is_kept_for_all(
    settings: dict[str, Any], turnable: bool
) -> None:
    given = {**LOBES, "lights": [{"type": "sky"}], **settings}
    scene = load_scene(
        "demo:orbital", **{key: value for key, value in given.items() if value is not None}
    )
    assert scene.lighting.turnable == turnable == scene.lighting.baked_by_turn


def test_even_light_is_baked_for_no_turn() -> None:
    lighting = load_scene("demo:orbital", lights=[{"type": "constant"}], **LOBES).lighting
    assert lighting.turnable and not lighting.baked_by_turn


def test_a_targets_light_may_follow_its_name() -> None:
    assert split_settings("a.nrrd#environment=studio") == ("a.nrrd", {"environment": "studio"})
    assert split_settings("a.nrrd#axes=raw&environment=/b%26c.hdr")[1] == {
        "axes": "raw",
        "environment": "/b&c.hdr",
    }


def test_choices_that_do_not_fit_the_light_are_refused() -> None:
    even = load_scene("demo:orbital", lights=[{"type": "constant"}], representation="constant")
    with pytest.raises(SceneError, match="shows constant light alone"):
        under(even, "studio", "x")
    with pytest.raises(SceneError, match="no environment 'moon'"):
        under(even, "moon", "x")


@pytest.mark.parametrize(
    "settings", [{"material": "glass", "index": 1.3}, {"material": "subsurface"}]
)
def test_of_another_material_it_is_the_scene_of_its_file(
    own: Scene, settings: dict[str, object]
) -> None:
    assert own.texels
    made = with_material(own, settings, "orbital@=x")
    written = load_scene("demo:orbital", **settings)
    assert (made.digest, made.bake_digest, made.plan) == (
        written.digest,
        written.bake_digest,
        written.plan,
    )
    assert (
        made.digest != own.digest
        and made.id == "orbital@=x"
        and made.surfaces.material == written.surfaces.material
    )
    assert made.volume is own.volume and made.texels is own.texels
    assert build_scene(made.source).bake_digest == made.bake_digest, "as workers open it"
    assert with_material(made, {"material": "diffuse"}, own.id).digest == own.digest


def test_a_range_of_albedos_is_not_of_a_subsurface() -> None:
    painted = load_scene("demo:orbital", albedo=0.8, albedos=[0.0, 0.9])
    wax = with_material(painted, {"material": "subsurface"}, "wax")
    assert (
        wax.surfaces.albedos is None
        and wax.surfaces.albedo == (0.8, 0.8, 0.8)
        and not wax.lighting.rotating
    )
    assert with_material(painted, {"material": "glass"}, "glass").surfaces.albedos is None


def test_the_plan_tells_which_materials_a_scene_may_have(own: Scene) -> None:
    found = find_materials(own)
    assert list(found) == list(MATERIALS) and all(
        isinstance(each, Scene) for each in found.values()
    )
    sun = {"type": "directional", "azimuth": 0, "elevation": 50, "irradiance": 1}
    lit = find_materials(load_scene("demo:orbital", lights=[sun]))
    assert isinstance(lit["glass"], Scene) and "Lamps do not reach inside" in str(lit["subsurface"])
    fiery = find_materials(load_scene("demo:orbital", glow=[{"sphere": [40, 40, 40, 5]}]))
    assert [isinstance(each, Scene) for each in fiery.values()] == [True, False, False]
    assert "glow is not seen through it" in str(fiery["glass"])


def test_a_target_may_name_its_material() -> None:
    scene = load_scene("demo:orbital#material=glass,index%3D1.3&environment=studio")
    assert scene.surfaces.material == Material("glass", 1.3) and scene.lighting.lights == (
        EnvironmentLight("studio"),
    )
    with pytest.raises(SceneError, match="is not one of diffuse, glass, subsurface"):
        load_scene("demo:orbital#material=jelly")


# --- finer light
# --------------------------------------------------------------------------------------------------


SKY = {"type": "sky"}


def test_finer_light_has_more_texels_and_bands() -> None:
    scene = load_scene("demo:orbital", lights=[SKY])
    better = finer(scene)
    assert better.settings.lattice == 2.0 and better.volume is scene.volume
    before, after = (
        {layer.kind: layer.order for layer in each.plan.layers} for each in (scene, better)
    )
    assert after == {kind: order + 2 for kind, order in before.items()}
    assert better.plan.order == max(after.values()) and better.plan.lobes == scene.plan.lobes
    assert not {scene.layer_digest(layer) for layer in scene.plan.layers} & set(
        map(better.layer_digest, better.plan.layers)
    )
    assert dict(better.plan.errors)["harmonics"] < dict(scene.plan.errors)["harmonics"]


def test_light_without_bands_has_more_texels_alone() -> None:
    scene = load_scene("demo:orbital", lights=[{"type": "constant"}])
    assert finer(scene).plan.layers == scene.plan.layers and finer(scene).settings.lattice == 2.0


def test_another_process_finds_the_same_light() -> None:
    """Workers are told the source of a scene, and the plan."""
    better = finer(load_scene("demo:orbital", lights=[SKY], lattice=0.5))
    built = build_scene(better.source)
    assert built.plan_digest(better.plan) == better.bake_digest


@pytest.mark.parametrize(
    ("settings", "expected"), [({}, True), ({"lattice": 2.5}, False), ({"room": "cornell"}, False)]
)
def test_there_is_finer_light_to_a_quarter_of_a_voxel(
    settings: dict[str, object], expected: bool
) -> None:
    assert has_finer(load_scene("demo:orbital", **settings)) == expected


# --- sides of several surfaces
# ----------------------------------------------------------------------------------------


SKIN = {"isovalue": 60.0, "clear": 0.5, "albedo": [0.8, 0.5, 0.4]}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:casting", surfaces=[SKIN, {"isovalue": 90.0}], isovalue=127.0)


def test_there_are_two_sides_of_each_surface(scene: Scene) -> None:
    sides = sides_of(scene)
    assert sides == tuple(Side(number, inner) for number in range(3) for inner in (False, True))
    made = [scene_of_side(scene, side, 127.0) for side in sides]
    assert len({each.bake_digest for each in made}) == 6
    assert [each.solid for each in made] == ["above", "below"] * 3
    assert [each.isovalue for each in made] == [127.0, 127.0, 60.0, 60.0, 90.0, 90.0]
    assert [each.surfaces.clear for each in made] == [0.0, 0.0, 0.5, 0.5, 0.0, 0.0]


def test_both_sides_transmit_alike() -> None:
    leaf = {"isovalue": 60.0, "albedo": 0.3, "transmission": [0.1, 0.5, 0.1]}
    scene = load_scene(
        "demo:casting", albedo=0.2, transmission=0.6, surfaces=[leaf], isovalue=127.0
    )
    made = {side: scene_of_side(scene, side, 127.0) for side in sides_of(scene)}
    assert [each.surfaces.transmission for each in made.values()] == [(0.6,) * 3] * 2 + [
        (0.1, 0.5, 0.1)
    ] * 2
    assert made[Side(1, True)].surfaces.pinned[0].transmission == (0.6,) * 3
    assert len({each.bake_digest for each in made.values()}) == 4
    for each in made.values():
        assert build_scene(each.source).bake_digest == each.bake_digest, "as workers open it"


def test_pinned_light_depends_on_what_is_shown_alone(scene: Scene) -> None:
    """One cache of the surface that slides serves every isovalue; pinned ones have one for each."""
    for side in sides_of(scene):
        one, other = (scene_of_side(scene, side, shown).bake_digest for shown in (127.0, 140.0))
        assert (one == other) == (side.number == 0), side


def test_a_pinned_surface_is_lit_by_all_others(scene: Scene) -> None:
    made = scene_of_side(scene, Side(1), 140.0)
    assert {each.isovalue: each.clear for each in made.surfaces.pinned} == {140.0: 0.0, 90.0: 0.0}
    assert made.surfaces.albedo == (0.8, 0.5, 0.4)
    assert made.span[0] == made.span[1]


def test_a_surface_at_the_shown_isovalue_lights_others_once(scene: Scene) -> None:
    made = scene_of_side(scene, Side(1), 90.0)
    assert [each.isovalue for each in made.surfaces.pinned] == [90.0]
    ends = [
        scene_of_side(scene, Side(1, True), shown).surfaces.pinned
        for shown in scene.volume.value_range
    ]
    assert [len(each) for each in ends] == [2, 2]


@pytest.mark.parametrize("settings", [{"cut": "x<30"}, {"inside_out": True}, {"solid": "below"}])
def test_sides_of_what_is_cut_or_turned_are_found_again(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    nrrd.write(str(tmp_path / "ball.nrrd"), shell_of(33), index_order="C")
    scene = load_scene(
        tmp_path / "ball.nrrd",
        surfaces=[{"isovalue": 60.0, "clear": 0.5}],
        isovalue=90.0,
        **settings,
    )
    for side in sides_of(scene):
        made = scene_of_side(scene, side, 100.0)
        assert (made.solid == scene.solid) != side.inner
        assert build_scene(made.source).bake_digest == made.bake_digest, side


def shell_of(side: int) -> np.ndarray:
    """A ball that is brightest in its middle, (side, side, side) uint8."""
    z, y, x = np.mgrid[:side, :side, :side] - (side - 1) / 2.0
    return np.clip(200.0 - 12.0 * np.sqrt(x**2 + y**2 + z**2), 0.0, 255.0).astype(np.uint8)


def test_a_process_that_opens_a_side_finds_the_same_light(scene: Scene) -> None:
    """The document of a side is all that workers are given."""
    for side in sides_of(scene):
        made = scene_of_side(scene, side, 133.0)
        assert build_scene(made.source).bake_digest == made.bake_digest, side
    assert scene_of_side(scene, OUTER, 133.0) is scene


def test_a_scene_with_other_clears_is_one_of_its_own(scene: Scene) -> None:
    changed = with_clears(scene, read_clears("0.25, off", 2), "other")
    assert [(each.isovalue, each.clear) for each in changed.surfaces.pinned] == [(60.0, 0.25)]
    assert changed.id == "other" and changed.volume is scene.volume
    assert (
        changed.bake_digest
        != scene.bake_digest
        == with_clears(scene, (0.5, 0.0), "same").bake_digest
    )
    assert build_scene(changed.source).bake_digest == changed.bake_digest, "as workers open it"
    alone = with_clears(scene, (None, None), "alone")
    assert not alone.surfaces.several and alone.lighting.rotating, "light of one surface turns"


@pytest.mark.parametrize(
    ("text", "pinned", "reason"),
    [
        ("0.5", 2, "each of the 2"),
        ("1.5", 1, "from 0, opaque"),
        ("nan", 1, "or off"),
        ("", 1, "or off"),
        ("off", 0, "leave it"),
    ],
)
def test_clears_without_meaning_are_refused(text: str, pinned: int, reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        read_clears(text, pinned)


def test_a_target_may_name_what_its_surfaces_let_pass(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("[[surfaces]]\nisovalue = 0.03\n[[surfaces]]\nisovalue = 0.05\nclear = 0.5\n")
    assert [each.clear for each in load_scene(f"{file}#surfaces=0.25,0.5").surfaces.pinned] == [
        0.25,
        0.5,
    ]
    (left,) = load_scene(f"{file}#surfaces=off,0.75&environment=studio").surfaces.pinned
    assert (left.isovalue, left.clear) == (0.05, 0.75)
    with pytest.raises(SceneError, match="each of the 2 pinned surfaces"):
        load_scene(f"{file}#surfaces=0.5")
    with pytest.raises(SceneError, match="leave it out"):
        load_scene("demo:casting#surfaces=0.5")
