"""Series in time on the command line: steps that are prewarmed, and films that go through them."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from server.cli.command import run
from server.cli.film_path import steps_in
from server.errors import ParameterError
from tests.loaded import load_scene
from tests.series import write_series

SIZE = ["--width", "24", "--height", "20"]


pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture
def series(tmp_path: Path) -> Path:
    return write_series(tmp_path)


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_steps_are_named_as_isovalues_are(series: Path, small_scene: Path) -> None:
    scene = load_scene(series)
    for text, steps in (("all", [0, 1, 2, 3]), ("2", [2]), ("1:3", [1, 2, 3]), ("0:3:2", [0, 2]), ("0:2:05", [0])):
        assert steps_in(text, scene) == steps
    for text, sentence in (
        ("0:4", r"has the steps 0 to 3"),
        ("3:1", r"has the steps 0 to 3"),
        ("0:3:0", r"all, a step, or first:last:step"),
        ("-1", r"all, a step, or first:last:step"),
        ("first", r"all, a step, or first:last:step"),
    ):
        with pytest.raises(ParameterError, match=sentence):
            steps_in(text, scene)
    with pytest.raises(ParameterError, match="is no series in time: leave times out"):
        steps_in("all", load_scene(small_scene))


def test_a_prewarm_of_all_steps_leaves_nothing_to_bake(series: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--store", str(series.parent / "light"), "--views", "2", *SIZE]
    prewarm = ["prewarm", str(series), *options]
    assert run([*prewarm, "--times", "all", "--json"]) == 0
    first = lines(capsys)
    assert [each["time"] for each in first] == [0, 1, 2, 3]
    assert all(each["stopped"] == "target" and int(str(each["paths"])) > 0 for each in first)
    assert run([*prewarm, "--times", "all", "--json"]) == 0
    assert [each["paths"] for each in lines(capsys)] == [0, 0, 0, 0]
    series.write_text(series.read_text().replace("time=0", "time=2"))
    assert run([*prewarm, "--json"]) == 0
    assert [(each["paths"], each["time"]) for each in lines(capsys)] == [(0, None)]
    assert run([*prewarm, "--times", "1:2"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line.partition(": 2 views")[0] for line in told] == ["step 1", "step 2"]


def test_what_times_does_not_go_with_is_refused(series: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, sentence in (
        (["--server", "http://127.0.0.1:9"], "--times is for this process alone"),
        (["--continue"], "--continue goes on with what was asked for"),
        (["--isovalue", "0.9"], "Step 0 of the series: isovalue must be a number from 0.2 to 0.8"),
    ):
        assert run(["prewarm", str(series), "--times", "all", "--store", str(series.parent / "light"), *more]) == 2
        assert sentence in capsys.readouterr().err


def widths(folder: Path) -> list[int]:
    """How wide what is seen is, in each picture of a film without a ground."""
    found = []
    for path in sorted(folder.glob("*.png")):
        with Image.open(path) as opened:
            seen = np.flatnonzero((np.asarray(opened)[..., 3] > 0).any(axis=0))
        found.append(int(seen[-1] - seen[0]))
    return found


def test_a_film_goes_through_the_steps_evenly(series: Path, tmp_path: Path) -> None:
    """Two balls come apart: they are ever wider, each step as long as the others, and the camera stays."""
    options = ["--store", str(tmp_path / "light"), "--length", "2", "--fps", "4", "--background", "transparent"]
    options += ["--width", "60", "--height", "40", "--azimuth", "90", "--time", "1"]
    assert run(["film", str(series), "-o", str(tmp_path / "film"), "--times", "all", *options]) == 0
    found = widths(tmp_path / "film")
    assert found[::2] == found[1::2] and len(found) == 8
    assert found[0] < found[2] < found[4] < found[6]
    series.write_text(series.read_text().replace("time=0", "time=3"))
    assert run(["film", str(series), "-o", str(tmp_path / "back"), "--times", "0:3:3", *options]) == 0
    assert widths(tmp_path / "back")[::4] == [found[0], found[6]]


def outlines(folder: Path) -> list[bytes]:
    """What each picture of a film without a ground covers: light that still converges does not change it."""
    found = []
    for path in sorted(folder.glob("*.png")):
        with Image.open(path) as opened:
            found.append((np.asarray(opened)[..., 3] > 0).tobytes())
    return found


def test_a_film_moves_the_camera_meanwhile_if_it_is_told(series: Path, tmp_path: Path) -> None:
    options = ["--store", str(tmp_path / "light"), "--length", "1", "--fps", "4", "--time", "1", *SIZE]
    options += ["--background", "transparent"]
    for name, more in (("still", []), ("turn", ["--azimuth", "0:80"])):
        assert run(["film", str(series), "-o", str(tmp_path / name), "--times", "0:1", *options, *more]) == 0
    still = outlines(tmp_path / "still")
    assert still[0] == still[1] != still[2] == still[3]
    assert len(set(outlines(tmp_path / "turn"))) == 4
