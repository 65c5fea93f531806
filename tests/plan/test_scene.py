"""Scenes: read from TOML, from a bare volume, or built in; their defaults, their names, and what
they refuse.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.errors import IsogiError, LightError, SceneError, VolumeError
from isogi_core.files.scene_file import FORMER
from isogi_core.model.lights import ConstantLight, SkyLight
from isogi_core.model.material import Shine
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.assembly import load_scene, otsu
from isogi_core.plan.isovalue_presets import Preset, find_boundaries, suggested_presets
from isogi_core.plan.scene import Scene
from tests import loaded

RAMP = np.arange(120, dtype=np.float32).reshape(6, 5, 4)
ORBITAL = "demo:orbital"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the volume ramp.nrrd: 4 × 5 × 6 voxels with the values 0 … 119."""
    where = tmp_path_factory.mktemp("scenes")
    nrrd.write(str(where / "ramp.nrrd"), RAMP, {"spacings": [1.0, 2.0, 0.5]}, index_order="C")
    return where


def scene_of(folder: Path, text: str, **overrides: Any) -> Scene:
    """The scene of this TOML, in the folder of the volume."""
    (folder / "My Scene, 1.toml").write_text(text)
    return load_scene(folder / "My Scene, 1.toml", **overrides)


def test_a_scene_file_says_everything(folder: Path) -> None:
    scene = scene_of(
        folder,
        """
        volume = "ramp.nrrd"
        spacing = [1, 1, 3]
        isovalue = 70
        isovalues = [40, 100.5]
        albedo = [0.7, 0.6, 0.5]
        bounces = 4
        solid = "below"
        lattice = 0.5
        target_error = 0.05
        rotating = false
        projection = "orthographic"
        [[lights]]
        type = "constant"
        radiance = [1.0, 2.0, 3.0]
        [[lights]]
        type = "sky"
        """,
    )
    assert (scene.id, scene.name) == ("my-scene-1", "My Scene, 1")
    assert (scene.isovalue, scene.isovalues, scene.surfaces.albedo) == (
        70.0,
        (40.0, 100.5),
        (0.7, 0.6, 0.5),
    )
    assert (scene.bounces, scene.plan.representation, scene.plan.channels) == (4, "irradiance", 3)
    assert (scene.solid, scene.settings.lattice, scene.target_error, scene.lighting.rotating) == (
        "below",
        0.5,
        0.05,
        False,
    )
    assert (
        scene.settings.projection == "orthographic" and scene.camera(0.0, 0.0, 3.0, 30.0).fov < 1e-4
    )
    assert scene.volume.shape == (6, 5, 4) and scene.volume.spacing == (1.0, 1.0, 3.0)
    assert [type(light) for light in scene.lighting.lights] == [ConstantLight, SkyLight]
    assert scene.lighting.environment.constant.tolist() == [1.0, 2.0, 3.0]


def test_a_bare_volume_is_a_scene_with_defaults(folder: Path) -> None:
    scene = load_scene(folder / "ramp.nrrd")
    assert scene.id == scene.name == "ramp"
    assert scene.volume.spacing == (1.0, 2.0, 0.5)
    assert scene.isovalues == (0.0, 119.0) and 50.0 < scene.isovalue < 70.0, (
        "Otsu's threshold halves a ramp"
    )
    assert (
        scene.surfaces.albedo == (0.7, 0.7, 0.7)
        and scene.settings.lattice == 1.0
        and scene.target_error == 0.02
    )
    assert scene.lighting.rotating and scene.solid == "above" and scene.bounces == 12
    assert scene.lighting.lights == (SkyLight(),)


def test_without_a_target_there_is_a_demo() -> None:
    scene = load_scene()
    assert scene.id == "casting" and scene.isovalue == 127.5
    assert scene.bake_digest == load_scene("demo:casting").bake_digest


def test_overrides_replace_settings(folder: Path) -> None:
    text = 'volume = "ramp.nrrd"\nalbedo = 0.5\n'
    assert scene_of(folder, text, albedo=0.25, isovalue=10).surfaces.albedo == (0.25,) * 3
    assert load_scene(ORBITAL, isovalue=0.2).isovalue == 0.2


