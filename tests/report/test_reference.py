"""References: their rounds, their bits, their noise, their files, and what they are refused for."""

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core import reference
from isogi_core.errors import Cancelled, ReportError
from isogi_core.frame.renderer import Renderer
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.reference import (
    ReferenceGoal,
    grow_reference,
    load_reference,
    save_reference,
    trace_reference,
    with_bounces,
)
from tests.frame.conftest import CONSTANT, SKY, Workbench, ball, scene_of
from tests.loaded import load_scene


def make(samples: int) -> Any:
    """A reference whose noise is the inverse of its samples."""
    return SimpleNamespace(samples=samples, noise=1.0 / samples)


@pytest.fixture
def tracer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracer that takes a second for each sample, on a clock of its own."""
    clock = SimpleNamespace(now=0.0)

    def trace(_: Any, __: Any, samples: int, former: Any, *more: Any) -> Any:
        rounded = -(-samples // 8) * 8
        clock.now += rounded - (former.samples if former else 0)
        return make(rounded)

    monkeypatch.setattr(reference, "trace_reference", trace)
    monkeypatch.setattr(reference, "time", SimpleNamespace(monotonic=lambda: clock.now))


@pytest.mark.usefixtures("tracer")
@pytest.mark.parametrize(
    ("goal", "former", "expected"),
    [
        (ReferenceGoal(samples=100), None, [16, 32, 64, 104]),
        (ReferenceGoal(samples=5), None, [8]),
        (ReferenceGoal(noise=1 / 64), None, [16, 32, 64]),
        (ReferenceGoal(noise=1 / 65), None, [16, 32, 64, 128]),
        (ReferenceGoal(seconds=100.0), None, [16, 32, 64, 96]),
        (ReferenceGoal(seconds=0.0), None, [16]),
        (ReferenceGoal(samples=64, seconds=1000.0), None, [16, 32, 64]),
        (ReferenceGoal(samples=64), 64, []),
        (ReferenceGoal(samples=65), 64, [72]),
        (ReferenceGoal(seconds=200.0), 64, [128, 256, 264]),
    ],
)
def test_rounds_double_up_to_the_goal(
    goal: ReferenceGoal, former: int | None, expected: list[int]
) -> None:
    """From nothing, or from a reference of so many samples."""
    grown = grow_reference(None, None, goal, former and make(former))  # type: ignore[arg-type]
    assert [each.samples for each in grown] == expected


def test_what_is_still_to_come_is_foreseen() -> None:
    assert ReferenceGoal(samples=100).foresee(make(16)) == 100
    assert ReferenceGoal(noise=1 / 64).foresee(make(64)) == 64
    assert ReferenceGoal(noise=1 / 128).foresee(make(64)) == 256, "64 · 2^1.75, and rounds double"
    assert ReferenceGoal(seconds=3.0).foresee(make(64)) is None


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital under a sky, nothing baked."""
    scene = load_scene("demo:orbital", lights=[SKY], albedo=[0.8, 0.6, 0.4], bounces=2)
    return Workbench(scene, tmp_path_factory.mktemp("store"))


def test_a_reference_in_two_goes_is_the_one_at_once(bench: Workbench) -> None:
    view = bench.view(size=24)
    once = trace_reference(bench.renderer, view, 64)
    first = trace_reference(bench.renderer, view, 20)
    again = trace_reference(bench.renderer, view, 64, first)
    assert (first.samples, again.samples) == (24, 64), "whole rounds of the replicas"
    assert np.array_equal(again.sums, once.sums) and again.seconds > first.seconds
    assert np.array_equal(again.mean, once.mean) and np.array_equal(again.variance, once.variance)
    assert trace_reference(bench.renderer, view, 32, once) is once, "it has more than that"


def test_a_ball_under_constant_light_has_its_albedo_and_no_noise(tmp_path: Path) -> None:
    bench = Workbench(scene_of(ball(), 0.0, lights=[CONSTANT], albedo=0.7, bounces=3), tmp_path)
    found = trace_reference(bench.renderer, bench.view(size=24), 64)
    assert (
        found.on.sum() > 60
        and not found.mean[~found.on].any()
        and not found.variance[~found.on].any()
    )
    np.testing.assert_allclose(found.mean[found.on], 0.7, rtol=1e-6)
    assert found.noise < 1e-12


