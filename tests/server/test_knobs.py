"""The table of knobs, and what derives from it."""

import pytest

import isogi.client as isogi_client
from isogi_server.answers import defaults, ranges
from isogi_server.cli.arguments import FILM_OPTIONS, VIEW_OPTIONS
from isogi_server.knobs import KNOBS
from isogi_server.parameters import FrameParams, ViewParams
from tests.loaded import load_scene


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("fov", "Vertical field of view (0.01 to 179 degrees); default: 30."),
        ("width", "Width of the picture (1 to 16,383 pixels); default: 512."),
        ("roughness", "Roughness of that shine (0.02 to 1); default: the scene's."),
        (
            "antialias",
            (
                "Make pixels at edges the mean of 8 to 16 samples (on, off); default: on, "
                "off in npy."
            ),
        ),
        ("eye", "World x,y,z of the eye, instead of azimuth, elevation and distance."),
    ],
)
def test_help_has_the_range_the_unit_and_the_default(name: str, line: str) -> None:
    assert KNOBS[name].text == line
    assert FrameParams.model_fields[name].description == line
    assert VIEW_OPTIONS[name] == line


def test_an_option_that_moves_takes_a_range_too() -> None:
    assert FILM_OPTIONS["yaw"].endswith("; default: 0; or first:last.")
    assert FILM_OPTIONS["pitch"] == VIEW_OPTIONS["pitch"]


def test_all_of_a_frame_but_its_format_is_in_the_table() -> None:
    assert set(FrameParams.model_fields) - set(KNOBS) == {"f", "strip", "version"}
    assert set(KNOBS) <= set(FrameParams.model_fields)


def test_a_scene_has_the_knobs_that_change_it() -> None:
    plain = load_scene("demo:casting")
    shiny = load_scene("demo:casting", shine={"kind": "metal", "roughness": 0.4})
    assert not {"shine", "glow", "time"} & set(defaults(plain))
    assert defaults(shiny)["shine"] == "metal"
    assert defaults(shiny)["roughness"] == 0.4
    assert ranges(shiny)["time"].max == 0


def test_the_client_knows_what_is_of_a_picture_alone() -> None:
    """Waiting for light leaves these out: events of a view refuse them."""
    assert set(isogi_client.PICTURE_PARAMETERS) == set(FrameParams.model_fields) - set(
        ViewParams.model_fields
    )