def test_presets_are_those_that_the_scene_names_in_its_order(folder: Path) -> None:
    told = '[{name = "bone", isovalue = 90}, {name = " skin", isovalue = 30.5}]'
    scene = scene_of(folder, f'volume = "ramp.nrrd"\nisovalues = [20, 110]\npresets = {told}')
    assert scene.presets == (Preset("bone", 90.0), Preset("skin", 30.5))
    assert (
        scene.bake_digest
        == scene_of(folder, 'volume = "ramp.nrrd"\nisovalues = [20, 110]').bake_digest
    )


def test_presets_are_suggested_where_the_scene_names_none() -> None:
    assert load_scene(ORBITAL).presets == suggested_presets(
        find_boundaries(load_scene(ORBITAL).volume, (0.0, 1.0))
    )


@pytest.mark.parametrize(
    ("missing", "holes"), [("119", 1), ("[0, 119]", 2), ("[]", 0), ("-9999", 0)]
)
def test_values_that_are_missing_are_holes(folder: Path, missing: str, holes: int) -> None:
    scene = scene_of(folder, f'volume = "ramp.nrrd"\nmissing = {missing}')
    assert scene.volume.holes == holes


def test_outliers_are_outside_the_default_range_of_isovalues(folder: Path) -> None:
    values = np.arange(120.0).reshape(6, 5, 4)
    values[0, 0, 0] = 1e30
    nrrd.write(str(folder / "hot.nrrd"), values, index_order="C")
    scene = scene_of(folder, 'volume = "hot.nrrd"')
    assert scene.isovalues == (1.0, 119.0) and 50 < scene.isovalue < 70
    assert scene_of(folder, 'volume = "hot.nrrd"\nisovalues = [1, 1e30]').isovalues == (1.0, 1e30)


