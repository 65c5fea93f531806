"""The scaling suite, small: what it counts is right, and nothing is lost, torn or wrong."""

import json
import sys
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from benchmarks.scaling import damage as damage_module
from benchmarks.scaling import kills as kills_module
from benchmarks.scaling import kinds as kinds_module
from benchmarks.scaling import prewarm
from benchmarks.scaling.cluster import cluster
from benchmarks.scaling.damage import damage
from benchmarks.scaling.kills import kills
from benchmarks.scaling.large import large
from benchmarks.scaling.public import draw, public
from benchmarks.scaling.time_left import time_left
from benchmarks.scaling.watching import altered
from isogi_core.files.volume_copies import read_voxels
from isogi_server.cli.prewarm import fields_given
from isogi_server.cli.prewarm import prewarm as prewarm_views
from isogi_server.prewarm.order import order_of
from isogi_server.settings import Settings
from isogi_worker import pool
from tests.benchmarks.parts import figures, run
from tests.server.inline import InlinePool


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene that is baked in a second."""
    scene = tmp_path_factory.mktemp("scene") / "tiny.toml"
    scene.write_text('volume = "demo:orbital"\nlattice = 0.4\nbounces = 1\ntarget_error = 0.4\n')
    return str(scene)


@pytest.mark.long
def test_kills(tiny: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a server that soon dies; kills of workers and prewarms have tests of their own, beside
    what they are about.
    """
    monkeypatch.setitem(kills_module.LATEST, "server", 0.5)
    monkeypatch.setattr(kills_module, "WORKERS", 1)
    found = figures(kills, tiny, "--victim", "server", "--cycles", "1")
    assert found["servers killed"] == 1 and found["views that became final"] >= 1
    assert found["objects read meanwhile"] >= found["objects"] > 0
    wrong = (
        "answers 5xx",
        "torn",
        "lost, or with less light than before",
        "processes left after 5 s",
    )
    differ = (
        "objects with other bytes than undisturbed",
        "texels lost, or of other light by as many samples",
        "objects that undisturbed are none",
    )
    pictures = "final pictures that changed since", "final pictures that differ"
    assert not any(found[name] for name in (*wrong, *differ, *pictures)), found


def test_kills_come_in_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []

    def in_a_round(_: str | None, victim: str, cycles: int, seed: int) -> dict[str, float]:
        asked.append((cycles, seed))
        return {f"{victim}s killed": cycles, kills_module.RESTART: 9.0 - seed}

    monkeypatch.setattr(kills_module, "in_a_round", in_a_round)
    monkeypatch.setattr(kills_module, "ROUND", 10)
    found = figures(kills, "--victim", "server", "--cycles", "25", "--seed", "3")
    assert asked == [(10, 3), (10, 4), (5, 5)]
    assert found == {"servers killed": 25, kills_module.RESTART: 6.0}


