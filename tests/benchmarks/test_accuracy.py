"""The parts of the accuracy suite, small: figures they promise, what these must be, and tables of
made-up ones.
"""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy import stiffness, surfaces
from benchmarks.accuracy.albedo import albedo
from benchmarks.accuracy.branching import branching
from benchmarks.accuracy.calibration import Told, frames_of, table
from benchmarks.accuracy.card import (
    CASES,
    GOALS,
    LOBES,
    TEXELS,
    Found,
    body,
    figures_of,
    place_of,
)
from benchmarks.accuracy.checking import checking
from benchmarks.accuracy.choices import choices
from benchmarks.accuracy.filtering import filtering
from benchmarks.accuracy.formulas import KINDS, made
from benchmarks.accuracy.furnace import furnace
from benchmarks.accuracy.glass import error_of, glass
from benchmarks.accuracy.interpolation import interpolation
from benchmarks.accuracy.kept import Kept
from benchmarks.accuracy.lobes import lobes
from benchmarks.accuracy.looks import SIGMAS, Truth, noise_of, steps_anywhere, steps_beyond
from benchmarks.accuracy.projected import projected
from benchmarks.accuracy.roulette import roulette
from benchmarks.accuracy.scenes import load_calibrated
from benchmarks.accuracy.tools import tools
from benchmarks.accuracy.totals import totals
from isogi_core.plan.projection import Expectation
from tests.benchmarks.parts import figures
from tests.scale import COMPILED

SMALL = ("--size", "16", "--repeats", "1")


def test_lobes() -> None:
    """The sky of a demo has one, its sun."""
    timed = ("turned", "turned, processor", "at rest")
    names = {
        f"{n} {what}"
        for n in (0, 1)
        for what in ("told, %", "bytes a texel", *(f"{way}_ms" for way in timed))
    }
    assert set(figures(lobes, "demo:casting", *SMALL)) == names | {
        f"1 {way} / 0 {way}" for way in timed
    }


@pytest.mark.long
def test_albedo() -> None:
    """At the highest albedo light is that of a fresh bake; below it, mixing errs by no more than a
    hundredth.
    """
    found = figures(albedo, "demo:orbital", "--samples", "16", *SMALL)
    albedos = ("0.1", "0.3", "0.6", "0.9", "0.9,0.5,0.1")
    names = {
        f"{name} {what}"
        for name in albedos
        for what in ("apart, %", "mixed, %", "bake, s", "bytes a texel")
    }
    names |= {f"{name} fresh_ms" for name in albedos} | {
        "live bake, s",
        "live bytes a texel",
        "told, %",
    }
    assert set(found) == names | {"live, albedo moved_ms"}
    assert found["0.9 apart, %"] < 0.01 and all(found[f"{name} mixed, %"] < 1.0 for name in albedos)


def test_roulette_pays_where_albedos_are_high() -> None:
    found = figures(roulette, "demo:orbital", "--size", "24")
    ratios = [found[f"roulette / cut at albedo {albedo}"] for albedo in (0.1, 0.5, 0.9, 0.99)]
    assert all(math.isfinite(ratio) and ratio > 0.0 for ratio in ratios)
    assert ratios[-1] < ratios[0]


def test_branches_take_error_off() -> None:
    found = figures(branching, "demo:orbital", "--size", "24")
    assert found["demo:orbital: planned"] == 4 and 0.0 < found["demo:orbital: single, error"] < 0.04
    assert all(0.0 < found[f"demo:orbital: {count}: error then"] < 1.1 for count in (2, 4, 8))
    assert all(found[f"demo:orbital: {count}: time to equal error"] > 0.0 for count in (2, 4, 8))


def test_what_projection_gains_is_listed_by_volume() -> None:
    found = figures(projected, "demo:orbital", "--size", "12", "--paths", "16")
    assert found["volumes"] == 1 and found["projected by the plan"] == 0
    assert 0.0 < found["orbital: expected, %"] < 1.0
    errors = [found[f"orbital: {name}, RMSE, %"] for name in ("own isosurfaces", "projected")]
    assert all(0.0 <= error < 10.0 for error in errors), (
        "without the reference's noise, which may be all of it"
    )
    assert found["orbital: bake projected / bake"] > 1.0


