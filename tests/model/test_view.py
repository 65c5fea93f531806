"""Views: cameras, orbits, turns of the light, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from isogi_core.errors import ViewError
from isogi_core.files.vector import Vector
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.view import (
    IDENTITY,
    Camera,
    Quaternion,
    Turn,
    View,
    angles_of,
    nearest_turn,
    orbit,
    quaternion_from_angles,
    rotation_matrix,
    unit_quaternion,
)

CAMERA = Camera((10.0, 0.0, 0.0), (0.0, 0.0, 0.0))
ANGLES = st.floats(-720.0, 720.0)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "direction"),
    [
        (0.0, 0.0, (1, 0, 0)),
        (90.0, 0.0, (0, 1, 0)),
        (180.0, 0.0, (-1, 0, 0)),
        (-90.0, 0.0, (0, -1, 0)),
        (0.0, 90.0, (0, 0, 1)),
        (123.0, -90.0, (0, 0, -1)),
        (90.0, 45.0, (0, math.sqrt(0.5), math.sqrt(0.5))),
    ],
)
def test_orbit_looks_from_where_the_angles_say(
    azimuth: float, elevation: float, direction: Vector
) -> None:
    camera = orbit((1.0, 2.0, 3.0), 10.0, azimuth, elevation, 2.5, 40.0)
    np.testing.assert_allclose(
        camera.eye, np.array([1, 2, 3]) + 25.0 * np.array(direction), atol=1e-9
    )
    assert camera.target == (1.0, 2.0, 3.0) and camera.fov == 40.0


@settings(deadline=None)
@given(ANGLES, st.floats(-90.0, 90.0))
def test_orbit_never_degenerates_and_keeps_z_up(azimuth: float, elevation: float) -> None:
    right, up, forward = orbit((0.0, 0.0, 0.0), 1.0, azimuth, elevation, 3.0, 30.0).basis()
    assert up[2] >= -1e-9, "up points up"
    assert abs(right[2]) < 1e-9, "the horizon is level"
    np.testing.assert_allclose(np.cross(right, forward), up, atol=1e-9)


@given(st.tuples(*[st.floats(-100, 100)] * 3), st.tuples(*[st.floats(-100, 100)] * 3))
def test_basis_is_orthonormal_and_right_handed(eye: Vector, up: Vector) -> None:
    try:
        camera = Camera(eye, (0.5, 0.25, 0.125), up)
    except ViewError:
        return
    right, lift, forward = camera.basis()
    frame = np.stack([right, forward, lift])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-6)
    assert lift @ np.array(up) > 0.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"target": (10.0, 0.0, 0.0)}, "same point"),
        ({"up": (0.0, 0.0, 0.0)}, "up"),
        ({"up": (-3.0, 0.0, 0.0)}, "up"),
        ({"fov": 0.0}, "fov"),
        ({"fov": 180.0}, "fov"),
        ({"fov": math.nan}, "finite"),
        ({"eye": (math.inf, 0.0, 0.0)}, "finite"),
        ({"up": (0.0, math.nan, 1.0)}, "finite"),
    ],
)
def test_cameras_without_meaning_are_refused(change: dict[str, object], word: str) -> None:
    with pytest.raises(ViewError, match=word):
        Camera(**{"eye": CAMERA.eye, "target": CAMERA.target, **change})  # type: ignore[arg-type]


@given(ANGLES, ANGLES, ANGLES)
def test_angles_are_intrinsic_yaw_pitch_roll(yaw: float, pitch: float, roll: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    np.testing.assert_allclose(
        rotation_matrix(quaternion_from_angles(yaw, pitch, roll)), expected, atol=1e-9
    )


@pytest.mark.parametrize(
    "quaternion", [(1, 0, 0, 0), (0, 1, 0, 0), (0.5, -0.5, 0.5, 0.5), (0.6, 0.0, 0.0, -0.8)]
)
def test_rotation_matrix_is_scipys(quaternion: Quaternion) -> None:
    expected = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation_matrix(quaternion), expected, atol=1e-15)


def test_quaternions_are_brought_to_unit_length() -> None:
    assert unit_quaternion((2.0, 0.0, 0.0, 0.0)) == IDENTITY
    assert math.hypot(*unit_quaternion((1.0, 2.0, 3.0, 4.0))) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("length", [0.0, 1e-4, 1e4, math.inf, math.nan])
def test_quaternions_of_no_length_are_refused(length: float) -> None:
    with pytest.raises(ViewError, match="quaternion"):
        unit_quaternion((length, 0.0, 0.0, 0.0))


@given(st.tuples(*[st.floats(-360.0, 360.0)] * 3))
def test_angles_of_a_turn_are_found_again(angles: tuple[float, float, float]) -> None:
    q = quaternion_from_angles(*angles)
    found = rotation_matrix(quaternion_from_angles(*angles_of(q)))
    np.testing.assert_allclose(found, rotation_matrix(q), atol=1e-4)


@given(st.tuples(*[st.integers(-72, 72)] * 3))
def test_a_turn_in_whole_steps_is_its_own_nearest(steps: tuple[int, int, int]) -> None:
    q = quaternion_from_angles(*(5.0 * each for each in steps))
    turn = nearest_turn(q)
    same = quaternion_from_angles(*turn)
    np.testing.assert_allclose(rotation_matrix(same), rotation_matrix(q), atol=1e-6)
    assert nearest_turn(same) == turn == nearest_turn(tuple(-each for each in same))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("angles", "turn"),
    [
        ((41.0, 2.0, -2.4), (40.0, 0.0, 0.0)),
        ((320.0, 0.0, 0.0), (-40.0, 0.0, 0.0)),
        ((-180.0, 0.0, 0.0), (180.0, 0.0, 0.0)),
        ((-1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((30.0, 89.0, 20.0), (10.0, 90.0, 0.0)),
        ((30.0, -89.0, 20.0), (50.0, -90.0, 0.0)),
    ],
)
def test_turns_are_rounded_to_steps(angles: Turn, turn: Turn) -> None:
    assert nearest_turn(quaternion_from_angles(*angles)) == turn


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"isovalue": math.nan}, "isovalue"),
        ({"isovalue": -math.inf}, "isovalue"),
        ({"width": 0}, "pixels"),
        ({"height": -3}, "pixels"),
        ({"shading": "toon"}, "toon"),
        ({"samples": 0}, "sample"),
    ],
)
def test_views_without_meaning_are_refused(change: dict[str, object], word: str) -> None:
    with pytest.raises(ViewError, match=word):
        View(**{"isovalue": 1.0, "camera": CAMERA, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize("shading", VIEW_SHADINGS)
def test_every_shading_makes_a_view_that_can_be_a_key(shading: str) -> None:
    view = View(70.0, CAMERA, shading=shading)
    assert {view: 1}[View(70.0, CAMERA, shading=shading)] == 1