def test_isovalue_falls_into_the_range_that_views_may_ask_for(folder: Path) -> None:
    assert scene_of(folder, 'volume = "ramp.nrrd"\nisovalues = [100, 110]').isovalue == 100.0


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("isovalue = 500", "isovalue"),
        ("isovalue = nan", "isovalue"),
        ("isovalue = true", "isovalue"),
        ("isovalues = [90, 10]", "isovalues"),
        ("isovalues = [0, 500]", "isovalues"),
        ("isovalues = [1, 2, 3]", "isovalues"),
        ("albedo = 1.5", "albedo"),
        ("albedo = [0.1, 0.2]", "albedo"),
        ("albedo = [0.1, 0.2, -0.1]", "albedo"),
        ('albedo = "grey"', "albedo"),
        ("bounces = -1", "bounces"),
        ("bounces = 1.5", "bounces"),
        ("bounces = true", "bounces"),
        ("bounces = 1001", "bounces"),
        ("[research]\norder = 0", "order"),
        ("[research]\norder = 99", "order"),
        ("[research]\nindirect_order = 0", "indirect_order"),
        ("[research]\nlobes = 5", "lobes"),
        ("[research]\nlobes = -1", "lobes"),
        ('[research]\nprecision = "double"', "precision"),
        ('[research]\nrepresentation = "radiosity"', "representation"),
        ('[research]\nrepresentation = "constant"', "representation"),
        ('[research]\nrepresentation = "irradiance"', "representation"),
        ('[research]\nnormals = "smooth"', "normals"),
        ("[research]\noffset = -0.1", "offset"),
        ("[research]\noffset = 3", "offset"),
        ("lattice = 0", "lattice"),
        ("lattice = 8", "lattice"),
        ("lattice = inf", "lattice"),
        ("[research]\nchunk = 4", "chunk"),
        ("[research]\nchunk = 24", "chunk"),
        ('[research]\nchunk = "16"', "chunk"),
        ("order = 3", r"sets order among its own keys: write it under \[research\]"),
        ("[research]\nordre = 3", r"sets ordre under \[research\]: did you mean 'order'"),
        ("research = 3", r"write a table \[research\]"),
        ("target_error = 0", "target_error"),
        ("target_error = 2", "target_error"),
        ("rotating = 1", "rotating"),
        ('projection = "fisheye"', "projection"),
        ("shine = 0.5", "shine"),
        ("[shine]\nkind = 'glass'", "cannot shine as 'glass': choose plastic or metal"),
        ("[shine]\nkind = 3", "The kind of shine is 3: give a word"),
        ("[shine]\nroughness = -0.1", "The roughness of shine is -0.1: it must be from 0.02 to 1"),
        ("[shine]\nroughness = 'low'", "The roughness of shine is 'low': give a number"),
        ("[shine]\nstrength = 2", "The strength of shine is 2: it must be from 0 to 1"),
        ("[shine]\ncolour = 1", "Shine has no 'colour': choose from kind, roughness, strength"),
        ("solid = 3", "solid"),
        ("spacing = [1, 1]", "spacing"),
        ('missing = "none"', "missing"),
        ("missing = [1, nan]", "missing"),
        ("missing = true", "missing"),
        (f"missing = {10**400}", "missing"),
        ("lights = []", "lights"),
        ("lights = 3", "lights"),
        ("isovlaue = 3", "isovlaue"),
        ("[light]\ntype = 'sky'", "light"),
        ("presets = 3", "presets"),
        ("presets = [70]", "presets"),
        ("presets = [{name = 'a'}]", "name and isovalue"),
        ("presets = [{name = 'a', isovalue = 3, colour = 1}]", "isovalue alone"),
        ("presets = [{name = '', isovalue = 3}]", "a word"),
        ("presets = [{name = 7, isovalue = 3}]", "a word"),
        (f"presets = [{{name = '{'a' * 41}', isovalue = 3}}]", "40"),
        ("presets = [{name = 'a', isovalue = 500}]", "'a' has isovalue 500"),
        ("presets = [{name = 'a', isovalue = true}]", "'a' has isovalue True"),
        ("presets = [{name = 'a', isovalue = 3}, {name = 'a', isovalue = 4}]", "same name"),
        (
            f"presets = [{', '.join(f'{{name = {str(i)!r}, isovalue = 3}}' for i in range(25))}]",
            "at most 24",
        ),
    ],
)
def test_settings_without_meaning_are_refused_by_name(folder: Path, line: str, word: str) -> None:
    with pytest.raises(SceneError, match=word):
        scene_of(folder, f'volume = "ramp.nrrd"\n{line}\n')


