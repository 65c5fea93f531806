"""Series in time on the command line: steps that are prewarmed, and films that go through them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from isogi_server.cli.film_path import steps_in
from isogi_server.errors import ParameterError
from tests.loaded import load_scene
from tests.series import write_series
from tests.server.asking import Told

SIZE = ["--width", "24", "--height", "20"]


pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture
def series(tmp_path: Path) -> Path:
    return write_series(tmp_path)


def test_steps_are_named_as_isovalues_are(series: Path, small_scene: Path) -> None:
    scene = load_scene(series)
    for text, steps in (
        ("all", [0, 1, 2, 3]),
        ("2", [2]),
        ("1:3", [1, 2, 3]),
        ("0:3:2", [0, 2]),
        ("0:2:05", [0]),
    ):
        assert steps_in(text, scene) == steps
    beyond = r"has the steps 0 to 3"
    unread = r"all, a step, or first:last:step"
    for text, sentence in (
        ("0:4", beyond),
        ("3:1", beyond),
        ("0:3:0", unread),
        ("-1", unread),
        ("first", unread),
    ):
        with pytest.raises(ParameterError, match=sentence):
            steps_in(text, scene)
    with pytest.raises(ParameterError, match="is no series in time: leave times out"):
        steps_in("all", load_scene(small_scene))


def test_a_prewarm_of_all_steps_leaves_nothing_to_bake(series: Path, told: Told) -> None:
    prewarm = ["prewarm", series, "--store", series.parent / "light", "--views", "2", *SIZE]

    def lines(*more: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in told(*prewarm, *more, "--json").splitlines()]

    first = lines("--times", "all")
    assert [each["time"] for each in first] == [0, 1, 2, 3]
    assert all(each["stopped"] == "target" and each["paths"] > 0 for each in first)
    assert [each["paths"] for each in lines("--times", "all")] == [0, 0, 0, 0]
    series.write_text(series.read_text().replace("time=0", "time=2"))
    assert [(each["paths"], each["time"]) for each in lines()] == [(0, None)]
    steps = told(*prewarm, "--times", "1:2").splitlines()
    assert [line.partition(": 2 views")[0] for line in steps] == ["step 1", "step 2"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--server", "http://127.0.0.1:9"], "--times is only for work in this process"),
        (["--continue"], "--continue resumes the former order"),
        (["--isovalue", "0.9"], "Step 0 of the series: isovalue must be a number from 0.2 to 0.8"),
    ],
)
def test_what_times_does_not_go_with_is_refused(
    series: Path, told: Told, more: list[str], sentence: str
) -> None:
    store = series.parent / "light"
    assert sentence in told("prewarm", series, "--times", "all", "--store", store, *more, status=2)


def covers(folder: Path) -> list[np.ndarray]:
    """What each picture of a film without a ground covers: light that still converges does not
    change it.
    """
    found = []
    for path in sorted(folder.glob("*.png")):
        with Image.open(path) as opened:
            found.append(np.asarray(opened)[..., 3] > 0)
    return found


def widths(folder: Path) -> list[int]:
    """How wide what is seen is, in each picture of a film."""
    return [int(np.ptp(np.flatnonzero(cover.any(axis=0)))) for cover in covers(folder)]


def test_a_film_goes_through_the_steps_evenly(series: Path, tmp_path: Path, told: Told) -> None:
    """Two balls come apart: they are ever wider, each step as long as the others, and the camera
    stays.
    """
    options = [
        "--store",
        tmp_path / "light",
        "--length",
        "2",
        "--fps",
        "4",
        "--background",
        "transparent",
    ]
    options += ["--width", "60", "--height", "40", "--azimuth", "90", "--time", "1"]
    told("film", series, "-o", tmp_path / "film", "--times", "all", *options)
    found = widths(tmp_path / "film")
    assert found[::2] == found[1::2] and len(found) == 8
    assert found[0] < found[2] < found[4] < found[6]
    series.write_text(series.read_text().replace("time=0", "time=3"))
    told("film", series, "-o", tmp_path / "back", "--times", "0:3:3", *options)
    assert widths(tmp_path / "back")[::4] == [found[0], found[6]]


def test_a_film_moves_the_camera_meanwhile_if_it_is_told(
    series: Path, tmp_path: Path, told: Told
) -> None:
    options = ["--store", tmp_path / "light", "--length", "1", "--fps", "4", "--time", "1", *SIZE]
    for name, more in (("still", []), ("turn", ["--azimuth", "0:80"])):
        told(
            "film",
            series,
            "-o",
            tmp_path / name,
            "--times",
            "0:1",
            "--background",
            "transparent",
            *options,
            *more,
        )
    still, turn = (
        [cover.tobytes() for cover in covers(tmp_path / name)] for name in ("still", "turn")
    )
    assert still[0] == still[1] != still[2] == still[3]
    assert len(set(turn)) == 4
