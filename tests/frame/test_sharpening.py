"""Sharp light: texels on the shown isosurface, when it is wanted, when it is read, and what is told of it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.cache.loader import Loader
from isogi_core.errors import StoreError
from isogi_core.frame import sharpening
from isogi_core.frame.frame import UNMOVED, Frame
from isogi_core.frame.reading import Reading
from isogi_core.frame.sharpening import Ways, joined
from isogi_core.kernels.lattice import BURIED, BURIED_ROW, PARTIAL, UNBAKED, UNLIT, VOID, VOID_ROW
from isogi_core.kernels.planes import CONVERGING, FINAL
from isogi_core.model.scene import load_scene
from isogi_core.model.view import View
from tests.frame.conftest import CONSTANT, LOOSE, Workbench, refine_chunk, relative_rmse

MakeBench = Callable[..., Workbench]
STEEP = 1.0
"""Relative error for each voxel that these tests take: a tenth of a voxel is far at LOOSE."""


@pytest.fixture(autouse=True)
def steep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharpening, "STEEPNESS", STEEP)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MakeBench:
    """Make the bench of the orbital under constant light, which sharpens, in a store of its own."""

    def make(**settings: Any) -> Workbench:
        given = {"lights": [CONSTANT], "bounces": 1, "target_error": LOOSE, "sharpen": True, **settings}
        return Workbench(load_scene("demo:orbital", **given), tmp_path_factory.mktemp("sharp"))

    return make


@pytest.fixture(scope="module")
def bench(made: MakeBench) -> Workbench:
    """Such a bench, whose ``view_of`` is baked but for sharp light."""
    bench = made()
    bench.bake(view_of(bench))
    return bench


@pytest.fixture(scope="module")
def sharp(made: MakeBench) -> Workbench:
    """Such a bench with all light of ``view_of``."""
    bench = made()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sharpening, "STEEPNESS", STEEP)
        bench.bake(view_of(bench))
        sharpen(bench, view_of(bench))
    return bench


def view_of(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=32, **settings)


def sharpen(bench: Workbench, view: View) -> Frame:
    """Bake rung by rung all sharp light that a view demands, and render it."""
    rung, frame = FIRST_RUNG, bench.renderer.render(view)
    while frame.sharpness and frame.sharpness.demands:
        loader = bench.caches.sharp(frame.gbuffer.isovalue)
        list(map(partial(refine_chunk, loader, rung, bench.scene.target_error), frame.sharpness.demands))
        rung, frame = 2 * rung, bench.renderer.render(view)
    return frame


def test_scenes_that_do_not_sharpen_know_nothing_of_it(bench: Workbench) -> None:
    plain = Workbench(replace(bench.scene, sharpen=False), bench.folder)
    frame = plain.renderer.render(view_of(plain))
    assert frame.sharpness is None and not frame.provisional
    assert frame.told is frame.state
    assert plain.scene.bake_digest == bench.scene.bake_digest, "the light that serves every isovalue is the same"


def test_vicinity_shading_and_local_models_are_not_sharpened(bench: Workbench) -> None:
    for shading in ("vicinity", "lambert"):
        assert bench.renderer.render(view_of(bench, shading=shading)).sharpness is None


def test_sharp_light_is_wanted_once_all_else_is_final(made: MakeBench, bench: Workbench) -> None:
    new = made()
    begun = new.renderer.render(view_of(new))
    assert begun.demands and begun.sharpness and begun.sharpness.demands == ()
    lit = bench.renderer.render(view_of(bench))
    assert lit.demands == () and lit.sharpness
    assert lit.coverage["converging"] > 0.5 and lit.coverage["provisional"] == 0.0
    wanted = {d.index: d for d in lit.sharpness.demands}
    assert len(wanted) == lit.chunks_needed - lit.chunks_final > 0
    texels, target = lit.sharpness.texels, bench.scene.target_error
    ways = sharpening.find_ways(texels, bench.recipe, bench.renderer.tiles)
    for i, index in enumerate(texels.chunks):
        own = STEEP * ways.voxels[texels.bounds[i] : texels.bounds[i + 1]] > target
        if own.any():
            np.testing.assert_array_equal(wanted[index].offsets, texels.offsets[i][own])
            np.testing.assert_array_equal(wanted[index].footprints, texels.footprints[i][own])
            assert wanted[index].weight > 0.0 and wanted[index].effort.unlit == own.sum()
        else:
            assert index not in wanted


def test_who_moves_the_view_asks_for_no_sharp_light(bench: Workbench) -> None:
    lit = bench.renderer.render(view_of(bench))
    moving = lit.unsharpened
    assert moving.sharpness is None and moving.demands == () and moving.version == lit.version


def test_a_sharpened_view_is_final_and_nearer_to_the_truth(bench: Workbench, sharp: Workbench) -> None:
    base, frame = bench.renderer.render(view_of(bench)), sharp.renderer.render(view_of(sharp))
    assert not frame.provisional and frame.sharpness and frame.sharpness.demands == ()
    assert frame.sharpness.shares["moved"] > 0.5 and frame.sharpness.shares["pending"] == 0.0
    assert sum(frame.sharpness.shares.values()) == pytest.approx(1.0)
    truth = sharp.renderer.render(view_of(sharp, shading="path_traced", samples=1024))
    assert relative_rmse(frame, truth) < 0.8 * relative_rmse(base, truth)


def test_sharp_light_is_kept_beside_the_base_by_the_isovalue(sharp: Workbench) -> None:
    scene, plan = sharp.scene, sharp.scene.plan
    shown = scene.volume.normalise_isovalue(scene.isovalue)
    names = {scene.layer_digest(layer, level) for layer in plan.layers for level in (None, shown)}
    assert sharp.layers == names and len(names) == 2 * len(plan.layers)
    other = sharp.renderer.render(view_of(sharp, isovalue=1.05 * scene.isovalue))
    assert other.sharpness and other.sharpness.shares["moved"] == 0.0


def test_a_restart_finds_the_same_picture(sharp: Workbench) -> None:
    one, two = (each.renderer.render(view_of(each)) for each in (sharp, sharp.again()))
    assert one.version == two.version and one.radiance.tobytes() == two.radiance.tobytes()
    assert np.array_equal(one.told, two.told)


def test_texels_that_cannot_be_moved_are_read_from_the_base_and_told(
    made: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sharpening, "STEEPNESS", 1e3)
    bench = made(lattice=0.5)
    view = bench.view(size=24, isovalue=0.6 * bench.scene.isovalue)
    bench.bake(view)
    frame = sharpen(bench, view)
    assert not frame.provisional and frame.sharpness
    reading, corners = frame.sharpness.reading, frame.sharpness.texels.corners
    assert 0.0 < frame.sharpness.shares["unmoved"] < 0.5, "a lattice half as dense has corners out of reach"
    assert (reading.rows[reading.unmoved & (reading.base.grade <= FINAL)] >= 0).all()
    told, pixels = frame.told.ravel()[frame.gbuffer.pixels], frame.gbuffer.pixels
    assert np.array_equal(told == UNMOVED, reading.unmoved[corners].any(axis=1))
    assert np.array_equal(np.flatnonzero(frame.told), pixels) and (frame.state.ravel()[pixels] == FINAL).all()


def test_where_memory_cannot_hold_sharp_light_the_base_is_shown(
    sharp: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = sharp.again()
    shown = again.scene.volume.normalise_isovalue(again.scene.isovalue)
    full = again.caches.sharp(shown)

    def refuse(_: Loader, chunks: Any) -> None:
        raise StoreError("no room")

    monkeypatch.setattr(full, "ensure", partial(refuse, full))
    frame = again.renderer.render(view_of(again))
    assert frame.sharpness is None and not frame.provisional


def test_readings_are_joined_as_a_walk_through_them_says() -> None:
    rng, count = np.random.default_rng(4), 4000
    bounds = np.array([0, 4, 9, 4000])
    base, new = (reading(rng, count, bounds) for _ in range(2))
    ways = Ways(rng.choice([0.0, 0.05, 0.2, 0.5], count).astype(np.float32))
    pool: Any = SimpleNamespace()
    found = joined(base, new, ways, pool)
    for t in range(count):
        expected = STEEP * ways.voxels[t]
        steep, void = expected > LOOSE, new.grade[t] == VOID
        good = new.grade[t] == FINAL or (steep and new.grade[t] == CONVERGING and new.error[t] <= expected)
        pending = steep and new.grade[t] < FINAL
        grade = base.grade[t]
        if good or (steep and new.grade[t] == BURIED):
            grade = new.grade[t]
        elif pending and grade == FINAL:
            grade = CONVERGING
        rows = (UNLIT, new.rows[t]) if good else (base.rows[t], UNLIT)
        assert (found.rows[t], found.sharp_rows[t]) == rows
        assert found.grade[t] == grade
        assert (found.wanted[t], found.unmoved[t]) == (steep and not void, steep and void)
    late = (found.wanted & (new.grade < FINAL), base.grade < FINAL)
    assert found.short.tolist() == [any(each[a:b].any() for each in late) for a, b in pairwise(bounds)]
    assert [id(own) for _, own in found.sources(pool)] == [id(pool)] * 2
    assert not found.whole


def reading(rng: np.random.Generator, count: int, bounds: np.ndarray) -> Reading:
    """A reading of texels of every kind."""
    grade = rng.choice([UNBAKED, PARTIAL, CONVERGING, FINAL, BURIED, VOID], count).astype(np.uint8)
    rows = np.arange(count, dtype=np.int32)
    for kind, row in ((UNBAKED, UNLIT), (BURIED, BURIED_ROW), (VOID, VOID_ROW)):
        rows[grade == kind] = row
    short = np.minimum.reduceat(grade, bounds[:-1]) < FINAL
    error = rng.random(count).astype(np.float32)
    return Reading(rows, grade, b"", np.full(count, 16, np.int32), error, bounds, short, LOOSE)