def test_its_noise_is_its_distance_to_one_of_many_more_samples(bench: Workbench) -> None:
    view = bench.view(size=48)
    few, many = (trace_reference(bench.renderer, view, samples) for samples in (32, 1024))
    wrong = (few.mean - many.mean)[many.on] @ LUMINANCE_WEIGHTS
    level = float((many.mean[many.on] @ LUMINANCE_WEIGHTS).mean())
    assert 0.85 < np.sqrt((wrong**2).mean()) / level / few.noise < 1.15
    assert 0.8 < (np.abs(wrong) < 1.96 * few.standard_error[many.on]).mean() < 0.97, (
        "of 7 degrees of freedom"
    )
    assert many.noise < few.noise / 5.0, "stratified points do better than 1 / sqrt(32)"


def test_it_does_not_go_on_from_another_view_or_scene(bench: Workbench, tmp_path: Path) -> None:
    view = bench.view(size=8)
    former = trace_reference(bench.renderer, view, 8)
    longer = Workbench(replace(bench.scene, plan=replace(bench.scene.plan, bounces=9)), tmp_path)
    for renderer, other in (
        (bench.renderer, bench.view(size=8, azimuth=50.0)),
        (longer.renderer, view),
    ):
        with pytest.raises(ReportError, match="begin a new one"):
            trace_reference(renderer, other, 16, former)
    assert (
        trace_reference(bench.renderer, replace(view, shading="gi", samples=3), 16, former).samples
        == 16
    )


def test_cancelled_it_leaves_the_former_as_it_was(bench: Workbench) -> None:
    view = bench.view(size=24)
    cancelled = threading.Event()
    told = []
    former = trace_reference(bench.renderer, view, 8, progress=told.append)
    assert sum(told) == 8 * former.on.sum()
    sums = former.sums.copy()
    stopped = Renderer(bench.caches, bench.renderer.tiles.cancelled_by(cancelled))
    cancelled.set()
    with pytest.raises(Cancelled):
        trace_reference(stopped, view, 16, former)
    assert np.array_equal(former.sums, sums)


# --- its file
# --------------------------------------------------------------------------------------------------


def test_a_file_gives_back_what_was_saved_and_it_goes_on(bench: Workbench, tmp_path: Path) -> None:
    view = bench.view(size=16)
    path = tmp_path / "a.npz"
    saved = trace_reference(bench.renderer, view, 16)
    save_reference(path, saved, bench.scene, view)
    found = load_reference(path, bench.scene, view)
    assert [each.name for each in tmp_path.iterdir()] == ["a.npz"]
    assert (found.samples, found.seconds, found.subject) == (
        saved.samples,
        saved.seconds,
        saved.subject,
    )
    for name in ("mean", "variance", "on", "sums"):
        assert np.array_equal(getattr(found, name), getattr(saved, name))
    once, again = (trace_reference(bench.renderer, view, 32, former) for former in (None, found))
    assert np.array_equal(once.mean, again.mean)


def test_a_file_of_something_else_or_of_nothing_is_refused(
    bench: Workbench, tmp_path: Path
) -> None:
    view = bench.view(size=16)
    path = tmp_path / "a.npz"
    save_reference(path, trace_reference(bench.renderer, view, 8), bench.scene, view)
    for scene, other in (
        (bench.scene, bench.view(size=16, azimuth=50.0)),
        (with_bounces(bench.scene, 3), view),
        (
            load_scene(
                "demo:orbital", albedo=[0.8, 0.6, 0.4], bounces=2, normals="gradient", lights=[SKY]
            ),
            view,
        ),
    ):
        with pytest.raises(
            ReportError, match=r"orbital at 0\.03, 16 × 16 pixels, 2 bounces, bspline normals"
        ):
            load_reference(path, scene, other)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], b"PK" + bytes(1000)):
        path.write_bytes(damaged)
        with pytest.raises(ReportError, match=r"a\.npz is no complete reference"):
            load_reference(path, bench.scene, view)


def test_a_file_of_another_version_is_told_as_such(
    bench: Workbench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = bench.view(size=8)
    path = tmp_path / "a.npz"
    save_reference(path, trace_reference(bench.renderer, view, 8), bench.scene, view)
    monkeypatch.setattr("isogi_core.reference.REFERENCE_FORMAT", 2)
    with pytest.raises(ReportError, match="another version of isogi"):
        load_reference(path, bench.scene, view)


@pytest.mark.parametrize(
    ("albedo", "bounces"), [(0.7, 19), (0.0, 0), (1.0, 1000), ([0.2, 0.5, 0.1], 9)]
)
def test_by_default_less_than_a_thousandth_of_the_light_is_cut(
    albedo: object, bounces: int
) -> None:
    scene = with_bounces(load_scene("demo:orbital", albedo=albedo))
    assert scene.bounces == bounces
    assert max(scene.surfaces.albedo) ** (bounces + 1) <= 0.001 or bounces == 1000