def test_a_misspelt_setting_is_answered_with_the_nearest(folder: Path) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(folder, 'volume = "ramp.nrrd"\nisovlaue = 3\n')
    assert str(caught.value).endswith(" sets isovlaue, unknown here: did you mean 'isovalue'?")


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ('lights = [{ type = "prob", file = "a.hdr" }]', "'prob': did you mean 'probe'?"),
        (
            'lights = [{ type = "sky", sun_azimut = 3 }]',
            "'sun_azimut': did you mean 'sun_azimuth'?",
        ),
        ("[shine]\nroughnes = 1", "'roughnes': did you mean 'roughness'?"),
    ],
)
def test_a_misspelt_word_of_a_table_is_answered_too(folder: Path, line: str, word: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(folder, f'volume = "ramp.nrrd"\n{line}\n')
    assert str(caught.value).endswith(word)


@pytest.mark.parametrize("key", FORMER)
def test_former_settings_are_refused_with_what_to_do(folder: Path, key: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(folder, f'volume = "ramp.nrrd"\n{key} = false\n')
    assert str(caught.value).endswith(f" sets {key}: {FORMER[key]}")


def test_former_settings_are_none_that_scenes_have(folder: Path) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(folder, 'volume = "ramp.nrrd"\nqqq = 3\n')
    known = str(caught.value).split("choose from ")[1].rstrip(".").split(", ")
    assert "lattice" in known and not {*known} & {*FORMER}


@pytest.mark.parametrize(
    ("text", "error", "word"),
    [
        ("isovalue = = 3", SceneError, "TOML"),
        ('volume = "demo:nothing"', VolumeError, "casting"),
        ('volume = "demo:casting"\nsolid = "below"', SceneError, "solid"),
        ('volume = "demo:casting"\nspacing = [1, 1, 2]', SceneError, "spacing"),
        ('volume = "demo:casting"\nmissing = 0', SceneError, "missing"),
        ('volume = "ramp.nrrd"\nsolid = "sideways"', VolumeError, "sideways"),
        ('volume = "ramp.nrrd"\nspacing = [1, 0, 1]', VolumeError, "spacing"),
        ('volume = "gone.nrrd"', VolumeError, "gone.nrrd"),
        ('volume = "ramp.nrrd"\n[[lights]]\ntype = "lamp"', SceneError, "lamp"),
        (
            f'volume = "ramp.nrrd"\n[[lights]]\ntype = "constant"\nradiance = {10**400}',
            SceneError,
            "radiance",
        ),
        (
            'volume = "ramp.nrrd"\n[[lights]]\ntype = "constant"\nradiance = -1',
            LightError,
            "radiance",
        ),
    ],
)
def test_a_kernel_that_cannot_be_built_says_why(
    folder: Path, text: str, error: type[IsogiError], word: str
) -> None:
    with pytest.raises(error, match=word):
        scene_of(folder, text)


def test_missing_and_unreadable_scenes_say_so(folder: Path) -> None:
    with pytest.raises(SceneError, match="Cannot read"):
        load_scene(folder / "gone.toml")
    (folder / "latin.toml").write_bytes(b'volume = "\xff"')
    with pytest.raises(SceneError, match="TOML"):
        load_scene(folder / "latin.toml")


def test_shine_changes_frames_and_not_bakes(folder: Path) -> None:
    plain, plastic, metal = (
        scene_of(folder, f'volume = "ramp.nrrd"\n{text}')
        for text in ("", "[shine]", "[shine]\nkind = 'metal'\nroughness = 1\nstrength = 0")
    )
    assert (plain.surfaces.shine, plastic.surfaces.shine, metal.surfaces.shine) == (
        None,
        Shine("plastic", 0.3, 1.0),
        Shine("metal", 1, 0),
    )
    assert plain.bake_digest == plastic.bake_digest == metal.bake_digest
    assert len({plain.digest, plastic.digest, metal.digest}) == 3
    assert metal.surfaces.shine_for(None) is None and metal.surfaces.shine_for(Shine()) == Shine()


def test_light_and_target_change_frames_and_not_bakes() -> None:
    same: dict[str, Any] = {"order": 3, "indirect_order": 2, "bounces": 4, "precision": "half"}
    plain = load_scene(ORBITAL, **same)
    for change in (
        {"lights": [{"type": "sky", "sun_elevation": 20.0}]},
        {"target_error": 0.3},
        {"lobes": 0},
    ):
        other = load_scene(ORBITAL, **same, **change)
        assert other.bake_digest == plain.bake_digest and other.digest != plain.digest
    assert load_scene(ORBITAL, isovalue=0.1, **same).digest == plain.digest


@pytest.mark.parametrize(
    ("change", "kinds"),
    [
        ({}, ["direct", "indirect"]),
        ({"albedo": 0.5}, ["direct"]),
        ({"albedo": [0.7, 0.7, 0.5]}, ["direct"]),
        ({"bounces": 2}, ["direct"]),
        ({"indirect_order": 3}, ["direct"]),
        ({"lights": [{"type": "sky", "sun_azimuth": 90.0}]}, ["direct", "indirect"]),
        ({"target_error": 0.018, "bounces": 5}, ["direct", "indirect"]),
        ({"precision": "single"}, []),
        ({"lattice": 0.5}, []),
        ({"order": 4, "indirect_order": 4}, ["indirect"]),
        ({"order": 3, "indirect_order": 3, "lobes": 0, "precision": "bytes"}, ["direct"]),
        ({"rotating": False}, []),
        ({"normals": "gradient"}, []),
        ({"offset": 0.0}, []),
        ({"chunk": 16}, ["direct", "indirect"]),
        ({"chunk": 8}, []),
        ({"chunk": 32, "offset": 0.0}, []),
        ({"normals": "bspline", "offset": 0.3}, ["direct", "indirect"]),
    ],
)
def test_a_layers_digest_holds_what_it_depends_on_alone(
    change: dict[str, Any], kinds: list[str]
) -> None:
    """Of the layers of the changed scene, those that the plain one has baked too."""
    plain = loaded.load_scene(ORBITAL, bounces=5)
    other = load_scene(ORBITAL, **{"bounces": 5, **change})
    known = {plain.layer_digest(layer) for layer in plain.plan.layers}
    assert [
        layer.kind for layer in other.plan.layers if other.layer_digest(layer) in known
    ] == kinds


@pytest.mark.parametrize("change", [{"survival": 1.0}, {"branches": 1}, {"branches": 2}], ids=str)
def test_the_digest_of_reflected_light_holds_what_paths_do(change: dict[str, Any]) -> None:
    plain = load_scene(ORBITAL)
    other = replace(plain, plan=replace(plain.plan, **change))
    direct, indirect = (
        plain.layer_digest(layer) == other.layer_digest(layer) for layer in plain.plan.layers
    )
    assert other.plan != plain.plan and direct and not indirect


def test_a_scene_may_settle_its_own_plan() -> None:
    plan = load_scene(
        ORBITAL,
        representation="transfer",
        order=4,
        indirect_order=2,
        precision="single",
        bounces=3,
        albedo=[0.5, 0.6, 0.7],
        lights=[{"type": "constant", "radiance": 1.0}],
    ).plan
    assert (plan.representation, plan.bounces) == ("transfer", 3)
    assert plan.layers == (Layer("direct", 4, half=False), Layer("indirect", 2, 3, half=False))


@pytest.mark.parametrize(("radiance", "exposure"), [(2.0, 0.5), (0.0, 1.0), ([1.0, 1.0, 1.0], 1.0)])
def test_default_exposure_shows_the_albedo(radiance: Any, exposure: float) -> None:
    scene = load_scene(ORBITAL, lights=[{"type": "constant", "radiance": radiance}])
    assert scene.default_exposure == pytest.approx(exposure)


def test_camera_goes_round_the_middle_of_the_box(folder: Path) -> None:
    scene = load_scene(folder / "ramp.nrrd")
    camera = scene.camera(90.0, 0.0, 2.0, 35.0)
    assert camera.target == scene.volume.centre == (1.5, 4.0, 1.25)
    radius = np.linalg.norm([3.0, 8.0, 2.5]) / 2
    np.testing.assert_allclose(camera.eye, (1.5, 4.0 + 2.0 * radius, 1.25), atol=1e-12)


def test_otsu_parts_two_heaps() -> None:
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(20, 3, 5000), rng.normal(80, 5, 1000)])
    assert 30 < otsu(*np.histogram(values, 256)) < 65


