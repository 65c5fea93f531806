"""The speed suite runs on something tiny without optional packages, and has the figures that it
promises.
"""

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from benchmarks.speed import growth, points
from benchmarks.speed.edges import edges
from benchmarks.speed.film import film
from benchmarks.speed.frames import frames
from benchmarks.speed.isovalue import isovalue
from benchmarks.speed.paths import paths
from benchmarks.speed.rays import rays
from isogi_core.kernels.transport import streams
from isogi_core.model.demo import demo_volume
from tests.benchmarks.parts import figures, run

OPTIONAL = ("embreex", "skimage", "vtk", "mitsuba")
SMALL = ("--size", "16", "--repeats", "1")


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """No optional package is installed."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name in OPTIONAL else find(name, *a)
    )


def positive(part: click.Command, *arguments: str) -> dict[str, Any]:
    """The figures of a part; every number among them is finite and positive."""
    found = figures(part, *arguments, *SMALL)
    assert all(
        value > 0 and math.isfinite(value) for value in found.values() if not isinstance(value, str)
    )
    return found


def test_frames() -> None:
    shadings = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")
    names = {f"{name}_ms" for name in (*shadings, "relight", "develop")}
    names |= {
        "gi / lambert",
        "gi / lambert_shadow",
        "relight / gi",
        "lattice / texels of this view",
    }
    names |= {"gi, converging_ms", "gi, converging / gi", "window_ms", "window / gi"}
    assert set(positive(frames, "demo:casting")) == names


def test_edges() -> None:
    found = positive(edges, "demo:casting")
    assert found["RMSE, smooth"] < found["RMSE, plain"]
    assert {
        "plain_ms",
        "smooth_ms",
        "smooth / plain",
        "smooth / plain, RMSE",
        "samples / pixels",
    } < set(found)


def test_rays() -> None:
    found = positive(rays, "demo:casting@100")
    assert (found["isosurface"], found["embree"]) == ("casting at 100", "not installed")
    names = {
        f"{kind}: {what}"
        for kind in ("primary", "bounce1", "bounce2")
        for what in ("Mrays/s", "lanes / scalar")
    }
    assert names | {"memory, MB"} <= set(found)


def test_rays_of_several_isosurfaces_are_a_line_each() -> None:
    lines = run(rays, "demo:casting@100", "demo:orbital", *SMALL, "--json").stdout.splitlines()
    assert [json.loads(line)["isosurface"] for line in lines] == [
        "casting at 100",
        "orbital at 0.03",
    ]


def test_isovalue() -> None:
    found = positive(isovalue, "demo:casting")
    assert found.pop("vtk") == found.pop("embree") == "not installed"
    assert set(found) == {"gi_ms", "lambert_ms"}


def test_paths() -> None:
    found = positive(paths, "demo:casting")
    assert found["mitsuba llvm"] == found["mitsuba scalar"] == "not installed"
    names = {
        f"{who}, {n}: Mpaths/s"
        for who in ("isogi", "isogi order 5")
        for n in ("one thread", "two threads")
    }
    assert names <= set(found)
    assert 1 < found["segments per path: pixels"] < 5
    assert 0.3 < found["radiance: isogi"] < 0.7


@pytest.mark.long
def test_growth() -> None:
    found = positive(growth.growth, "demo:orbital", "--largest", "32")
    names = {f"{step}: {s}_ms" for step in ("32³", "8²", "16²", "32²") for s in ("gi", "lambert")}
    names |= {
        f"{n}: {k}_ms"
        for n in ("one thread", "two threads", "two processes")
        for k in ("gi", "lambert", "rays")
    }
    names |= {f"two threads / two processes: {kind}" for kind in ("gi", "lambert", "rays")}
    assert names <= set(found)


def test_a_resampled_volume_is_the_same_shape() -> None:
    volume = demo_volume("casting")
    half = growth.resample(volume, 64)
    assert half.shape == (64, 64, 64)
    assert half.extent == pytest.approx(volume.extent)
    assert half.value_range == pytest.approx(volume.value_range, rel=0.01, abs=0.01)
    same = growth.resample(volume, 128).voxels[:, ::127, ::127]
    assert np.allclose(same[[0, -1]], volume.voxels[[0, -1]][:, ::127, ::127])


def test_ratios_are_at_equal_time() -> None:
    """Random errors 8 t^-1/2; the others have 2, 1, 0.5 at times of their own, within and beyond
    the others'.
    """
    own = (1, 2.0, 1.0, 8.0, 1.0), (2, 1.0, 2.0, 4.0, 4.0), (3, 0.5, 64.0, 2.0, 16.0)
    found = points.ratios([points.Point(*each) for each in own])
    assert found == pytest.approx([4.0, 8.0 / np.sqrt(2.0), 2.0])


def test_errors_are_without_the_noise_of_the_reference() -> None:
    rng = np.random.default_rng(1)
    true = 2.0 + rng.normal(size=(20000, 8))
    light = 2.0 + 0.3 * rng.normal(size=20000)
    assert points.error(light, true) == pytest.approx(0.15, rel=0.03)


class Coins:
    """Surfels whose sequences all have one random number, twice as many times as points."""

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        assert points == 1 and stream >= 2 * streams.REFERENCE_STREAM
        return np.random.default_rng(stream).normal(size=(4000, sequences))


@pytest.mark.parametrize("samples", [16, 256])
def test_random_points_have_the_error_of_independent_ones(samples: int) -> None:
    assert points.random(Coins(), samples).std() == pytest.approx(samples**-0.5, rel=0.05)


def test_points_tell_of_texels_and_of_pixels() -> None:
    lines = run(
        points.points, "demo:orbital", "--size", "16", "--samples", "16", "--json"
    ).stdout.splitlines()
    assert len(lines) == 2
    for found in map(json.loads, lines):
        assert 0.3 < found["16 samples: random / low-discrepancy"] < 10.0
        assert (
            0.0 < found["16 samples: error"] < 1.0 and 0.0 < found["16 samples: random error"] < 2.0
        )


@pytest.mark.long
def test_film(small_scene: Path, tmp_path: Path) -> None:
    small = (
        "--frames",
        "3",
        "--degrees",
        "6",
        "--singles",
        "2",
        "--alone",
        "1",
        "--size",
        "16",
        "--workers",
        "1",
    )
    kept = (*small, "--error", "0.5", "--folder", str(tmp_path))
    with pytest.raises(AssertionError, match="run the same command again"):
        figures(film, str(small_scene), *kept, "--seconds", "1")
    found = figures(film, str(small_scene), *kept)
    assert figures(film, str(small_scene), *kept) == found, "what is kept is not measured again"
    assert found["film: final frames"] == 1.0 and found["mitsuba"] == "not installed"
    assert 0.0 <= found["film: median error"] <= found["film: worst error"] <= 0.5
    for store in ("a store of its own", "one store"):
        every, each = (
            found[f"single pictures, {store}: {what}"] for what in ("all frames, s", "s each")
        )
        assert every == pytest.approx(3 * each)
        assert found[f"single pictures, {store} / film"] == pytest.approx(every / found["film, s"])
