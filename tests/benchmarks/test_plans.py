"""The table of plans, on the casting without the shared data and on pictures of few pixels."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from benchmarks.accuracy import plans
from benchmarks.accuracy.plans import Bake, Row, table
from benchmarks.accuracy.scenes import PLANNED, load_planned
from isogi_core.plan.reachable_texels import TexelCount
from tests.benchmarks.parts import run as run_part

LAMP = "constant light and a lamp"


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """There are no shared data, and no time for many paths."""
    monkeypatch.setenv("ISOGI_SHARED_DATA", str(tmp_path / "none"))
    monkeypatch.setattr(plans, "PATHS", 64)


def run(*names: str) -> Result:
    """What the benchmark prints of scenes."""
    chosen = [word for name in names for word in ("--scene", name)]
    return run_part(plans.plans, "--size", "16", "--target", "0.5", *chosen, "--json")


@pytest.mark.long
def test_rows_tell_what_a_plan_takes_beside_s1() -> None:
    bare = "constant light, no bounces"
    found = json.loads(run(bare, LAMP).stdout)
    assert (found[f"{bare}: representation"], found[f"{bare}: bytes a texel"]) == ("vicinity", 4)
    assert found[f"{LAMP}: representation"] == "irradiance" and f"{LAMP}: S1: error, %" not in found
    assert found[f"{bare}: plan: store, MB"] < found[f"{bare}: S1: store, MB"] / 3
    assert found[f"{bare}: plan: error, %"] == pytest.approx(
        found[f"{bare}: S1: error, %"], abs=2.0
    )
    for way in (f"{bare}: plan", f"{bare}: S1", f"{LAMP}: plan"):
        assert found[f"{way}: bake, s"] > 0.0 and 0.0 < found[f"{way}: error, %"] < 25.0


def test_one_isovalue_shows_fewer_texels_than_a_range() -> None:
    names = (
        "constant light, one isovalue",
        "constant light, a range of isovalues",
        "constant light",
    )
    one, some, every = (scene.texels for _, scene in load_planned(names, 0.5))
    assert 0 < one.shown < some.shown < every.shown <= every.total == one.total


def test_scenes_under_probes_need_the_shared_data() -> None:
    done = run("rotating grace")
    assert json.loads(done.stdout) == {}
    assert "rotating grace: left out, as there are no shared data." in done.stderr


@pytest.mark.long
@pytest.mark.data
def test_all_scenes_are_there_with_the_shared_data(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_SHARED_DATA", str(shared_data))
    scenes = dict(load_planned(PLANNED, 0.05))
    assert list(scenes) == list(PLANNED)
    found: dict[str, set[str]] = {
        "vicinity": set(),
        "constant": set(),
        "irradiance": set(),
        "transfer": set(),
    }
    for name, scene in scenes.items():
        found[scene.plan.representation].add(name)
    assert (
        all(name.startswith("rotating") for name in found["transfer"])
        and len(found["transfer"]) == 5
    )
    assert found["irradiance"] == {LAMP, "fixed uffizi", "fixed uffizi, coloured albedo"}
    assert found["vicinity"] == {"constant light, no bounces"}


def test_the_table_is_markdown_with_a_dash_for_no_figure() -> None:
    row: dict[str, Any] = {
        "representation": "irradiance",
        "layers": "irradiance (half)",
        "bytes_per_texel": 4,
    }
    row["texels"] = TexelCount(
        total=10**6, shown=500, void=0, chunks=245, shown_chunks=10, chunk=16
    )
    rows = [
        Row("lamp", **row, by_plan=Bake(1.25, 0.5, 0.021), by_s1=None, reference_noise=0.01),
        Row(
            "black",
            **row,
            by_plan=Bake(1.0, 0.5, None),
            by_s1=Bake(2.0, 9.0, 0.1),
            reference_noise=0.0,
        ),
    ]
    head, rule, lamp, black = table(rows).splitlines()
    assert {line.count("|") for line in (head, rule, lamp, black)} == {10}
    assert lamp == (
        "| lamp | irradiance | irradiance (half) | 4 | 0.1% | 0.2 / 301.1 | 1.2 / – | 0.50 "
        "/ – | 2.1% / – |"
    )
    assert black.endswith("| 1.0 / 2.0 | 0.50 / 9.00 | – / 10.0% |")