def test_a_finer_lattice_interpolates_better(tmp_path: Path) -> None:
    """Vicinity shading misses more than any of them; a plain gradient and other offsets make other
    pictures.
    """
    scene = tmp_path / "coarse.toml"
    scene.write_text(
        'volume = "demo:orbital"\nlattice = 0.5\nbounces = 2\n[[lights]]\ntype = "constant"\n'
    )
    found = figures(choices, str(scene), "--size", "16", "--paths", "512")
    carried = [
        found[f"{density} texels per voxel: interpolation, %"] for density in ("0.25", "0.5", "1")
    ]
    assert carried[0] > carried[1] > carried[2] > 0.0
    assert found["vicinity shading: RMSE, %"] > 2.0 * found["0.25 texels per voxel: RMSE, %"]
    assert found["plain gradient, offset 0.3: difference, %"] > 0.1
    assert found["smoothed gradient, offset 1: difference, %"] > 0.1


def test_interpolation_has_a_row_for_each_way() -> None:
    found = figures(interpolation, "demo:orbital", "--size", "12")
    assert found["nearest: RMSE, %"] > found["trilinear: RMSE, %"]
    assert found["trilinear: RMSE, %"] == found["on their own isosurfaces: RMSE, %"]


def test_checks_are_told_beside_the_bake() -> None:
    found = {
        key.removeprefix("demo:orbital: "): value
        for key, value in figures(checking, "demo:orbital", "--size", "24").items()
    }
    assert found["final"] == 1.0 and 0.0 < found["told"] <= 0.05
    assert found["all steps, s"] >= found["first step, s"] > 0.0 < found["bake, s"]
    assert found["bytes"] > 0 and found["first step / bake"] == found["first step / bake, median"]


@pytest.mark.long
def test_tools(small_scene: Path) -> None:
    scene = small_scene.with_name("tools.toml")
    scene.write_text(small_scene.read_text().replace("lattice = 0.5", "rotating = false"))
    found = figures(tools, str(scene), "--size", "48", "--error", "0.3")
    assert found["final light"] == 1.0
    assert all(found[f"{kind}: MB"] > 0.0 for kind in ("glb", "ply", "usdz", "vti", "zarr"))
    if "ParaView" not in found:
        assert found["ParaView: sRGB RMSE, of 1"] < 0.1
    if "trimesh: vertices of .glb" in found:
        assert (
            found["trimesh: .glb and .ply apart at most, voxels"] < 1e-3
            and found["trimesh: .ply encloses, voxels"] > 0.0
        )


@COMPILED
def test_frames_are_as_wrong_as_they_say() -> None:
    name = "orbital, sky, coloured"
    ((_, scene),) = load_calibrated([name])
    frames = list(frames_of(name, scene, 12, 64))
    assert len(frames) == 2 * 2 * 4, "two views, two turns, 16 and 64 samples and two targets"
    ratios = np.array([told.ratio for told in frames])
    assert 0.75 < np.median(ratios) < 1.33 and ((ratios > 0.5) & (ratios < 2.0)).all()
    assert np.mean([told.covered for told in frames]) > 0.8


def test_the_table_has_a_line_for_each_and_one_for_all() -> None:
    frames = [
        Told("box", 0, 0, light, 0.02, 0.02 / ratio, ratio, 0.95)
        for light, ratio in (("16", 1.0), ("64", 2.0))
    ]
    lines = table(frames).splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == ["| box", "| all, 16", "| all, 64", "| all"]
    assert lines[-1] == "| all | 2 | 1.50 | 50% | 1.00 … 2.00 | 95.0% |"


def test_there_are_twenty_views_of_six_scenes(tmp_path: Path) -> None:
    assert len(TEXELS) == 20 and len({case.volume for case in TEXELS}) == 6
    assert {case.light for case in TEXELS} == {"constant light", "uffizi"}
    assert any(case.window for case in TEXELS) and any(case.parallel for case in TEXELS)
    assert len({place_of(tmp_path, case, 128) for case in CASES}) == len(CASES)


