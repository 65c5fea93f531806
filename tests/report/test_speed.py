"""``isogi bench``: the figures it promises, and what it leaves alone."""

import json
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.speed import (
    bounce,
    cast,
    isovalues_near,
    primary_rays,
    table,
    take_turns,
)
from isogi_server.cli.command import run

NUMBERS = {
    "relight_ms",
    "isovalue_ms",
    "primary_mrays_per_core",
    "diffuse_mrays_per_core",
    "bake_mpaths_per_core",
    "bake_texels_per_s",
    "peak_mb",
}
SMALL = ["--size", "32", "--repeats", "1"]


def measured(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert run(["bench", *map(str, arguments), *SMALL, "--json"]) == 0
    out, error = capsys.readouterr()
    assert "measuring" in error
    figures: dict[str, Any] = json.loads(out)
    return figures


def test_the_figures_are_there_and_make_sense(
    capsys: pytest.CaptureFixture[str], small_scene: Path
) -> None:
    figures = measured(capsys, small_scene)
    assert set(figures["frame_ms"]) == {*VIEW_SHADINGS} - {"path_traced"}
    assert set(figures["encode_ms"]) == {"png", "jpeg", "webp"}
    numbers = [figures[name] for name in NUMBERS]
    every = np.array(
        list(chain(numbers, figures["frame_ms"].values(), figures["encode_ms"].values()))
    )
    assert np.isfinite(every).all()
    assert (every > 0).all()
    assert (figures["scene"], figures["isovalue"], figures["size"]) == ("small", 0.5, 32)
    assert (figures["bounces"], figures["survival"]) == (1, 1.0)


def test_it_takes_an_isovalue_and_leaves_the_store_alone(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    small_scene: Path,
    tmp_path: Path,
) -> None:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    assert measured(capsys, small_scene, "--isovalue", 0.6)["isovalue"] == 0.6
    assert [path.name for path in tmp_path.rglob("*")] == ["tmp"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["none.toml"], "none.toml"),
        (["--isovalue", "nan"], "isovalue"),
        (["--isovalue", "900"], "isovalue"),
        (["--size", "0"], "size"),
        (["--repeats", "0"], "repeats"),
    ],
)
def test_wrong_use_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], word: str
) -> None:
    assert run(["bench", *arguments]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert word in error


def test_a_view_of_nothing_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "demo:orbital", "--isovalue", "1", "--size", "8"]) == 2
    assert "Nothing is to be seen at isovalue 1" in capsys.readouterr().err


def test_the_table_has_a_line_for_each_figure() -> None:
    assert table({"a_ms": 1.23456, "by": {"x": 2, "y": 3.0}}).splitlines() == [
        "a_ms  1.235",
        "by.x  2",
        "by.y  3",
    ]


def test_candidates_alternate_and_the_first_round_is_left_out() -> None:
    seen: list[tuple[str, int]] = []

    def candidate(name: str) -> Any:
        def work(turn: int) -> float:
            seen.append((name, turn))
            return float(turn)

        return work

    assert take_turns({"a": candidate("a"), "b": candidate("b")}, 2) == {
        "a": [1.0, 2.0],
        "b": [1.0, 2.0],
    }
    assert seen == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("a", 2), ("b", 2)]


def test_isovalues_near_differ_and_stay_in_the_range() -> None:
    scene = load_scene("demo:casting")
    levels = isovalues_near(scene, 9)
    assert len(set(levels)) == 9
    assert all(abs(level - scene.isovalue) <= 12.75 for level in levels)
    assert np.ptp(levels) > 20


@pytest.mark.parametrize("end", [0, 1])
def test_isovalues_near_an_end_of_the_range_go_inside(end: int) -> None:
    scene = load_scene("demo:casting")
    low, high = scene.isovalues
    levels = isovalues_near(replace(scene, isovalue=(low, high)[end]), 9)
    assert len(set(levels)) == 9
    assert all(low <= level <= high for level in levels)


def test_rays_bounce_off_the_surface_into_the_open_half(small_scene: Path) -> None:
    prepared = PreparedScene(load_scene(small_scene))
    primary = primary_rays(prepared, 48)
    t, _ = cast(prepared, primary)
    hit = np.isfinite(t)
    diffuse = bounce(prepared, primary, np.random.default_rng(1))
    assert 0 < len(diffuse) == hit.sum() < len(primary)
    points = (primary.origins + t * primary.directions)[:, hit]
    lift = diffuse.origins - points
    assert np.allclose(np.linalg.norm(lift, axis=0), 0.3, atol=1e-5)
    cosine = (lift / 0.3 * diffuse.directions).sum(axis=0)
    assert (cosine > -1e-6).all()
    assert cosine.mean() == pytest.approx(
        2 / 3, abs=0.02
    )  # E[cos²] / E[cos] of a cosine-weighted hemisphere
