"""The papers' method, which ours is measured against, and what the page tells of both."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy.papers import ORDER, PapersBake, papers_scene
from benchmarks.accuracy.table import FINER, Case, Measured, cells, figures_of, met
from benchmarks.common.scenes import Subject
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_report.bench import Bench
from isogi_report.speed import view_of

FOUND = Measured(
    rmse=[0.011, 0.029],
    p99=[0.05, 0.09],
    papers_rmse=[0.1, 0.2],
    papers_p99=[0.4, 0.5],
    noise=[0.001, 0.002],
    seconds=10.0,
    papers_seconds=12.0,
    bytes=60,
    papers_bytes=103,
    lobes=1,
)


def bench_of(light: str, folder: Path) -> Bench:
    scene = load_scene(
        "demo:orbital", lattice=0.4, bounces=1, target_error=0.2, lights=[{"type": light}]
    )
    return Bench(scene.with_settings(projected=True), view_of(scene, 16), folder)


def test_the_papers_keep_one_layer_of_all_light_and_move_nothing(tmp_path: Path) -> None:
    (layer,) = papers_scene(bench_of("sky", tmp_path).scene).plan.layers
    assert (layer.kind, layer.order, layer.half) == ("whole", ORDER, False)
    scene = papers_scene(bench_of("constant", tmp_path).scene)
    assert (scene.plan.order, scene.plan.lobes, scene.settings.projected) == (1, 0, False)


def test_the_papers_pictures_are_trilinear_in_their_own_texels(tmp_path: Path) -> None:
    """Under constant light frames without projected texels are so, too."""
    bench = bench_of("constant", tmp_path)
    papers = PapersBake(bench)
    papers.grow(1e-9)
    radiance = papers.radiance(bench.view)
    frame = papers.bake.frame()
    np.testing.assert_allclose(radiance, frame.radiance, rtol=1e-5, atol=1e-7)
    assert radiance.max() > 0.0 and papers.seconds > 0.0


def test_the_papers_light_turns(tmp_path: Path) -> None:
    bench = bench_of("sky", tmp_path)
    papers = PapersBake(bench)
    papers.grow(1e-9)
    turned: View = replace(bench.view, light=(0.0, 0.0, 1.0, 0.0))
    assert abs(papers.radiance(bench.view) - papers.radiance(turned)).max() > 0.01


@pytest.mark.parametrize(
    ("light", "rmse", "within"), [("grace", 0.029, "yes"), ("grace", 0.031, "no")]
)
def test_the_worst_turn_is_held_against_the_goal(light: str, rmse: float, within: str) -> None:
    case = Case(Subject("engine", 70, light))
    found = replace(FOUND, rmse=[0.01, rmse])
    line = cells(case, found)
    assert within in line and f"**{100 * rmse:.2f} (9.0)**" in line and "20.00 (50.0)" in line
    figures = figures_of({case: found})
    assert figures["engine under grace at 70: RMSE, %"] == 100 * rmse
    assert figures["views by the plan within goals"] == (within == "yes")


def test_under_a_sun_more_is_allowed() -> None:
    found = replace(FOUND, rmse=[0.035])
    assert met(Case(Subject("engine", 70, "noon_grass")), found)
    assert not met(Case(Subject("engine", 70, "grace")), found)


def test_a_scene_with_more_settings_has_its_own_name_and_folder() -> None:
    subject = Subject("carp", 110, "uffizi")
    assert (
        Case(subject, FINER).name
        == "carp under uffizi at 110, `lattice = 2`, `order = 10`, `target_error = 0.01`"
    )
    assert (
        Case(subject, FINER).folder(64, 8)
        != Case(subject).folder(64, 8)
        == f"{subject.folder}-64-8"
    )