RADII = np.linalg.norm(np.mgrid[-8:8, -8:8, -8:8] + 0.5, axis=0)


@pytest.mark.parametrize(
    ("array", "middle"),
    [
        (np.where(RADII < 5, 255, 0).astype(np.uint8), 127.5),
        (RADII < 5, 0.5),
        ((RADII < 7).astype(np.float32), 0.5),
        (np.where(RADII < 5, 3, np.where(RADII < 6, 1, 0)).astype(np.uint8), 2.0),
        (np.where(RADII < 3, 3, np.where(RADII < 6, 1, 0)).astype(np.int16), 0.5),
        (np.where(RADII < 5, 500.0, -1000.0), -250.0),
        (np.where(RADII < 5, 1, 5).astype(np.uint8), 3.0),
    ],
)
def test_a_view_of_a_mask_starts_half_way(tmp_path: Path, array: np.ndarray, middle: float) -> None:
    np.save(tmp_path / "mask.npy", array)
    assert load_scene(tmp_path / "mask.npy").isovalue == middle


def test_a_view_of_few_whole_numbers_starts_between_two(tmp_path: Path) -> None:
    np.save(tmp_path / "few.npy", np.clip(20 - 2 * RADII, 0, 20).astype(np.uint8))
    assert load_scene(tmp_path / "few.npy").isovalue % 1.0 == 0.5


