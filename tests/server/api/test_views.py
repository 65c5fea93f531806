"""The view that parameters make: its camera, on an orbit or at an eye."""

from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import ViewError
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from server.errors import ParameterError
from server.parameters import ViewParams, read
from server.views import camera_of


@pytest.fixture(scope="module")
def scene(small_scene: Path) -> Scene:
    return load_scene(small_scene)


def params(text: str) -> ViewParams:
    return read(ViewParams, (pair.split("=") for pair in text.split()))


def test_an_orbit_goes_round_its_target(scene: Scene) -> None:
    about = camera_of(scene, params("azimuth=110 elevation=-25 distance=2 target=3,4,5"))
    middle = camera_of(scene, params("azimuth=110 elevation=-25 distance=2"))
    assert about.target == (3.0, 4.0, 5.0) and middle.target == scene.volume.centre
    assert np.subtract(about.eye, about.target) == pytest.approx(np.subtract(middle.eye, middle.target))
    assert (about.up, about.fov) == (middle.up, middle.fov)
    assert np.linalg.norm(np.subtract(about.eye, about.target)) == pytest.approx(2.0 * scene.volume.radius)


def test_a_target_alone_is_looked_at_from_where_the_scene_starts(scene: Scene) -> None:
    alone = camera_of(scene, params("target=3,4,5"))
    assert alone == camera_of(scene, params("azimuth=30 elevation=20 distance=3.4 target=3,4,5"))


def test_an_orbit_may_be_rolled_by_its_up(scene: Scene) -> None:
    rolled, level = camera_of(scene, params("azimuth=0 up=0,1,0")), camera_of(scene, params("azimuth=0"))
    assert (rolled.eye, rolled.target, rolled.up) == (level.eye, level.target, (0.0, 1.0, 0.0))
    with pytest.raises(ViewError, match="along the view"):
        camera_of(scene, params("azimuth=90 elevation=0 up=0,1,0"))


def test_an_eye_looks_at_the_middle_with_z_up(scene: Scene) -> None:
    camera = camera_of(scene, params("eye=50,60,70"))
    assert (camera.eye, camera.target, camera.up) == ((50.0, 60.0, 70.0), scene.volume.centre, (0.0, 0.0, 1.0))
    assert camera_of(scene, params("eye=50,60,70 target=0,0,0")).target == (0.0, 0.0, 0.0)


def test_a_view_is_in_the_projection_that_it_or_its_scene_names(scene: Scene) -> None:
    flat = scene.with_settings(projection="orthographic")
    usual, parallel = camera_of(scene, params("azimuth=10")), camera_of(flat, params("azimuth=10"))
    assert parallel.fov < 1e-4 < usual.fov == 30.0
    assert camera_of(scene, params("azimuth=10 projection=orthographic")) == parallel
    assert camera_of(flat, params("azimuth=10 projection=perspective")) == usual
    assert camera_of(scene, params("azimuth=10 projection=perspective")) == usual
    with pytest.raises(ParameterError, match="projection"):
        params("projection=fisheye")
