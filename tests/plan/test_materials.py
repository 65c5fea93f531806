"""The material of a scene's surface: what may be said of it, and what a scene of glass leaves out."""

import json

import pytest

from isogi_core.errors import SceneError
from isogi_core.model.material import DIFFUSE, Material
from isogi_core.model.scene_plan import LeftOut
from isogi_core.plan.scene import INSIDE_KIND
from isogi_core.plan.surfaces import unrefracted
from tests.loaded import load_scene

GLASS, INSIDE = {"material": "glass"}, {"material": "subsurface"}
SUN = {"type": "directional", "azimuth": 0, "elevation": 50, "irradiance": 1}


def test_glass_has_an_index_and_an_absorption() -> None:
    assert load_scene("demo:orbital").surfaces.material == DIFFUSE
    scene = load_scene("demo:orbital", **GLASS, absorption=0.1)
    assert not scene.bakes
    assert scene.surfaces.material == Material("glass", 1.5, (0.1, 0.1, 0.1))
    others = [load_scene("demo:orbital", **GLASS, **more) for more in ({}, {"index": 1.3}, {"absorption": [0.1, 0, 0]})]
    digests = [each.digest for each in (load_scene("demo:orbital"), scene, *others)]
    assert len(set(digests)) == len(digests)


def test_a_subsurface_has_a_mean_free_path_and_light_of_its_own() -> None:
    scene = load_scene("demo:orbital", **INSIDE, mean_free_path=2, albedo=0.8)
    assert scene.surfaces.material.mean_free_path == 2.0
    assert scene.plan.representation == "irradiance"
    assert not scene.lighting.rotating
    assert scene.bakes == {INSIDE_KIND}
    others = [load_scene("demo:orbital", **INSIDE, albedo=0.8, **more) for more in ({}, {"mean_free_path": 1})]
    assert len({each.bake_digest for each in (scene, *others)}) == 3
    scene.require_texels()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"material": "jelly"}, "material"),
        ({**GLASS, "index": 0.5}, "number from 1 to 4"),
        ({**GLASS, "absorption": -1}, "must not be less than 0"),
        ({**GLASS, "absorption": [1, 2]}, "give one, or three"),
        ({"index": 1.5}, 'add material = "glass"'),
        ({**GLASS, "albedo": 0.5}, "reflects no diffuse light: leave albedo out"),
        ({**GLASS, "shine": {}}, "leave shine out"),
        ({**GLASS, "glow": [{"sphere": [40, 40, 40, 5]}]}, "leave glow out"),
        ({**GLASS, "surfaces": [{"isovalue": 0.01}]}, "leave surfaces out"),
        ({**INSIDE, "mean_free_path": 0}, "more than 0"),
        ({**INSIDE, "albedo": [0.5, 0.5, 0]}, "0.01 or more"),
        ({**INSIDE, "lights": [SUN]}, "Lamps do not reach inside"),
        ({**INSIDE, "clear": 0.5}, "leave clear out"),
        ({"mean_free_path": 2}, 'add material = "subsurface"'),
    ],
)
def test_what_has_no_meaning_is_refused_in_a_sentence(settings: dict[str, object], said: str) -> None:
    with pytest.raises(SceneError) as refused:
        load_scene("demo:orbital", **settings)
    assert said in str(refused.value)
    assert json.dumps(str(refused.value)).count("\\n") == 0


def left_out(**settings: object) -> tuple[LeftOut, ...]:
    """What the material of the orbital leaves out."""
    scene = load_scene("demo:orbital", **settings)
    return unrefracted(scene.surfaces.material, scene.lighting.lights, scene.lighting.environment.sharp)


def test_caustics_of_lamps_that_no_ray_meets_are_left_out() -> None:
    found = {each.what: each.why for each in left_out(lights=[SUN], **GLASS)}
    assert "texels of the isosurface" in found
    assert any("caustics" in what and "wall with radiance" in why for what, why in found.items())
    assert not any("caustic" in each.what for each in left_out(room="cornell", **GLASS))
    assert not left_out(lights=[SUN])


def test_light_that_glass_does_not_keep_is_not_given_away() -> None:
    load_scene("demo:orbital").require_texels()
    with pytest.raises(SceneError, match="keeps no light of its own"):
        load_scene("demo:orbital", **GLASS).require_texels()
