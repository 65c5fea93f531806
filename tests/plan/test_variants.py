"""Scenes in other light or of another material: what changes, what they share, and what they keep of baked light."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.cache.scene_assets import files_of
from isogi_core.errors import SceneError
from isogi_core.files.radiance import write_hdr
from isogi_core.files.scene_file import split_settings
from isogi_core.model.lights import EnvironmentLight, ProbeLight
from isogi_core.model.material import MATERIALS, Material
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import find_materials, under, with_material

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
    assert (lit.digest, lit.bake_digest, lit.plan) == (written.digest, written.bake_digest, written.plan)
    assert lit.digest != own.digest and lit.id == "orbital@studio"


def test_it_shares_the_volume_and_what_was_surveyed(own: Scene) -> None:
    assert own.texels and own.presets is not None
    lit = under(own, "evening", "orbital@evening")
    assert lit.volume is own.volume and lit.texels is own.texels and lit.presets is own.presets
    assert lit.lighting.environment is under(own, "evening", "other").lighting.environment


def test_a_layer_of_transfer_depends_on_no_environment(own: Scene) -> None:
    noon, overcast = (under(own, name, name) for name in ("noon", "overcast"))
    layer = replace(noon.plan.layers[0], order=4)
    assert noon.layer_digest(layer) == overcast.layer_digest(layer) == own.layer_digest(layer)


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


def test_a_targets_light_may_follow_its_name() -> None:
    assert split_settings("a.nrrd#environment=studio") == ("a.nrrd", {"environment": "studio"})
    assert split_settings("a.nrrd#axes=raw&environment=/b%26c.hdr")[1] == {"axes": "raw", "environment": "/b&c.hdr"}


def test_choices_that_do_not_fit_the_light_are_refused() -> None:
    even = load_scene("demo:orbital", lights=[{"type": "constant"}], representation="constant")
    with pytest.raises(SceneError, match="shows constant light alone"):
        under(even, "studio", "x")
    with pytest.raises(SceneError, match="no environment 'moon'"):
        under(even, "moon", "x")


@pytest.mark.parametrize("settings", [{"material": "glass", "index": 1.3}, {"material": "subsurface"}])
def test_of_another_material_it_is_the_scene_of_its_file(own: Scene, settings: dict[str, object]) -> None:
    assert own.texels
    made, written = with_material(own, settings, "orbital@=x"), load_scene("demo:orbital", **settings)
    assert (made.digest, made.bake_digest, made.plan) == (written.digest, written.bake_digest, written.plan)
    assert made.digest != own.digest and made.id == "orbital@=x" and made.surfaces.material == written.surfaces.material
    assert made.volume is own.volume and made.texels is own.texels
    assert build_scene(made.source).bake_digest == made.bake_digest, "as workers open it"
    assert with_material(made, {"material": "diffuse"}, own.id).digest == own.digest


def test_a_range_of_albedos_is_not_of_a_subsurface() -> None:
    painted = load_scene("demo:orbital", albedo=0.8, albedos=[0.0, 0.9])
    wax = with_material(painted, {"material": "subsurface"}, "wax")
    assert wax.surfaces.albedos is None and wax.surfaces.albedo == (0.8, 0.8, 0.8) and not wax.lighting.rotating
    assert with_material(painted, {"material": "glass"}, "glass").surfaces.albedos is None


def test_the_plan_tells_which_materials_a_scene_may_have(own: Scene) -> None:
    found = find_materials(own)
    assert list(found) == list(MATERIALS) and all(isinstance(each, Scene) for each in found.values())
    sun = {"type": "directional", "azimuth": 0, "elevation": 50, "irradiance": 1}
    lit = find_materials(load_scene("demo:orbital", lights=[sun]))
    assert isinstance(lit["glass"], Scene) and "Lamps do not reach inside" in str(lit["subsurface"])
    fiery = find_materials(load_scene("demo:orbital", glow=[{"sphere": [40, 40, 40, 5]}]))
    assert [isinstance(each, Scene) for each in fiery.values()] == [True, False, False]
    assert "glow is not seen through it" in str(fiery["glass"])


def test_a_target_may_name_its_material() -> None:
    scene = load_scene("demo:orbital#material=glass,index%3D1.3&environment=studio")
    assert scene.surfaces.material == Material("glass", 1.3) and scene.lighting.lights == (EnvironmentLight("studio"),)
    with pytest.raises(SceneError, match="is not one of diffuse, glass, subsurface"):
        load_scene("demo:orbital#material=jelly")