def test_a_view_of_values_without_gaps_starts_at_an_edge(tmp_path: Path) -> None:
    np.save(tmp_path / "smooth.npy", np.random.default_rng(1).random((16, 16, 16)))
    scene = load_scene(tmp_path / "smooth.npy")
    edges = scene.volume.histogram()[1]
    assert np.abs(edges - scene.isovalue).min() < 1e-9


@pytest.mark.parametrize(
    ("sign", "text", "solid"),
    [
        (1, "", "above"),
        (-1, "", "below"),
        (-1, 'solid = "above"', "above"),
        (1, 'solid = "below"', "below"),
    ],
)
def test_a_volume_inside_out_is_turned_out(
    tmp_path: Path, sign: int, text: str, solid: str
) -> None:
    """A ball in the middle: its values are high, or it is a field of distances from its centre."""
    z, y, x = np.mgrid[-6:7, -6:7, -6:7]
    np.save(tmp_path / "ball.npy", (sign * (6.0 - np.sqrt(x**2 + y**2 + z**2))).astype(np.float32))
    scene = scene_of(tmp_path, f'volume = "ball.npy"\nisovalue = {2.0 * sign}\n{text}')
    assert scene.solid == solid


def test_which_side_is_solid_may_follow_a_volumes_name(tmp_path: Path) -> None:
    np.save(tmp_path / "low.npy", np.arange(64.0, dtype=np.float32).reshape(4, 4, 4))
    assert [load_scene(f"{tmp_path / 'low.npy'}{told}").solid for told in ("", "#solid=below")] == [
        "above",
        "below",
    ]


@pytest.mark.parametrize("factor", [1e-310, 1e-200, 1e200, 1.7e308])
def test_otsu_does_not_depend_on_the_unit(factor: float) -> None:
    counts = np.array([9, 5, 1, 1, 7, 3])
    edges = np.linspace(-1.0, 1.0, 7)
    assert otsu(counts, edges * factor) == otsu(counts, edges) * factor


def test_otsu_of_one_value_is_within_its_range() -> None:
    counts = np.zeros(256, np.int64)
    counts[0] = 9
    edges = np.linspace(-0.5, 0.5, 257)
    assert edges[0] <= otsu(counts, edges) <= edges[-1]


CONSTANT = 'lights = [{ type = "constant" }]'
TRANSFER = "bounces = 4\n[research]\norder = 3\nindirect_order = 2\nlobes = 0"


@pytest.mark.parametrize(
    ("text", "digests"),
    [
        (CONSTANT, ["c0276eaf20ee6b8ce8e9", "48230b89d67009b5f2ca", "e1b25470f77e9c0f9953"]),
        (
            TRANSFER,
            [
                "9c645cbc7717d93629bd",
                "6a2aaaea9a060fa2da31",
                "8d0ebdacd1ad6e42618a",
                "415cb1074ff5c0c7df37",
                "fd44de9c9d9038395602",
            ],
        ),
        (
            f'{CONSTANT}\nrotating = false\n[research]\nrepresentation = "irradiance"',
            ["a90eed555ec728f9d392", "66637a13f768b0036b59", "bd91eda79aaa3bb678c7"],
        ),
        (
            f'{CONSTANT}\n[research]\nnormals = "gradient"\noffset = 0.5\nchunk = 8',
            ["77cafa47937588fd43c1", "cd684f5c70f7660cccba", "8455dbb5e99f92ddd242"],
        ),
    ],
)
def test_known_digests_of_layers(folder: Path, text: str, digests: list[str]) -> None:
    """Baked light is found by these names: where they change, all stores are baked anew. See
    BAKE_FORMAT.
    """
    scene = scene_of(folder, f'volume = "ramp.nrrd"\nalbedo = 0.7\n{text}')
    names = [
        scene.layer_digest(layer, shown) for layer in scene.plan.layers for shown in (None, 0.5)
    ]
    assert [*names, scene.bake_digest] == digests