@pytest.mark.long
def test_damage(tiny: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(damage_module, "WORKERS", 1)
    found = figures(damage, tiny, "--damaged", "11", "--flips", "50", "--views", "1")
    assert found["bits flipped, one at a time"] == 50 and found["not noticed by a reader"] == 0
    assert found["damaged"] == 11 and found["final pixels"] > 0
    assert found["told as damaged"] >= 11 - found["not to be noticed: deleted"] > 0
    assert found["answers 5xx"] == found["wrong pixels"] == 0
    assert found["texels lost, or of other light by as many samples"] == 0


def test_light_is_held_to_the_byte_by_its_samples() -> None:
    before = {("a", 1): (16, b"x"), ("a", 2): (16, b"y"), ("b", 1): (32, b"z")}
    assert altered(before, {**before, ("a", 1): (32, b"other")}) == 0
    assert altered(before, {**before, ("b", 1): (32, b"other")}) == 1
    assert altered(before, {}) == 3


@pytest.mark.long
def test_public(tmp_path: Path) -> None:
    z, y, x = np.mgrid[:24, :24, :24] - 11.5
    nrrd.write(
        str(tmp_path / "ball.nrrd"), (20.0 - np.sqrt(x * x + y * y + z * z)).astype(np.float32)
    )
    (tmp_path / "list.txt").write_text("me ball.nrrd\n")
    done = run(public, "--list", str(tmp_path / "list.txt"), "--folder", str(tmp_path / "pictures"))
    assert (
        "| me | ball.nrrd | NRRD of float32; it does not say where it lies | 24 × 24 × 24 |"
        in done.stdout
    )
    assert [picture.name for picture in (tmp_path / "pictures").iterdir()] == ["00.png"]


def test_public_files_that_are_refused_are_listed(tmp_path: Path) -> None:
    (tmp_path / "page.nrrd").write_text("<html>")
    found = draw("me", str(tmp_path / "page.nrrd"), tmp_path / "a.png", 5)
    assert found.row[:2] == ("me", "page.nrrd") and found.row[-1] == "refused"
    assert "'page.nrrd' seems to be a web page" in found.read_as


@pytest.mark.long
@pytest.mark.parametrize("missing", ["", "nibabel"])
def test_kinds(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: kinds_module.WRITERS[name] for name in ("f.nii", "f.h5")}
    monkeypatch.setattr(kinds_module, "WRITERS", few)
    if missing:
        monkeypatch.setitem(sys.modules, missing, None)
    done = run(kinds_module.kinds, "--size", "32", "--json")
    found = json.loads(done.stdout)
    assert found["f.h5: lit share"] > 0.9 and ("f.nii: seconds" in found) == (not missing)
    assert ("f.nii is left out: nibabel is not installed." in done.stderr) == bool(missing)


@pytest.mark.long
def test_cluster() -> None:
    arguments = [
        "demo:orbital",
        "--size",
        "16",
        "--tasks",
        "2",
        "--rounds",
        "1",
        "--workers",
        "1",
        "--same",
        "1",
    ]
    done = run(cluster, *arguments, "--json")
    found = json.loads(done.stdout)
    bytes_left = {value for name, value in found.items() if name.startswith("SHA-256")}
    assert len(bytes_left) == 1 and found["tasks"] == 2
    for kind in ("embedded 1", "joined 1"):
        ratio = found[f"{kind}: paths a second"] / found["bare copies 1: paths a second"]
        assert found[f"{kind} / bare copies"] == pytest.approx(ratio)
        assert (
            found[f"{kind} / bare copies, by processor seconds"]
            > 0.0
            < found[f"most memory of a worker of {kind}, MiB"]
        )
    assert "round 1 of 1" in done.stderr


@pytest.mark.long
def test_a_volume_beyond_the_budget_is_rendered_and_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    small = ("--size", "80", "--pixels", "24", "--seconds", "1", "--folder", str(tmp_path))
    found = figures(large, *small)
    assert found["serve: first frame after, s"] >= found["serve: ready after, s"] > 0
    for process in ("render: main", "serve: main", "serve: worker"):
        assert found[f"{process}: RssAnon, MiB"] > 0 < found[f"{process}: RssFile, MiB"]
        assert found[f"{process}: processor, s"] > 0
    assert (tmp_path / "gyroid-80.png").read_bytes().startswith(b"\x89PNG")
    (copy,) = {path.stat().st_ino: path for path in (tmp_path / "copies").glob("*.voxels")}.values()
    surveys = sum(path.stat().st_size for path in (tmp_path / "copies").glob("*/*.npy"))
    assert (
        copy.stat().st_size == pytest.approx(80**3 * 4, rel=0.01)
        and 0 < surveys < copy.stat().st_size / 10
    )
    assert found["disk: copies, MiB"] == pytest.approx(
        (copy.stat().st_size + surveys) / 2**20, rel=1e-3
    )
    voxels, facts = read_voxels(copy) or pytest.fail("the copy cannot be read")
    assert voxels.shape == (80, 80, 80) and facts["dtype"] == "uint16"


def in_process(target: str, store: Path, *more: str) -> dict[str, Any]:
    """What the command does, without a process of its own."""
    named = dict(option.removeprefix("--").replace("-", "_").partition("=")[::2] for option in more)
    dry = "dry_run" in named
    isovalue = named["isovalue"]
    given = {
        name: value
        for name, value in named.items()
        if name not in ("dry_run", "isovalue", "workers")
    }
    order = order_of(fields_given(given | {"isovalues": (isovalue,)}))
    return prewarm_views(target, order, Settings(store=str(store), workers=1), dry).model_dump(
        mode="json"
    ) | {"cpu": 1.0}


def test_what_came_is_told_beside_what_was_foretold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "start_pool", InlinePool)
    monkeypatch.setattr(prewarm, "prewarmed", in_process)
    options = ["--only", "casting", "--size", "12", "--views", "1", "--error", "0.5"]
    found = figures(prewarm.prewarm, *options)
    assert found["casting: final"] == 1.0
    assert found["casting: worst error"] <= 0.5
    assert found["casting: bytes stored over told"] == pytest.approx(1.0, abs=0.3)
    ratio = found["casting: took, s"] / found["casting: told, s"]
    assert found["casting: took over told"] == pytest.approx(ratio)


def test_time_left() -> None:
    arguments = [
        "demo:orbital",
        "--size",
        "16",
        "--views",
        "2",
        "--error",
        "0.2",
        "--every",
        "0.05",
    ]
    found = figures(time_left, *arguments)
    assert all(found[f"view {n}, seconds"] > 0.0 for n in (1, 2))
    assert all(0.0 < found[f"view {n}, estimated error"] <= 0.2 for n in (1, 2))
    assert all(0.0 <= found[f"view {n}, within the range"] <= 1.0 for n in (1, 2))
