"""The benchmarks run on something tiny without optional packages, and print the figures that they promise."""

import importlib
import importlib.util
import json
import math
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from isogi_core.model.demo import demo_volume

OPTIONAL = ("embreex", "skimage", "vtk", "mitsuba")
SMALL = ("--size", "32", "--repeats", "1", "--json")


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """No optional package is installed."""
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name in OPTIONAL else find(name, *a))


def figures(name: str, *arguments: str) -> dict[str, Any]:
    """The figures of a benchmark on a demo; every number among them is finite and positive."""
    main = importlib.import_module(f"benchmarks.{name}").main
    done = CliRunner().invoke(main, [*arguments, *SMALL], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    assert all(value > 0 and math.isfinite(value) for value in found.values() if not isinstance(value, str))
    return found


def test_frames() -> None:
    shadings = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")
    names = {f"{name}_ms" for name in (*shadings, "relight", "develop")}
    names |= {"gi / lambert", "gi / lambert_shadow", "relight / gi", "lattice / texels of this view"}
    assert set(figures("frames", "demo:casting")) == names


def test_lobes() -> None:
    """The sky of a demo has one, its sun."""
    timed = ("turned", "turned, processor", "at rest")
    names = {f"{n} {what}" for n in (0, 1) for what in ("told, %", "bytes a texel", *(f"{way}_ms" for way in timed))}
    assert set(figures("lobes", "demo:casting")) == names | {f"1 {way} / 0 {way}" for way in timed}


def test_albedo() -> None:
    """At the highest albedo light is that of a fresh bake; below it, mixing errs by no more than a hundredth."""
    found = figures("albedo", "demo:orbital", "--samples", "64")
    albedos = ("0.1", "0.3", "0.6", "0.9", "0.9,0.5,0.1")
    names = {f"{name} {what}" for name in albedos for what in ("apart, %", "mixed, %", "bake, s", "bytes a texel")}
    names |= {f"{name} fresh_ms" for name in albedos} | {"live bake, s", "live bytes a texel", "told, %"}
    assert set(found) == names | {"live, albedo moved_ms"}
    assert found["0.9 apart, %"] < 0.01 and all(found[f"{name} mixed, %"] < 1.0 for name in albedos)


def test_warm_view() -> None:
    found = figures("warm_view", "demo:orbital")
    places = ("folder", "disk", "s3")
    assert [found[f"{where}: bytes / plain bytes"] for where in places] == [1.0, 1.0, 1.0]
    assert all(found[f"{where}: {what}"] > 0.0 for where in places for what in ("view / plain reads", "unwrapping, ms"))


def test_rays() -> None:
    found = figures("rays", "demo:casting@100")
    assert (found["isosurface"], found["embree"]) == ("casting at 100", "not installed")
    names = {f"{kind}: {what}" for kind in ("primary", "bounce1", "bounce2") for what in ("Mrays/s", "lanes / scalar")}
    assert names | {"memory, MB"} <= set(found)


def test_rays_of_several_isosurfaces_are_a_line_each() -> None:
    main = importlib.import_module("benchmarks.rays").main
    done = CliRunner().invoke(main, ["demo:casting@100", "demo:orbital", *SMALL], catch_exceptions=False)
    lines = [json.loads(line)["isosurface"] for line in done.stdout.splitlines()]
    assert lines == ["casting at 100", "orbital at 0.03"]


def test_isovalue() -> None:
    found = figures("isovalue", "demo:casting")
    assert found.pop("vtk") == found.pop("embree") == "not installed"
    assert set(found) == {"gi_ms", "lambert_ms"}


def test_paths() -> None:
    found = figures("paths", "demo:casting")
    assert found["mitsuba llvm"] == found["mitsuba scalar"] == "not installed"
    names = {f"{who}, {n}: Mpaths/s" for who in ("isogi", "isogi order 5") for n in ("one thread", "two threads")}
    assert names <= set(found)
    assert 1 < found["segments per path: pixels"] < 5
    assert 0.3 < found["radiance: isogi"] < 0.7


def test_growth() -> None:
    found = figures("growth", "demo:casting", "--largest", "32")
    names = {f"{step}: {s}_ms" for step in ("32³", "16²", "32²", "64²") for s in ("gi", "lambert")}
    names |= {f"{n}: {k}_ms" for n in ("one thread", "two threads", "two processes") for k in ("gi", "lambert", "rays")}
    names |= {f"two threads / two processes: {kind}" for kind in ("gi", "lambert", "rays")}
    assert names <= set(found)


def test_a_resampled_volume_is_the_same_shape() -> None:
    volume = demo_volume("casting")
    resample = importlib.import_module("benchmarks.growth").resample
    half = resample(volume, 64)
    assert half.shape == (64, 64, 64)
    assert half.extent == pytest.approx(volume.extent)
    assert half.value_range == pytest.approx(volume.value_range, rel=0.01, abs=0.01)
    same = resample(volume, 128).voxels[:, ::127, ::127]
    assert np.allclose(same[[0, -1]], volume.voxels[[0, -1]][:, ::127, ::127])


def test_drag() -> None:
    arguments = ["demo:orbital", "--size", "48", "--seconds", "2", "--pages", "2", "--workers", "1", "--json"]
    done = CliRunner().invoke(importlib.import_module("benchmarks.drag").main, arguments, catch_exceptions=False)
    found = json.loads(done.stdout)
    waits = [found[f"input to picture, {which}"] for which in ("median", "95 %", "longest")]
    assert 0.0 < waits[0] <= waits[1] <= waits[2]
    assert found["drafts a second and page"] > 1.0
    assert 12 <= found["pixels along a draft, median"] <= 48
    assert found["rest to full picture, longest"] > 0.0


def test_load() -> None:
    arguments = ["demo:orbital", "--clients", "9", "--seconds", "2", "--workers", "1", "--json"]
    done = CliRunner().invoke(importlib.import_module("benchmarks.load").main, arguments, catch_exceptions=False)
    found = json.loads(done.stdout)
    assert {key for key in found if key.startswith("answered")} <= {f"answered {n}" for n in (200, 304, 429, 503)}
    assert found["answered 200"] > 0 and found["livez, answers"] > 0
    assert found["requests in progress, afterwards"] == 0


def test_unruly() -> None:
    arguments = ["demo:orbital", "--slow", "9", "--aborting", "3", "--clients", "4", "--seconds", "1", "--json"]
    done = CliRunner().invoke(importlib.import_module("benchmarks.unruly").main, arguments, catch_exceptions=False)
    found = json.loads(done.stdout)
    assert found["answered 200, %"] == 100.0
    assert found["chunks wanted more than before"] == found["requests in progress still"] == found["exit status"] == 0
    assert found["found it gone"] == 4
    assert {key for key in found if key.startswith("answered")} <= {"answered 200, %", "answered 200", "answered 503"}


def test_time_left() -> None:
    main = importlib.import_module("benchmarks.time_left").main
    arguments = ["demo:orbital", "--size", "16", "--views", "2", "--error", "0.2", "--every", "0.05", "--json"]
    done = CliRunner().invoke(main, arguments, catch_exceptions=False)
    found = json.loads(done.stdout)
    assert done.exit_code == 0 and all(found[f"view {n}, seconds"] > 0.0 for n in (1, 2))
    assert all(0.0 < found[f"view {n}, estimated error"] <= 0.2 for n in (1, 2))
    assert all(0.0 <= found[f"view {n}, within the range"] <= 1.0 for n in (1, 2))