def test_figures_weigh_views_by_their_pixels() -> None:
    read = {
        TEXELS[0]: Found(1.0, 0.001, 300, 0, 10),
        TEXELS[1]: Found(0.5, 0.004, 100, 1, 10),
        LOBES[0]: Found(0.99, 0.01, 50, 0, 7),
    }
    found = figures_of(read)
    assert found["texels, within 2/255, all pixels"] == 350 / 400
    assert (found["texels, within 2/255, least"], found["texels, RMSE, most"]) == (0.5, 0.004)
    assert (found["texels, views as asked"], found["moving, views as asked"]) == (1, 1)
    assert found["bytes of a first view of the engine"] == 7 and "new, views" not in found


def test_each_kind_of_view_has_a_table_with_its_goal() -> None:
    text = body({case: Found(1.0, 0.0, 100, 0, 1) for case in CASES})
    assert text.count("\n## ") + 1 == len(GOALS) and text.count("asked: ") == len(GOALS)
    assert text.count("100.000%") == len(CASES)


def shown(light: np.ndarray) -> Any:
    """What a frame of one row shows of grey ``light``."""
    gbuffer = SimpleNamespace(pixels=np.arange(len(light)))
    return SimpleNamespace(radiance=np.repeat(light[None, :, None], 3, axis=2), gbuffer=gbuffer)


def test_the_noise_of_the_truth_is_no_part_of_an_error() -> None:
    rng = np.random.default_rng(1)
    halves = 2.0 + rng.normal(scale=0.5, size=(100_000, 2))
    assert error_of(shown(np.full(100_000, 2.1)), halves) == pytest.approx(0.05, rel=0.05)
    assert error_of(shown(np.full(100_000, 2.0)), halves) < 0.02


@pytest.mark.long
def test_glass_is_at_its_target_at_rest_and_says_so() -> None:
    found = figures(glass, "demo:casting", "--size", "16", "--trees", "8", "--paths", "8")
    assert 0.0 < found["true at rest, worst"] < 0.03
    assert 0.5 < found["told / true at rest, median"] < 2.0
    assert 0.3 < found["told / true at once, least"] < 3.0


def test_new_texels_are_told_from_those_refined() -> None:
    own = Path("one/c/0")
    other = Path("two/c/0")
    fresh = Path("one/c/1")
    before = {own: np.array([0, 1, 2, 0], np.uint8), other: np.array([3, 0, 0, 0], np.uint8)}
    after = {own: np.array([1, 1, 3, 0], np.uint8), other: np.array([3, 0, 2, 2], np.uint8)}
    after[fresh] = np.array([0, 0, 4, 0], np.uint8)
    assert surfaces.baked({"one"}, before, after) == (2, 2, 1)
    assert surfaces.baked({"one"}, after, after) == (0, 0, 0)


def test_slides_are_read_back_as_they_were_kept(tmp_path: Path) -> None:
    view = surfaces.Found("bone at 110", 0.01, 0.05, 0.012, True, 2, 3, 1, 4096, 640, 2.5)
    slide = surfaces.Slide("skin", (view, view), view)
    Kept(tmp_path / "slides", surfaces.Slide.of).put(slide)
    again = Kept(tmp_path / "slides", surfaces.Slide.of)
    assert again.get("skin") == slide and again.get("bone") is None


def surface(steep: float, noisy: float, error: float, told: float) -> stiffness.Surface:
    return stiffness.Surface("made", steep, noisy, Expectation(told / 2, told, 2 * told), error)


def test_a_law_is_found_again() -> None:
    shares = np.random.default_rng(3).uniform(0.0, 1.0, (40, 2))
    surfaces = [surface(s, n, 0.004 + 0.03 * s + 0.2 * n, 0.1) for s, n in shares]
    assert stiffness.fit(surfaces) == pytest.approx((0.004, 0.03, 0.2), rel=1e-3)


def test_what_was_told_is_judged() -> None:
    surfaces = [
        surface(0.1, 0.0, error, told) for error, told in [(0.01, 0.01), (0.03, 0.02), (0.1, 0.04)]
    ]
    found = stiffness.figures(surfaces)
    assert found["surfaces"] == 3
    assert found["measured / told, percentile 50"] == pytest.approx(1.5)
    assert found["within the range that is told"] == pytest.approx(2 / 3)
    assert found["rank correlation"] == pytest.approx(1.0)


