"""The first view that a scene names."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.model.first_view import VIEW_READERS, FirstView
from isogi_core.plan.variants import under
from isogi_server.answers import scene_schema
from isogi_server.knobs import KNOBS
from isogi_server.parameters import FrameParams, read
from isogi_server.settings import Settings
from isogi_server.values import Span
from isogi_server.views import view_of, with_first_view
from tests.loaded import load_scene


def scene_of(tmp_path: Path, view: str) -> Any:
    """A scene file with a table [view]."""
    np.save(tmp_path / "v.npy", np.random.default_rng(2).random((9, 8, 7)).astype(np.float32))
    (tmp_path / "s.toml").write_text(f'volume = "v.npy"\nisovalue = 0.5\n[view]\n{view}\n')
    return load_scene(tmp_path / "s.toml")


def test_a_scene_is_seen_at_first_as_it_says(tmp_path: Path) -> None:
    plain = scene_of(tmp_path, "")
    scene = scene_of(
        tmp_path, 'azimuth = 35\ntarget = [1, 2, 3]\nexposure = 6\nbackground = "dark"'
    )
    assert scene.front == (35.0, plain.front[1])
    assert scene.default_exposure == 6.0 != plain.default_exposure
    assert scene.bake_digest == plain.bake_digest, "light does not depend on it"
    knobs = with_first_view(scene, {"width": "40"})
    params = read(FrameParams, knobs.items())
    assert (params.azimuth, params.target, params.background) == (35.0, (1.0, 2.0, 3.0), "dark")
    assert scene_schema(scene).view == scene.settings.first.given
    assert scene_schema(scene).defaults["exposure"] == 6.0
    assert plain.settings.first == FirstView() and not plain.settings.first.placed


@pytest.mark.parametrize(
    ("knobs", "left"),
    [
        ({"azimuth": "10"}, {"distance", "target", "fov", "yaw"}),
        ({"distance": "2"}, {"azimuth", "fov", "yaw"}),
        ({"eye": "9,9,9"}, {"fov", "yaw"}),
        ({"light": "1,0,0,0"}, {"azimuth", "distance", "target", "fov"}),
    ],
)
def test_what_is_given_goes_before_the_first_view(
    tmp_path: Path, knobs: dict[str, str], left: set[str]
) -> None:
    """A distance that is given is from the volume's centre, and not from the scene's target."""
    scene = scene_of(tmp_path, "azimuth = 35\ndistance = 4\ntarget = [1, 2, 3]\nfov = 40\nyaw = 20")
    filled = with_first_view(scene, knobs)
    assert filled.keys() == knobs.keys() | left
    assert {name: filled[name] for name in knobs} == knobs
    assert read(FrameParams, filled.items())


def test_the_exposure_is_for_the_scenes_own_light(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "exposure = 6\nazimuth = 35")
    other = under(scene, "gallery", "other")
    assert other.default_exposure != 6.0 and other.front[0] == 35.0


@pytest.mark.parametrize(
    "view",
    ["azimut = 3", "distance = 0", 'fov = "wide"', "target = [1, 2]", 'background = "blue"'],
)
def test_a_view_without_a_meaning_is_refused(tmp_path: Path, view: str) -> None:
    with pytest.raises(SceneError, match="view"):
        scene_of(tmp_path, view)


def test_its_numbers_are_those_of_parameters() -> None:
    """Both ends of each range are taken, and what is beyond is refused, as parameters have it."""
    for name, reader in VIEW_READERS.items():
        kind = KNOBS[name].kind
        if not isinstance(kind, Span):
            continue
        assert [reader(name, end) for end in (kind.low, kind.high)] == [kind.low, kind.high]
        for beyond in (kind.low - abs(kind.low) - 1.0, 2.0 * kind.high):
            with pytest.raises(SceneError):
                reader(name, beyond)


def test_the_view_is_that_of_the_options(tmp_path: Path) -> None:
    """What a scene says, and the same options of a scene that says nothing, are one view."""
    scene = scene_of(tmp_path, "azimuth = 35\ndistance = 4\nfov = 40")
    plain = scene_of(tmp_path, "")
    views = [
        view_of(which, read(FrameParams, with_first_view(which, knobs).items()), Settings())
        for which, knobs in (
            (scene, {}),
            (plain, {"azimuth": "35", "distance": "4", "fov": "40"}),
        )
    ]
    assert views[0] == views[1]
