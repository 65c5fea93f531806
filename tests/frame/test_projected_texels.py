"""Surface-projected texels: when a view asks for them, when it reads them, and what its frame
reports.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Loader
from isogi_core.errors import StoreError
from isogi_core.frame import projected_texels as room
from isogi_core.frame.frame import UNREACHABLE
from isogi_core.frame.projected_texels import Distances, join_readings
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_reading import Reading
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    BURIED_ROW,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    UNLIT_ROW,
    VOID_GRADE,
    VOID_ROW,
)
from isogi_core.model.view import View
from tests.frame.conftest import CONSTANT, LOOSE, Workbench, relative_rmse
from tests.loaded import load_scene

MakeBench = Callable[..., Workbench]
STEEP = 1.0
"""Relative error for each voxel that these tests take: a tenth of a voxel is far at LOOSE."""


@pytest.fixture(autouse=True)
def steep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "STEEPNESS", STEEP)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MakeBench:
    """Make the bench of the orbital under constant light, all texels projected, in a store of its
    own.
    """

    def make(**settings: Any) -> Workbench:
        given = {
            "lights": [CONSTANT],
            "bounces": 1,
            "target_error": LOOSE,
            "projected": True,
            **settings,
        }
        return Workbench(load_scene("demo:orbital", **given), tmp_path_factory.mktemp("projected"))

    return make


@pytest.fixture(scope="module")
def bench(made: MakeBench) -> Workbench:
    """Such a bench, whose ``view_of`` is baked but for projected texels."""
    bench = made()
    bench.bake(view_of(bench))
    return bench


@pytest.fixture(scope="module")
def whole(made: MakeBench) -> Workbench:
    """Such a bench with all light of ``view_of``."""
    bench = made()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room, "STEEPNESS", STEEP)
        bench.bake(view_of(bench))
        bench.project(view_of(bench))
    return bench


def view_of(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=32, **settings)


def test_a_scene_may_forbid_projected_texels(bench: Workbench) -> None:
    plain = Workbench(bench.scene.with_settings(projected=False), bench.folder)
    frame = plain.renderer.render(view_of(plain), Goal(plain.scene.target_error))
    assert frame.quality.projection is None and not frame.provisional
    assert frame.reported_state is frame.state
    assert plain.scene.bake_digest == bench.scene.bake_digest, (
        "the light that serves every isovalue is the same"
    )


def test_vicinity_shading_and_local_models_have_none(bench: Workbench) -> None:
    for shading in ("vicinity", "lambert"):
        assert bench.renderer.render(view_of(bench, shading=shading)).quality.projection is None


def test_a_view_demands_them_where_texels_are_far(bench: Workbench) -> None:
    bench.renderer.forget_views()  # drawn before STEEPNESS was patched
    lit = bench.renderer.render(view_of(bench))
    assert lit.demands == () and lit.quality.projection
    assert lit.coverage["converging"] > 0.5 and lit.coverage["provisional"] == 0.0
    wanted = {d.index: d for d in lit.quality.projection.demands}
    assert len(wanted) == lit.chunks_needed - lit.chunks_final > 0
    texels = lit.quality.projection.texels
    target = bench.scene.target_error
    ways = room.find_distances(texels, bench.prepared, bench.renderer.tiles)
    for i, index in enumerate(texels.chunks):
        own = STEEP * ways.voxels[texels.bounds[i] : texels.bounds[i + 1]] > target
        if own.any():
            np.testing.assert_array_equal(wanted[index].offsets, texels.offsets[i][own])
            np.testing.assert_array_equal(wanted[index].footprints, texels.footprints[i][own])
            assert wanted[index].weight > 0.0 and wanted[index].effort.unlit == own.sum()
        else:
            assert index not in wanted


def test_a_view_that_moves_asks_for_none(bench: Workbench) -> None:
    lit, moving = (bench.renderer.render(view_of(bench, moving=each)) for each in (False, True))
    assert moving.quality.projection is None and moving.demands == () and not moving.provisional
    assert lit.provisional and moving.version != lit.version


def test_a_projected_view_is_final_and_nearer_to_the_truth(
    bench: Workbench, whole: Workbench
) -> None:
    base = bench.renderer.render(view_of(bench))
    frame = whole.renderer.render(view_of(whole))
    assert (
        not frame.provisional
        and frame.quality.projection
        and frame.quality.projection.demands == ()
    )
    assert (
        frame.quality.projection.shares["projected"] > 0.5
        and frame.quality.projection.shares["pending"] == 0.0
    )
    assert sum(frame.quality.projection.shares.values()) == pytest.approx(1.0)
    truth = whole.renderer.render(view_of(whole, shading="path_traced", samples=1024))
    plain = [
        Renderer(each.caches, each.renderer.tiles, filters=False).render(view_of(each))
        for each in (whole, bench)
    ]
    errors = [math.sqrt(relative_rmse(each, truth) ** 2 - each.noise**2) for each in plain]
    assert errors[0] < 0.8 * errors[1], "less the noise of both, which no filter makes less"
    assert relative_rmse(frame, truth) < relative_rmse(base, truth)


def test_they_are_kept_beside_the_base_by_the_isovalue(whole: Workbench) -> None:
    scene = whole.scene
    plan = whole.scene.plan
    shown = scene.volume.normalise_isovalue(scene.isovalue)
    names = {scene.layer_digest(layer, level) for layer in plan.layers for level in (None, shown)}
    assert whole.layers == names and len(names) == 2 * len(plan.layers)
    other = whole.renderer.render(view_of(whole, isovalue=1.05 * scene.isovalue))
    assert other.quality.projection and other.quality.projection.shares["projected"] == 0.0


def test_a_restart_finds_the_same_picture(whole: Workbench) -> None:
    one, two = (each.renderer.render(view_of(each)) for each in (whole, whole.again()))
    assert one.version == two.version and one.radiance.tobytes() == two.radiance.tobytes()
    assert np.array_equal(one.reported_state, two.reported_state)


def test_texels_that_cannot_be_projected_are_read_from_the_base(
    made: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "STEEPNESS", 1e3)
    bench = made(lattice=0.5)
    view = bench.view(size=24, isovalue=0.6 * bench.scene.isovalue)
    bench.bake(view)
    bench.project(view)
    frame = bench.renderer.render(view, Goal(bench.scene.target_error))
    assert not frame.provisional and frame.quality.projection
    reading = frame.quality.projection.reading
    corners = frame.quality.projection.texels.corners
    assert 0.0 < frame.quality.projection.shares["unreachable"] < 0.5, (
        "a lattice half as dense has corners out of reach"
    )
    assert (reading.rows[reading.unreachable & (reading.base.grade <= FINAL)] >= 0).all()
    told = frame.reported_state.ravel()[frame.gbuffer.pixels]
    pixels = frame.gbuffer.pixels
    assert np.array_equal(told == UNREACHABLE, reading.unreachable[corners].any(axis=1))
    assert (
        np.array_equal(np.flatnonzero(frame.reported_state), pixels)
        and (frame.state.ravel()[pixels] == FINAL).all()
    )


def test_where_memory_cannot_hold_them_the_base_is_shown(
    whole: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = whole.again()
    shown = again.scene.volume.normalise_isovalue(again.scene.isovalue)
    full = again.caches.projected(shown)

    def refuse(_: Loader, chunks: Any) -> None:
        raise StoreError("no room")

    monkeypatch.setattr(full, "ensure", partial(refuse, full))
    frame = again.renderer.render(view_of(again))
    assert frame.quality.projection is None and not frame.provisional


def test_readings_are_join_readings_as_a_walk_through_them_says() -> None:
    rng = np.random.default_rng(4)
    count = 4000
    bounds = np.array([0, 4, 9, 4000])
    base, new = (reading(rng, count, bounds) for _ in range(2))
    ways = Distances(rng.choice([0.0, 0.05, 0.2, 0.5], count).astype(np.float32))
    pool: Any = SimpleNamespace()
    found = join_readings(base, new, ways, pool)
    for t in range(count):
        expected = STEEP * ways.voxels[t]
        steep = expected > LOOSE
        void = new.grade[t] == VOID_GRADE
        without = np.hypot(expected, base.error[t] if base.samples[t] else 1.0)
        good = new.grade[t] == FINAL or (
            steep and new.grade[t] == CONVERGING and new.error[t] <= without
        )
        pending = steep and new.grade[t] < FINAL
        grade = base.grade[t]
        dark = steep and new.grade[t] == BURIED_GRADE
        if good or dark:
            grade = FINAL if dark else new.grade[t]
        elif pending and grade == FINAL:
            grade = CONVERGING
        if good:
            rows = (UNLIT_ROW, new.rows[t])
        else:
            rows = (UNLIT_ROW if dark else base.rows[t], UNLIT_ROW)
        assert (found.rows[t], found.projected_rows[t]) == rows
        assert found.grade[t] == grade
        assert (found.wanted[t], found.unreachable[t], found.dark[t]) == (
            steep and not void,
            steep and void,
            dark,
        )
    late = (found.wanted & (new.grade < FINAL), ~found.wanted & (base.grade < FINAL))
    assert found.short.tolist() == [
        any(each[a:b].any() for each in late) for a, b in pairwise(bounds)
    ]
    assert [id(own) for _, own in found.sources(pool)] == [id(pool)] * 2
    assert not found.whole


def reading(rng: np.random.Generator, count: int, bounds: np.ndarray) -> Reading:
    """A reading of texels of every kind."""
    grade = rng.choice(
        [UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL, BURIED_GRADE, VOID_GRADE], count
    ).astype(np.uint8)
    rows = np.arange(count, dtype=np.int32)
    for kind, row in (
        (UNBAKED_GRADE, UNLIT_ROW),
        (BURIED_GRADE, BURIED_ROW),
        (VOID_GRADE, VOID_ROW),
    ):
        rows[grade == kind] = row
    short = np.minimum.reduceat(grade, bounds[:-1]) < FINAL
    error = rng.random(count).astype(np.float32)
    samples = np.full(count, 16, np.int32)
    return Reading(rows, grade, b"", samples, error, bounds, short, Goal(LOOSE), rough=False)