def test_a_picture_is_as_wrong_as_it_says_and_reaches_its_target(tmp_path: Path) -> None:
    """Views that are kept are not measured again."""
    kept = tmp_path / "kept.jsonl"
    asked = (
        "--size",
        "24",
        "--paths",
        "256",
        "--views",
        "2",
        "--only",
        "nested shells 1 under constant light",
        "--kept",
        str(kept),
    )
    found = figures(totals, *asked)
    lines = kept.read_text()
    assert (
        figures(totals, *asked) == found
        and kept.read_text() == lines
        and len(lines.splitlines()) == 4
    )
    assert (found["views"], found["final"]) == (4, 1.0)
    assert 0.5 < found["told / true, median"] < 2.0
    assert 0.0 < found["worst true error told as final"] <= 0.025
    assert 0.5 < found["later views: told / true at the end, median"] < 2.0


def test_filtered_light_is_nearer_to_the_truth() -> None:
    case = "nested shells 1 under constant light"
    found = figures(filtering, "--size", "24", "--paths", "256", "--only", case)
    assert len(found) == 4
    assert found[f"{case}, 16 samples: filtered / alone"] < 0.95
    assert found[f"{case}, 16 samples in a quarter: provisional"] < 0.02


def test_a_white_furnace_is_white() -> None:
    found = figures(furnace, "--size", "24", "--paths", "32", "--only", "coarse shell 1")
    assert (
        found["volumes"] == 1
        and found["worst mean, off by"] < 0.005
        and found["worst pixel, off by"] < 0.05
    )


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_by_formula_have_a_surface(kind: str) -> None:
    volume, isovalue = made(kind, 1)
    low, high = volume.value_range
    assert low < isovalue < high and np.isfinite(volume.voxels).all()
    inside = float((volume.voxels > volume.normalise_isovalue(isovalue)).mean())
    assert 0.002 < inside < 0.998


def test_a_seed_makes_the_same_volume_and_another_another() -> None:
    one, same, other = (made("coarse shell", seed)[0].voxels for seed in (1, 1, 2))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_noise_to_the_eye_leaves_out_slopes_and_edges() -> None:
    """A binomial mean over 5 × 5 pixels takes away the share √(1 - 2 · 36/256 + 0.075) of noise."""
    y, x = np.mgrid[:64, :64]
    noise = np.random.default_rng(1).normal(0.0, 0.3, (64, 64))
    shown = 40.0 + 0.1 * x + 30.0 * (y > 40) + noise
    assert noise_of(shown, np.ones((64, 64), bool), None) == pytest.approx(0.27, rel=0.1)
    assert noise_of(shown - noise, y < 38, None) < 1e-9
    assert noise_of(shown, np.zeros((64, 64), bool), None) == 0.0


def test_steps_at_borders_are_those_beyond_the_truth() -> None:
    truth = np.tile(np.arange(8.0), (8, 1))
    own = np.tile(np.arange(8) < 4, (8, 1))
    found = steps_beyond(truth + 2.0 * own, truth, own, np.ones((8, 8), bool))
    assert found.tolist() == [-2.0] * 8


def test_steps_anywhere_are_those_beyond_noise() -> None:
    """A step of 3 between two halves, at a truth whose pixels have a noise of 0.1."""
    right = np.tile(np.arange(8) >= 4, (8, 1))
    truth = Truth(np.zeros((8, 8)), np.full((8, 8), 0.1), np.zeros((8, 8)))
    noise = np.random.default_rng(1).normal(0.0, 0.1, (8, 8)).clip(-0.25, 0.25)
    found = steps_anywhere(3.0 * right + noise, truth, np.ones((8, 8), bool))
    beyond = found[found != 0.0]
    assert len(found) == 2 * 7 * 8 and len(beyond) == 8
    assert beyond == pytest.approx(np.full(8, 3.0 - SIGMAS * np.hypot(0.1, 0.1)), abs=0.5)
    assert len(steps_anywhere(3.0 * right, truth, right)) == 4 * 7 + 3 * 8
