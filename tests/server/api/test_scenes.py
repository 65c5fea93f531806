"""The list of scenes and one scene's document, over a real socket."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.variants import under
from isogi_server.answers import scene_schema
from tests.server.asking import numbers


@pytest.fixture(scope="module")
def scene(live_server: str) -> dict[str, object]:
    document: dict[str, object] = (
        httpx.get(f"{live_server}/v1/scenes/small").raise_for_status().json()
    )
    return document


def test_the_list(live_server: str) -> None:
    only = {"id": "small", "name": "small", "href": "/v1/scenes/small", "volume": None}
    assert httpx.get(f"{live_server}/v1/scenes").json() == {"scenes": [only], "uploads": None}


def test_the_volume(scene: dict[str, dict[str, object]]) -> None:
    facts = {"size": [24, 20, 16], "spacing": [1, 1, 1], "dtype": "float32", "holes": 0}
    assert scene["volume"] | facts == scene["volume"]


def test_the_histogram_counts_every_voxel(scene: dict[str, dict[str, list[float]]]) -> None:
    counts = scene["histogram"]["counts"]
    edges = scene["histogram"]["edges"]
    assert sum(counts) == 24 * 20 * 16
    assert len(edges) == len(counts) + 1
    assert [edges[0], edges[-1]] == pytest.approx(scene["volume"]["value_range"])


def test_defaults_are_in_their_ranges_and_make_a_frame(
    live_server: str, scene: dict[str, dict[str, object]]
) -> None:
    defaults = scene["defaults"]
    ranges = scene["ranges"]
    assert ranges["isovalue"] == {"min": 0.2, "max": 0.8}
    for name in ranges.keys() & defaults.keys():
        assert ranges[name]["min"] <= defaults[name] <= ranges[name]["max"]  # type: ignore[index]
    small = {**defaults, "width": 8, "height": 8}
    assert httpx.get(f"{live_server}/v1/scenes/small/frame", params=small).status_code == 200


@pytest.mark.parametrize(("width", "height"), [(48, 48), (80, 40), (30, 60)])
def test_the_fit_shows_the_surface_whole_and_large(
    live_server: str, width: int, height: int
) -> None:
    size = {"width": width, "height": height}
    camera = httpx.get(f"{live_server}/v1/scenes/small/fit", params=size).json()
    assert camera["elevation"] > 10 and camera["azimuth"] % 90 > 10, "from three quarters"
    target = ",".join(map(str, camera.pop("target")))
    view = {**camera, **size, "target": target, "shading": "lambert", "f": "npy"}
    largest = 0.0
    for turn in range(0, 360, 30):
        turned = {**view, "azimuth": (view["azimuth"] + turn + 180) % 360 - 180}
        frame = numbers(httpx.get(f"{live_server}/v1/scenes/small/frame", params=turned))
        rows, columns = np.nonzero(frame[..., 3])
        largest = max(largest, (np.ptp(rows) + 1) / height, (np.ptp(columns) + 1) / width)
        assert rows.min() > 0 and rows.max() < height - 1
        assert columns.min() > 0 and columns.max() < width - 1
    assert 0.75 < largest < 1.0


def test_the_fit_of_a_surface_from_above(live_server: str) -> None:
    camera = httpx.get(
        f"{live_server}/v1/scenes/small/fit", params={"isovalue": 0.6, "elevation": 90}
    ).json()
    assert camera["elevation"] == 90
    assert (
        httpx.get(f"{live_server}/v1/scenes/small/fit", params={"isovalue": 9}).status_code == 422
    )


def test_a_volume_that_is_turned_out_is_told(tmp_path: Path) -> None:
    bowl = np.ones((9, 9, 9), np.float32)
    bowl[3:6, 3:6, 3:6] = 0.0
    np.save(tmp_path / "bowl.npy", bowl)
    for given, notes in ({}, 1), ({"solid": "below"}, 0):
        facts = scene_schema(load_scene(tmp_path / "bowl.npy", isovalue=0.5, **given))
        assert facts.solid == "below"
        assert sum("border" in note for note in facts.plan.notes) == notes


def test_what_the_scene_says_of_itself(scene: dict[str, object]) -> None:
    assert scene["shadings"] == list(VIEW_SHADINGS)
    assert [light["type"] for light in scene["lights"]] == ["constant", "sky"]  # type: ignore[attr-defined]
    assert (scene["albedo"], scene["bounces"], scene["solid"]) == ([0.7, 0.7, 0.7], 1, "above")
    assert (scene["target_error"], scene["rotating"], scene["turns"]) == (0.5, True, True)
    scale = scene["error_scale"]
    assert (scale["low"], scale["high"], scale["colours"][0]) == (0.001, 1.0, "#440154")  # type: ignore[index]


def test_presets_come_from_the_scene_or_are_suggested_in_range(
    small_scene: Path, scene: dict[str, list[dict[str, Any]]]
) -> None:
    own = load_scene(small_scene)
    assert scene["presets"] == [asdict(preset) for preset in own.presets]
    assert all(each["suggested"] and 0.2 <= each["isovalue"] <= 0.8 for each in scene["presets"])
    told = scene_schema(
        load_scene(small_scene, presets=[{"name": "shell", "isovalue": 0.3}])
    ).presets
    assert [each.model_dump() for each in told] == [
        {"name": "shell", "isovalue": 0.3, "suggested": False}
    ]


def test_stops_ascend_in_the_range(scene: dict[str, list[float]]) -> None:
    stops = scene["stops"]
    assert len(stops) == 20, "as docs/http-numbers.md says"
    assert np.diff([0.2, *stops, 0.8]).min() > 0.0


@pytest.fixture
def balls(tmp_path: Path) -> Path:
    """A volume whose isosurfaces are balls: their radii are square roots of the isovalues."""
    axis = np.linspace(-32.0, 32.0, 49)
    np.save(tmp_path / "balls.npy", sum(np.meshgrid(axis**2, axis**2, axis**2)).astype(np.float32))
    return tmp_path / "balls.npy"


def test_stops_are_surfaces_that_are_evenly_spaced(balls: Path) -> None:
    facts = scene_schema(load_scene(balls, isovalues=[100, 900], isovalue=400))
    steps = np.diff(np.sqrt(facts.stops))
    even = np.diff(np.sqrt(np.linspace(120, 880, len(facts.stops))))
    assert steps.std() / steps.mean() < 0.25 < even.std() / even.mean()
    assert facts.stops_note == ""


def test_stops_say_where_they_are_even(balls: Path) -> None:
    np.save(
        balls,
        np.load(balls)
        + np.random.default_rng(1).normal(0.0, 400.0, (49, 49, 49)).astype(np.float32),
    )
    facts = scene_schema(load_scene(balls, isovalues=[100, 900], isovalue=400))
    assert "levels are even there" in facts.stops_note
    assert np.diff(facts.stops) == pytest.approx(40.0, rel=0.3)


def test_a_scene_keeps_its_stops_in_another_light(balls: Path) -> None:
    scene = load_scene(balls)
    stops = scene.stops
    assert under(scene, "studio", "lit").stops is stops
    assert replace(scene, plan=scene.plan).stops is stops


@pytest.mark.parametrize(
    ("light", "rotating", "turns"),
    [
        ("constant", True, False),
        ("constant", False, False),
        ("sky", True, True),
        ("sky", False, False),
    ],
)
def test_turning_shows_where_the_light_may_turn_and_has_sides(
    light: str, rotating: bool, turns: bool
) -> None:
    facts = scene_schema(load_scene("demo:orbital", lights=[{"type": light}], rotating=rotating))
    assert (facts.rotating, facts.turns) == (rotating, turns)
    assert turns != ("turning of the light" in {each.what for each in facts.plan.left_out})


def test_the_plan_is_that_of_the_scene(scene: dict[str, Any], small_scene: Path) -> None:
    """Every number of the document, beside the plan that the scene itself makes."""
    plan = scene["plan"]
    own = load_scene(small_scene)
    names = (
        "representation",
        "order",
        "indirect_order",
        "channels",
        "bounces",
        "branches",
        "precision",
        "samples",
    )
    for name in names:
        assert plan[name] == getattr(own.plan, name)
    assert (
        plan["bytes_per_texel"] == sum(layer["bytes_per_texel"] for layer in plan["layers"]) < 300
    )
    assert plan["full_bytes_per_texel"] == 300
    assert [layer["kind"] for layer in plan["layers"]] == [layer.kind for layer in own.plan.layers]
    assert plan["errors"] == dict(own.plan.errors) and plan["notes"] == list(own.plan.notes)
    assert [lobe["angle"] for lobe in plan["lobes"]] == [
        lobe.angle for lobe in own.inputs.lobes[: own.plan.lobes]
    ]
    assert plan["texels"] == asdict(own.texels)
    assert 0 < plan["texels"]["shown"] <= plan["texels"]["total"] == 13 * 11 * 9


def test_the_plan_tells_where_lobes_stand() -> None:
    sky = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
    (sun,) = scene_schema(load_scene("demo:orbital", lights=[sky])).plan.lobes
    assert (sun.azimuth, sun.elevation) == (
        pytest.approx(30.0, abs=0.5),
        pytest.approx(50.0, abs=0.5),
    )
    assert 0.2 < sun.angle < 1.5 and min(sun.irradiance) > 0.0
    assert scene_schema(load_scene("demo:orbital", lights=[sky], lobes=0)).plan.lobes == []


def test_the_plan_says_what_is_left_out_why_and_what_that_saves(
    small_scene: Path, scene: dict[str, Any]
) -> None:
    left_out = scene["plan"]["left_out"]
    assert left_out == json.loads(
        json.dumps([asdict(each) for each in load_scene(small_scene).left_out])
    )
    assert len({each["what"] for each in left_out}) == len(left_out) > 5
    for saved in (saved for each in left_out for saved in each["saves"]):
        assert saved["amount"] > 0 and saved["unit"] and saved["measured"] in (True, False)


def test_a_scene_of_one_isovalue_is_a_scene_with_fewer_texels(
    small_scene: Path, scene: dict[str, Any]
) -> None:
    one = scene_schema(load_scene(small_scene, isovalues=[0.5, 0.5]))
    assert (one.ranges["isovalue"].min, one.ranges["isovalue"].max, one.defaults["isovalue"]) == (
        0.5,
        0.5,
        0.5,
    )
    assert one.stops == []
    assert 0 < one.plan.texels.shown < scene["plan"]["texels"]["shown"]


def test_unknown_parameters_are_refused(live_server: str) -> None:
    for path in ("/v1/scenes", "/v1/scenes/small"):
        assert httpx.get(f"{live_server}{path}?verbose=1").status_code == 422
