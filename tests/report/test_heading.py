"""What a report says of its view."""

import math

import pytest

from isogi_core.model.view import Camera, orbit, orthographic
from isogi_report.heading import standpoint

RADIUS = 20.0


@pytest.fixture
def camera() -> Camera:
    return orbit((10.0, 10.0, 10.0), RADIUS, 90.0, 0.0, 3.0, 30.0)


def test_a_camera_in_perspective_says_where_it_stands(camera: Camera) -> None:
    assert standpoint(camera) == "from 10, 70, 10, 30 degrees high"


def test_an_orthographic_camera_says_where_it_looks(camera: Camera) -> None:
    """Its eye, ten million radii away, is of no use to a person."""
    height = 2.0 * 60.0 * math.tan(math.radians(15.0))
    told = standpoint(orthographic(camera, RADIUS))
    assert told.startswith("orthographic, along ") and told.endswith(f" to 10, 10, 10, {height:.4g} high there")
    assert "-1," in told
