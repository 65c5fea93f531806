"""The small parts of the accuracy suite on demos: the figures that they promise, and what these must be."""

import math
from pathlib import Path

from benchmarks.accuracy.albedo import albedo
from benchmarks.accuracy.branching import branching
from benchmarks.accuracy.checking import checking
from benchmarks.accuracy.choices import choices
from benchmarks.accuracy.interpolation import interpolation
from benchmarks.accuracy.lobes import lobes
from benchmarks.accuracy.projected import projected
from benchmarks.accuracy.roulette import roulette
from benchmarks.accuracy.tools import tools
from tests.benchmarks.parts import figures

SMALL = ("--size", "16", "--repeats", "1")


def test_lobes() -> None:
    """The sky of a demo has one, its sun."""
    timed = ("turned", "turned, processor", "at rest")
    names = {f"{n} {what}" for n in (0, 1) for what in ("told, %", "bytes a texel", *(f"{way}_ms" for way in timed))}
    assert set(figures(lobes, "demo:casting", *SMALL)) == names | {f"1 {way} / 0 {way}" for way in timed}


def test_albedo() -> None:
    """At the highest albedo light is that of a fresh bake; below it, mixing errs by no more than a hundredth."""
    found = figures(albedo, "demo:orbital", "--samples", "16", *SMALL)
    albedos = ("0.1", "0.3", "0.6", "0.9", "0.9,0.5,0.1")
    names = {f"{name} {what}" for name in albedos for what in ("apart, %", "mixed, %", "bake, s", "bytes a texel")}
    names |= {f"{name} fresh_ms" for name in albedos} | {"live bake, s", "live bytes a texel", "told, %"}
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
    assert all(0.0 <= error < 10.0 for error in errors), "without the reference's noise, which may be all of it"
    assert found["orbital: bake projected / bake"] > 1.0


def test_a_finer_lattice_interpolates_better(tmp_path: Path) -> None:
    """Vicinity shading misses more than any of them; a plain gradient and other offsets make other pictures."""
    scene = tmp_path / "coarse.toml"
    scene.write_text('volume = "demo:orbital"\nlattice = 0.5\nbounces = 2\n[[lights]]\ntype = "constant"\n')
    found = figures(choices, str(scene), "--size", "16", "--paths", "512")
    carried = [found[f"{density} texels per voxel: interpolation, %"] for density in ("0.25", "0.5", "1")]
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
