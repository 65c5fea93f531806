"""Prewarming: which views it bakes for, and that these are final at once afterwards."""

import json
import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.model.plan import MOST
from isogi_core.model.scene import load_scene
from isogi_core.report.bake import ViewBake
from server.cli import run
from server.errors import ParameterError
from server.measure import make_renderer
from server.prewarm import directions, levels_in, levels_of, prewarm, sentence, views_of
from server.settings import Settings
from server.studio import Studio
from server.trial import seconds_each
from tests.server.inline import InlinePool, chunks_in, view_of
from worker import pool
from worker.errors import WorkersError

SIZE = {"width": "24", "height": "20"}


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)


def warmed(scene: Path, store: Path, *isovalues: str, **more: Any) -> dict[str, Any]:
    return prewarm(str(scene), isovalues, 3, SIZE, Settings(store=str(store), workers=1), **more)


def test_directions_are_spread_evenly() -> None:
    turns = np.radians(directions(200))
    points = np.stack([np.cos(turns[:, 1]) * f(turns[:, 0]) for f in (np.cos, np.sin)] + [np.sin(turns[:, 1])], axis=1)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(points.T @ points / 200, np.eye(3) / 3, atol=0.01)
    apart = np.arccos(np.clip(points @ points.T - 2 * np.eye(200), -1, 1)).min(axis=1)
    assert apart.min() > 0.7 * math.sqrt(4 * math.pi / 200)


@pytest.mark.parametrize(
    ("text", "levels"),
    [
        ("70", [70]),
        ("-0.5", [-0.5]),
        ("60:120:20", [60, 80, 100, 120]),
        ("0:1:0.3", [0, 0.3, 0.6, 0.9]),
        ("5:5:1", [5]),
    ],
)
def test_isovalues_are_numbers_or_ranges(text: str, levels: list[float]) -> None:
    assert levels_in(text) == pytest.approx(levels)


@pytest.mark.parametrize("text", ["", "a", "nan", "1:2", "1:2:0", "2:1:1", "1:2:-1", "1:2:3:4", "0:1:1e-9", "1:inf:1"])
def test_other_isovalues_are_refused(text: str) -> None:
    with pytest.raises(ParameterError, match=r"^isovalue must be a number such as 70, or first:last:step"):
        levels_in(text)


def test_each_isovalue_is_taken_once() -> None:
    assert levels_of(["70", "60:80:5", "0.6", "0:1:0.2"], 9)[:5] == [70, 60, 65, 75, 80]
    assert levels_of(["0.6", "0:1:0.2"], 9) == [0.6, 0, 0.2, 0.4, 0.8, 1]


def test_views_that_are_too_many_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"1,000 views of each of 1,001 isovalues are 1,001,000: ask for 100,000"):
        levels_of(["0:1000:1"], 1000)


def test_an_isovalue_outside_the_scene_is_wrong_use(small_scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["prewarm", str(small_scene), "--isovalue", "0.4:0.9:0.1"]) == 2
    assert "isovalue must be a number from 0.2 to 0.8" in capsys.readouterr().err


def test_what_was_prewarmed_is_final_at_once(small_scene: Path, tmp_path: Path) -> None:
    facts = warmed(small_scene, tmp_path, "0.4", "0.5:0.6:0.1")
    assert (facts["views"], facts["isovalues"]) == (9, pytest.approx([0.4, 0.5, 0.6]))
    assert (facts["final"], facts["stopped"], facts["target_error"]) == (1.0, "target", 0.5)
    assert facts["error"] <= 0.5 and facts["paths"] >= 64 * facts["texels"] > 0
    assert f"{facts['paths']:,} paths" in sentence(facts)
    scene, kept = load_scene(small_scene), chunks_in(tmp_path)
    assert 0 < facts["chunks"] <= len(kept)
    with closing(Studio([scene], str(tmp_path))) as studio:
        studio.start(hire=False)
        for view in views_of(scene, facts["isovalues"], 3, SIZE, Settings()):
            assert not studio.survey("small", view, 0.5).provisional
    assert warmed(small_scene, tmp_path, "0.5")["paths"] == 0
    assert chunks_in(tmp_path) == kept


def test_a_dry_run_bakes_nothing_and_tells_the_time(
    small_scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dry = warmed(small_scene, tmp_path, "0.5", dry=True)
    assert (dry["final"], dry["refined"], chunks_in(tmp_path)) == (0.0, 0, {})
    assert 0.0 < dry["time_left"]["low"] < dry["time_left"]["likely"] < dry["time_left"]["high"]
    assert "time with --workers 1: about" in sentence(dry)
    assert warmed(small_scene, tmp_path, "0.5")["texels"] == dry["texels"] > 0
    place = ["--store", str(tmp_path), "--width", "24", "--height", "20", "--views", "3"]
    assert run(["prewarm", str(small_scene), "--isovalue", "0.7", *place, "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert 0.0 < told["time_left"]["low"] < told["time_left"]["likely"] < told["time_left"]["high"]
    assert told["bytes"] == told["texels"] * load_scene(small_scene).plan.bytes_per_texel > 0
    assert told["refined"] > 0


def test_a_trial_foretells_what_a_bake_takes(tmp_path: Path) -> None:
    """To a factor of 5: a few texels stand for all, and other work slows both."""
    renderer = make_renderer(load_scene("demo:casting"), str(tmp_path))
    view = view_of(renderer.recipe.scene)
    demands = renderer.render(view, 0.1).demands
    told = seconds_each(renderer, demands, 0.1) * sum(len(demand.offsets) for demand in demands)
    whole = ViewBake(renderer, view)
    whole.grow(MOST, 0.1)
    renderer.tiles.close()
    assert whole.seconds / 5 < told < whole.seconds * 5
    assert seconds_each(renderer, (), 0.1) == 0.0


def test_it_ends_with_its_time(small_scene: Path, tmp_path: Path) -> None:
    facts = warmed(small_scene, tmp_path, "0.5", seconds=0.0)
    assert (facts["stopped"], facts["paths"], facts["final"]) == ("time", 0, 0.0)


def test_workers_that_fail_end_it(small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise WorkersError("No workers today.")

    monkeypatch.setattr(pool, "WorkerPool", refuse)
    with pytest.raises(WorkersError, match=r"^No workers today\.$"):
        warmed(small_scene, tmp_path, "0.5")
