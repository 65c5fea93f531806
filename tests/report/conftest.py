"""Benches of small views of the orbital."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from isogi_core.model.view import View
from isogi_report.bench import Bench
from tests.loaded import load_scene

SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
CONSTANT = {"type": "constant", "radiance": 1.0}
MakeBench = Callable[..., Bench]


@pytest.fixture(scope="session")
def make_bench(tmp_path_factory: pytest.TempPathFactory) -> MakeBench:
    """Make a bench of the orbital under a sky, or as settings say, in a picture of 16 × 16
    pixels.
    """

    def make(size: int = 16, **settings: Any) -> Bench:
        given = {"lights": [SKY], "bounces": 2, "target_error": 0.1, **settings}
        scene = load_scene("demo:orbital", **given)
        view = View(scene.isovalue, scene.camera(40.0, 30.0, 3.0, 30.0), width=size, height=size)
        return Bench(scene, view, Path(tmp_path_factory.mktemp("bench")))

    return make


@pytest.fixture(scope="session")
def under_sky(make_bench: MakeBench) -> Bench:
    """The bench of the orbital under a sky, whose light and references tests share."""
    return make_bench()
