"""What can be asked of a prewarm, and what cannot."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import ViewError
from isogi_core.plan.assembly import load_scene
from isogi_server.cli.prewarm import fields_given
from isogi_server.errors import ParameterError
from isogi_server.prewarm.order import (
    PrewarmOrder,
    PrewarmRequest,
    Views,
    all_sides,
    levels_of,
    orbit,
    order_of,
)
from isogi_server.settings import Settings


def test_directions_are_spread_evenly() -> None:
    turns = np.radians(all_sides(200))
    points = np.stack(
        [np.cos(turns[:, 1]) * f(turns[:, 0]) for f in (np.cos, np.sin)] + [np.sin(turns[:, 1])],
        axis=1,
    )
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(points.T @ points / 200, np.eye(3) / 3, atol=0.01)
    apart = np.arccos(np.clip(points @ points.T - 2 * np.eye(200), -1, 1)).min(axis=1)
    assert apart.min() > 0.7 * math.sqrt(4 * math.pi / 200)
    assert orbit(4, 20.0) == [(0.0, 20.0), (90.0, 20.0), (180.0, 20.0), (270.0, 20.0)]


@pytest.mark.parametrize(
    ("text", "single"),
    [
        *[("70", [70]), ("-0.5", [-0.5]), ("5:5:1", [5])],
        *[("60:120:20", [60, 80, 100, 120]), ("0:1:0.3", [0, 0.3, 0.6, 0.9])],
    ],
)
def test_isovalues_are_numbers_or_ranges_with_a_step(text: str, single: list[float]) -> None:
    found = levels_of([text])
    assert found.single == pytest.approx(single)
    assert found.ranges == ()


def test_a_range_without_a_step_is_all_between() -> None:
    found = levels_of(["60:120", "70", "60:120"])
    assert (found.single, found.ranges) == ((70.0,), ((60.0, 120.0),))
    assert set(found.spans) == {(70.0, 70.0), (60.0, 120.0)}


def test_so_many_levels_of_the_scenes_range(blocks: Path) -> None:
    scene = load_scene(blocks)
    assert order_of({"isovalues": ["adaptive:20"]}).isovalues_of(scene).single == scene.stops.levels
    order = order_of({"isovalues": ["uniform:4", "adaptive:6", "0.5"]})
    levels = order.isovalues_of(scene).single
    (low, high) = scene.isovalues
    assert len(levels) == 11
    assert all(low < level < high for level in levels)
    assert levels[1:5] == pytest.approx(
        [low + (high - low) * share for share in (0.125, 0.375, 0.625, 0.875)]
    )
    assert levels[5:] == tuple(sorted(levels[5:]))


@pytest.mark.parametrize(
    "text",
    [
        *("", "a", "nan", "2:1", "1:2:0", "2:1:1", "1:2:-1", "1:2:3:4", "0:1:1e-9", "1:inf:1"),
        *("adaptive", "adaptive:", "uniform:0", "adaptive:1.5", "uniform:10001", "adaptive:2:3"),
    ],
)
def test_other_isovalues_are_refused(text: str) -> None:
    with pytest.raises(
        ParameterError, match=r"^isovalue must be a number such as 70, .* adaptive:20 or uniform:20"
    ):
        levels_of([text])


def test_each_isovalue_is_taken_once_and_not_too_many_together() -> None:
    assert levels_of(["70", "60:80:5", "0.6", "0:1:0.2"]).single[:5] == (70, 60, 65, 75, 80)
    assert levels_of(["0.6", "0:1:0.2"]).single == (0.6, 0, 0.2, 0.4, 0.8, 1)
    with pytest.raises(ParameterError, match="isovalues are more than 10,000 together"):
        levels_of(["0:1:0.0002", "2:3:0.00012"])


def test_directions_of_all_kinds_add_up_and_are_taken_once(blocks: Path) -> None:
    told = {
        "isovalues": [0.4, "0.5:0.6:0.1"],
        "views": 3,
        "orbits": [{"count": 4}],
        "directions": [{"azimuth": 90}],
    }
    order = order_of(told)
    scene = load_scene(blocks)
    views = list(Views(order, scene, Settings()))
    assert len(views) == 3 * 7
    assert {view.isovalue for view in views} == {0.4, 0.5, 0.6}
    assert len(list(Views(order_of({"directions": [{"azimuth": 90}]}), scene, Settings()))) == 1
    assert len(Views(PrewarmOrder(), scene, Settings())) == 12


@pytest.mark.parametrize(
    ("told", "why"),
    [
        (
            {"isovalues": ["0.4:0.5"]},
            "isovalues 0.4:0.5 means every isovalue between, which takes all_directions",
        ),
        ({"all_directions": True, "views": 3}, "all_directions leaves nothing to views"),
        ({"views": 0}, "views must be a whole number from 1 to 10000, not '0'."),
        *[({"views": views}, "views must be a whole number") for views in (1.5, math.nan, True)],
        ({"isovalues": 5}, "isovalues Input should be a valid tuple."),
        ({"isovalues": [[1]]}, "isovalue must be a number such as 70"),
        ({"isovalues": ["1"] * 1001}, "isovalues Tuple should have at most 1000 items"),
        (
            {"directions": [{"azimuth": 1000}]},
            "directions.0.azimuth must be a number from -360 to 360, not '1000'.",
        ),
        ({"directions": [{}]}, "directions.0.azimuth is missing: give it."),
        ({"orbits": [{"count": 2, "at": 3}]}, "orbits.0.at"),
        ({"all_directions": "yes"}, "all_directions Input should be a valid boolean."),
        ({"deadline": -1}, "deadline must be a number from 0"),
        ({"width": 1 << 20}, "width must be a whole number from 1 to 16383"),
        ({"target_error": 0}, "target_error must be a number from 0.0001 to 1"),
        ({"paint": 1}, "There is no parameter 'paint' here"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(told: dict[str, Any], why: str) -> None:
    with pytest.raises(ParameterError) as caught:
        order_of(told)
    assert why in str(caught.value)
    assert str(caught.value).endswith(".")


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"isovalues": ["0.4:0.9:0.1"]}, "isovalue must be a number from 0.2 to 0.8"),
        (
            {"isovalues": ["0.2:0.9"], "all_directions": True},
            "isovalue must be a number from 0.2 to 0.8",
        ),
        ({"isovalues": ["0.2:0.8:0.0001"], "views": 1000}, "ask for 100,000 views at most."),
        ({"width": 16000, "height": 16000}, "width × height must be at most"),
    ],
)
def test_what_a_scene_does_not_allow_is_refused(
    blocks: Path, told: dict[str, Any], why: str
) -> None:
    order = order_of(told)
    scene = load_scene(blocks)
    with pytest.raises(ViewError, match=why):
        order.isovalues_of(scene)
        Views(order, scene, Settings())


def test_the_name_of_an_order_is_that_of_its_light(blocks: Path) -> None:
    scene = load_scene(blocks)
    name = order_of({"views": 3}).digest(scene)
    assert order_of({"views": 3, "deadline": 60}).digest(scene) == name
    assert PrewarmRequest(views=3, dry_run=True).order.digest(scene) == name
    assert order_of({"views": 4}).digest(scene) != name
    assert order_of({"views": 3}).digest(load_scene(blocks, albedo=0.3)) != name


def test_options_tell_the_same_order(tmp_path: Path) -> None:
    (tmp_path / "views.toml").write_text("[[directions]]\nazimuth = 5\nelevation = 6\n")
    (tmp_path / "views.json").write_text('[{"azimuth": 5, "elevation": 6}]')
    given = {
        "isovalues": ("0.5",),
        "directions": ("azimuth=40,elevation=30",),
        "orbits": ("36@20", "8"),
        "views": None,
    }
    order = order_of(fields_given(given | {"views_file": tmp_path / "views.toml"}))
    assert [(each.azimuth, each.elevation) for each in order.directions] == [(40, 30), (5, 6)]
    assert [(each.count, each.elevation) for each in order.orbits] == [(36, 20), (8, 0)]
    assert (
        order_of(fields_given({"views_file": tmp_path / "views.json"})).directions
        == order.directions[1:]
    )


@pytest.mark.parametrize(
    "given",
    [
        *[
            {"directions": (text,)}
            for text in ("40,30", "azimuth=40;elevation=30", "azimuth=40,azimut=30")
        ],
        *[{"orbits": (text,)} for text in ("x@20", "36@", "36@200")],
    ],
)
def test_directions_that_are_misspelt_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        order_of(fields_given(given))


@pytest.mark.parametrize(
    ("name", "text"), [("a.json", "{"), ("a.toml", "="), ("a.json", "3"), ("a.json", "[]")]
)
def test_a_file_without_directions_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterError, match=name):
        fields_given({"views_file": tmp_path / name})
